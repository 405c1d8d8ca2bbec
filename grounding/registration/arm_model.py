"""Model of the arm for fitting: poses of its parts at a posture, and their derivatives by the joint angles."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.fit import clip_finger, finger_information
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.robot import ARM_LINKS, GRIPPER, HAND_LINK, LINK_OF, RobotPart

OVER_LIMIT_RAD = 0.1
"""Tolerance of the joint limits: the pose that a posture is computed from is not exact yet."""
_POSTURE_SIGMA_RAD = 0.7  # prior standard deviation of the joint angles about the initial posture


class ArmModel:
    """Poses of the Panda's parts and joint axes by posture, and which joint moves which part."""

    def __init__(self) -> None:
        """Load the kinematics.

        Raises:
            SetupError: the robot description is missing.
        """
        plant = ArmPlant()
        self.lower, self.upper = plant.lower, plant.upper
        self._chain = plant.chain
        parts = [part for part in RobotPart if part is not RobotPart.BACKGROUND]
        names = [HAND_LINK if part in GRIPPER else LINK_OF[part] for part in parts]
        self._stage = np.array([0, *(self._chain.stage[name] for name in names)])
        self._home = np.stack([np.eye(4), *(self._chain.home[name] for name in names)])
        self.moves = np.stack([np.zeros(7), *(self._chain.carries(name) for name in names)])
        """(PARTS, 7) 1 if the joint moves the part, else 0."""
        self.X_HF = invert(self._chain.home[HAND_LINK]) @ self._chain.home[ARM_LINKS[-1]]
        """(4, 4) pose of the flange in the hand frame [m]."""

    def poses(self, q: Array) -> Array:
        """Return the poses (M, PARTS, 4, 4) of the parts' CAD frames in B, fingers closed, at postures `q` (M, 7)."""
        return np.asarray(self._chain.motions(q)[:, self._stage] @ self._home)

    def poses_and_axes(self, q: Array) -> tuple[Array, Array, Array]:
        """Return poses (PARTS, 4, 4), joint axes (7, 3) and a point (7, 3) on each axis in B, at one posture (7,)."""
        X, axis, point = self.poses_and_axes_of(q[None])
        return X[0], axis[0], point[0]

    def poses_and_axes_of(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the same of postures `q` (M, 7), each with a leading dimension M."""
        M = self._chain.motions(q)
        axis, point = self._chain.axes(M)
        return np.asarray(M[:, self._stage] @ self._home), axis, point


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmHandModel:
    """`FitModel` of an arm with its hand; 8 parameters: joint angles, finger travel."""

    model: ArmModel
    X_CB: Array
    """(4, 4) pose of the base in the camera frame [m]."""
    q: Array
    """(7,) joint angles [rad]."""
    q_start: Array
    """(7,) mean of their prior [rad]."""
    finger_m: float
    """Travel of each finger [m]."""
    finger_free: bool
    """True if the travel is estimated."""

    def predict(self, cells: Correspondences) -> tuple[Array, Array]:
        """Return the CAD points (N, 3) in the camera frame [m] and their derivatives (N, 3, 8)."""
        X_BP, axis, point = self.model.poses_and_axes(self.q)
        X = X_BP[cells.part]
        opened_P = cells.p_P + cells.opening_sign[:, None] * np.array([0.0, self.finger_m, 0.0])
        p_B = np.einsum("nij,nj->ni", X[:, :3, :3], opened_P) + X[:, :3, 3]
        arm = p_B[:, None] - point
        d_B = np.empty((len(p_B), 3, 8))
        d_B[:, 0, :7] = axis[:, 1] * arm[..., 2] - axis[:, 2] * arm[..., 1]
        d_B[:, 1, :7] = axis[:, 2] * arm[..., 0] - axis[:, 0] * arm[..., 2]
        d_B[:, 2, :7] = axis[:, 0] * arm[..., 1] - axis[:, 1] * arm[..., 0]
        d_B[:, :, :7] *= self.model.moves[cells.part][:, None]
        d_B[:, :, 7] = cells.opening_sign[:, None] * X[:, :3, 1]
        R_CB = self.X_CB[:3, :3]
        return p_B @ R_CB.T + self.X_CB[:3, 3], R_CB @ d_B

    def prior(self) -> tuple[Array, Array]:
        """Return the information (8, 8) that keeps unobserved joints near `q_start`, and its gradient (8,)."""
        information = np.eye(8) / _POSTURE_SIGMA_RAD**2
        information[7, 7] = finger_information(self.finger_free)
        gradient = np.zeros(8)
        gradient[:7] = (self.q - self.q_start) / _POSTURE_SIGMA_RAD**2
        return information, gradient

    def updated(self, step: Array) -> Self:
        """Return the arm after a change (8,) of its parameters, within the joint limits."""
        q = np.clip(self.q + step[:7], self.model.lower - OVER_LIMIT_RAD, self.model.upper + OVER_LIMIT_RAD)
        return replace(self, q=q, finger_m=clip_finger(self.finger_m + step[7]))

    def hand(self) -> tuple[Array, Array]:
        """Return the pose (4, 4) of the hand in C [m] and its derivatives (6, 7) by the joints, rotation first."""
        X_BP, axis, point = self.model.poses_and_axes(self.q)
        p = X_BP[RobotPart.HAND, :3, 3]
        J_B = np.concatenate([axis.T, np.cross(axis, p - point).T])
        R_CB = self.X_CB[:3, :3]
        return self.X_CB @ X_BP[RobotPart.HAND], np.concatenate([R_CB @ J_B[:3], R_CB @ J_B[3:]])
