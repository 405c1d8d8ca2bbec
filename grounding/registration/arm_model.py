"""Model of the arm for fitting: poses of its parts at a posture, and their derivatives by the joint angles."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, cross, invert
from kinebench_drake.grounding.registration.fit import clip_finger, finger_information
from kinebench_drake.grounding.registration.solver import Placement
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.robot import ARM_LINKS, GRIPPER, HAND_LINK, LINK_OF, RobotPart
from kinebench_drake.models.robot import N_JOINTS

OVER_LIMIT_RAD = 0.1
"""Tolerance of the joint limits: the pose that a posture is computed from is not exact yet."""
POSTURE_SIGMA_RAD = 0.7
"""Prior standard deviation of the joint angles about the initial posture [rad]."""


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
    """`FitModel` of arms with their hands; 8 parameters: joint angles, finger travel."""

    model: ArmModel
    X_CB: Array
    """(B, 4, 4) pose of the base in the camera frame [m]."""
    q: Array
    """(B, 7) joint angles [rad]."""
    q_start: Array
    """(B, 7) mean of their prior [rad]."""
    finger_m: Array
    """(B,) travel of each finger [m]."""
    finger_free: NDArray[np.bool_]
    """(B,) whether the travel is estimated."""
    q_sigma: Array = field(default_factory=lambda: np.full(N_JOINTS, POSTURE_SIGMA_RAD))
    """(7,) standard deviations of the prior of the joint angles [rad]."""

    def place(self) -> Placement:
        """Return the poses of the parts, each moved by the joints between it and the base."""
        X_BP, axis, point = self.model.poses_and_axes_of(self.q)
        R_BC = self.X_CB[:, :3, :3].swapaxes(1, 2)
        axis_C, point_C = axis @ R_BC, point @ R_BC + self.X_CB[:, None, :3, 3]
        return Placement(
            X_CP=self.X_CB[:, None] @ X_BP,
            finger_m=self.finger_m,
            twist=np.concatenate([axis_C, cross(point_C, axis_C)], axis=2).swapaxes(1, 2),
            moves=self.model.moves,
        )

    def prior(self) -> tuple[Array, Array]:
        """Return the information (B, 8, 8) that keeps unobserved joints near `q_start`, and its gradient (B, 8)."""
        information = np.tile(np.diag([*self.q_sigma**-2, 1.0]), (len(self.q), 1, 1))
        information[:, 7, 7] = finger_information(self.finger_free)
        gradient = np.zeros((len(self.q), 8))
        gradient[:, :7] = (self.q - self.q_start) / self.q_sigma**2
        return information, gradient

    def updated(self, step: Array) -> Self:
        """Return the arms after a change (B, 8) of their parameters, within the joint limits."""
        q = np.clip(self.q + step[:, :7], self.model.lower - OVER_LIMIT_RAD, self.model.upper + OVER_LIMIT_RAD)
        return replace(self, q=q, finger_m=clip_finger(self.finger_m + step[:, 7]))

    def take(self, index: NDArray[np.generic]) -> Self:
        """Return the arms of some of the frames, by index or mask."""
        names = ("X_CB", "q", "q_start", "finger_m", "finger_free")
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def hand(self) -> tuple[Array, Array]:
        """Return the hands' poses (B, 4, 4) in C [m] and their derivatives (B, 6, 7) by the joints, rotation first."""
        placement = self.place()
        X_CH, twist = placement.X_CP[:, RobotPart.HAND], placement.twist
        rotation = twist[:, :3]
        velocity = twist[:, 3:] + cross(rotation.swapaxes(1, 2), X_CH[:, None, :3, 3]).swapaxes(1, 2)
        return X_CH, np.concatenate([rotation, velocity], axis=1)
