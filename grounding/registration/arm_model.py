"""Model of the arm for fitting: poses of its parts at a posture, and the posture behind a pose of the hand."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, cross, invert
from kinebench_drake.grounding.registration.fit import finger_information
from kinebench_drake.grounding.registration.solver import CELLS_INDEPENDENT, CellRows, Correspondences, PartPlacement
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.cad import franka_hand
from kinebench_drake.models.panda.description import ARM_LINKS, GRIPPER, HAND_LINK, LINK_OF, RobotPart
from kinebench_drake.models.robot import N_JOINTS

OVER_LIMIT_RAD = 0.1
"""Tolerance of the joint limits: the pose that a posture is computed from is not exact yet."""
POSTURE_SIGMA_RAD = 0.7
"""Prior standard deviation of the joint angles about the initial posture [rad]."""
EVIDENCE_CAP = 6.0
"""Greatest log-likelihood ratio of a pose against its flip: errors of one view correlate, none outweighs several."""
MIN_CELLS = 60
"""Least number of cells of the links, or of the robot over all frames of a calibration."""
LAST_ANGLES_RAD = np.linspace(-np.pi, np.pi, 32, endpoint=False)
"""Angles of the last joint at which inverse kinematics is solved."""
USUAL_Q = np.array([0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])
"""Usual posture of links that are not seen [rad]."""
_SHOULDER_SIGMA_RAD = 1.0
"""Standard deviation of joints 1 and 3 about zero [rad]: half a turn of both, joint 2 reversed, looks alike."""
COST_CAP = 25.0
"""Greatest squared residual of a cell."""
_SCORED_CELLS = 48
"""Number of cells that are compared with many postures."""


class ArmModel:
    """Poses of the Panda's parts and joint axes by posture, and which joint moves which part."""

    def __init__(self, gripper: GripperModel | None = None) -> None:
        """Load the kinematics of an arm with a gripper, by default the Franka hand.

        Raises:
            SetupError: the robot description or meshes are missing.
        """
        plant = ArmPlant()
        self.gripper = gripper or franka_hand()
        self.lower = plant.lower
        self.upper = plant.upper
        self._chain = plant.chain
        parts = [part for part in RobotPart if part is not RobotPart.BACKGROUND]
        names = [HAND_LINK if part in GRIPPER else LINK_OF[part] for part in parts]
        self._stage = np.array([0, *(self._chain.stage[name] for name in names)])
        self._home = np.stack([np.eye(4), *(self._chain.home[name] for name in names)])
        self._home[list(GRIPPER)] = self._home[list(GRIPPER)] @ self.gripper.X_MH
        self.moves = np.stack([np.zeros(7), *(self._chain.carries(name) for name in names)])
        """(PARTS, 7) 1 if the joint moves the part, else 0."""
        self.X_HF = invert(self._home[RobotPart.HAND]) @ self._chain.home[ARM_LINKS[-1]]
        """(4, 4) pose of the flange in the frame of the gripper [m]."""

    def poses(self, q: Array) -> Array:
        """Return the poses (M, PARTS, 4, 4) of the parts' CAD frames in B, fingers closed, at postures `q` (M, 7)."""
        return np.asarray(self._chain.motions(q)[:, self._stage] @ self._home)

    def within_limits(self, q: Array) -> NDArray[np.bool_]:
        """Return which postures (..., 7) are within the joint limits and their tolerance; none with NaN."""
        return np.asarray(((q >= self.lower - OVER_LIMIT_RAD) & (q <= self.upper + OVER_LIMIT_RAD)).all(axis=-1))

    def clip(self, q: Array) -> Array:
        """Clip postures (..., 7) to the joint limits and their tolerance [rad]."""
        return np.clip(q, self.lower - OVER_LIMIT_RAD, self.upper + OVER_LIMIT_RAD)

    def postures(self, X_BH: Array) -> Array:
        """Return the postures (M, 7) that hold the hand at a pose X_BH (4, 4), whatever the limits [rad]."""
        q = analytic_ik(X_BH @ self.X_HF, LAST_ANGLES_RAD).reshape(-1, N_JOINTS)
        return np.asarray(q[np.isfinite(q).all(axis=1)])

    def poses_and_axes(self, q: Array) -> tuple[Array, Array, Array]:
        """Return poses (M, PARTS, 4, 4), joint axes (M, 7, 3) and a point (M, 7, 3) on each in B at postures (M, 7)."""
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

    def place(self) -> PartPlacement:
        """Return the poses of the parts, each moved by the joints between it and the base."""
        X_BP, axis, point = self.model.poses_and_axes(self.q)
        return PartPlacement(
            X_CP=self.X_CB[:, None] @ X_BP,
            finger_m=self.finger_m,
            twist=joint_twist(self.X_CB, axis, point),
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
        finger_m = np.clip(self.finger_m + step[:, 7], 0.0, self.model.gripper.max_finger_m)
        return replace(self, q=self.model.clip(self.q + step[:, :7]), finger_m=finger_m)

    def take(self, index: NDArray[np.generic]) -> Self:
        """Return the arms of some of the frames, by index or mask."""
        names = ("X_CB", "q", "q_start", "finger_m", "finger_free")
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def hand(self) -> tuple[Array, Array]:
        """Return the hands' poses (B, 4, 4) in C [m] and their derivatives (B, 6, 7) by the joints, rotation first."""
        placement = self.place()
        X_CH = placement.X_CP[:, RobotPart.HAND]
        twist = placement.twist
        rotation = twist[:, :3]
        velocity = twist[:, 3:] + cross(rotation.swapaxes(1, 2), X_CH[:, None, :3, 3]).swapaxes(1, 2)
        return X_CH, np.concatenate([rotation, velocity], axis=1)


def joint_twist(X_CB: Array, axis: Array, point: Array) -> Array:
    """Return the twists (B, 6, 7), as in `PartPlacement`, of joints whose axes (B, 7, 3) pass points (B, 7, 3) in B."""
    R_BC = X_CB[:, :3, :3].swapaxes(1, 2)
    axis_C = axis @ R_BC
    moment_C = cross(point @ R_BC + X_CB[:, None, :3, 3], axis_C)
    return np.concatenate([axis_C, moment_C], axis=2).swapaxes(1, 2)


def find_posture(
    model: ArmModel, X_CH: Array, links: Correspondences, X_CB: Array
) -> tuple[Array, float, float] | None:
    """Return the inverse kinematics solution (7,) that matches the links best, its cost and that of the flip.

    The flipped hand, rotated by 180 degrees about its axis, has the same postures except for the last joint. None if
    fewer than `MIN_CELLS` cells show the links, or the base is out of reach.
    """
    if len(links) < MIN_CELLS:
        return None
    q = model.postures(invert(X_CB) @ X_CH)
    flipped = q.copy()
    flipped[:, 6] = (flipped[:, 6] + 2 * np.pi) % (2 * np.pi) - np.pi
    best: list[tuple[float, Array | None]] = []
    scored = links.take(np.linspace(0, len(links) - 1, _SCORED_CELLS).astype(int))
    for postures in (q, flipped):
        candidates = postures[model.within_limits(postures)]
        if not len(candidates):
            best.append((COST_CAP, None))
            continue
        shoulder = ((candidates[:, [0, 2]] / _SHOULDER_SIGMA_RAD) ** 2).sum(axis=1) / CELLS_INDEPENDENT
        costs = posture_costs(model, candidates, scored, X_CB) + shoulder
        best.append((float(costs.min()), candidates[costs.argmin()]))
    (cost, posture), (flipped_cost, _) = best
    return None if posture is None else (posture, cost, flipped_cost)


def posture_costs(model: ArmModel, q: Array, cells: Correspondences, X_CB: Array) -> Array:
    """Return the mean capped squared residual (M,) of the cells for postures `q` (M, 7)."""
    rows = CellRows.of(Correspondences.stack([cells]))
    p_L = rows.in_line_frames(rows.place(X_CB @ model.poses(q))[0])
    square = (p_L[:, :2] ** 2).sum(axis=1) * rows.inverse_sigma[:, 0] ** 2
    return np.asarray(np.where(p_L[:, 2] > 0, np.minimum(square, COST_CAP), COST_CAP).mean(axis=1))


def half_turn(arm: ArmHandModel) -> ArmHandModel:
    """Return the arm with its last joint turned by 180 degrees."""
    q = arm.q + np.pi * (np.arange(7) == 6) * np.where(arm.q[:, 6:] < 0, 1.0, -1.0)
    return replace(arm, q=q, q_start=q)


def flip_evidence(cost: float, flipped_cost: float) -> float:
    """Return the log-likelihood ratio of a pose against its flip from their mean squared residuals."""
    return float(np.clip(0.5 * (flipped_cost - cost), -EVIDENCE_CAP, EVIDENCE_CAP))
