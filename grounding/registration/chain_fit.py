"""Fit of the last links of the arm alone: pose of the flange where gripper, base or both are unknown.

One link's CAD coordinates and depth give its pose in closed form; its neighbours give the joint angles between them one
after the other. Then the pose of the hand's frame, which is fixed to the flange, and all joint angles are fitted to the
cells of the links together, the angles with a prior: links that are not seen are left where they usually are.
"""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, cross, invert, make_pose, rotation_exp
from kinebench_drake.grounding.registration.arm_fit import LINKS_DEPTH_SIGMA
from kinebench_drake.grounding.registration.arm_model import (
    COST_CAP,
    OVER_LIMIT_RAD,
    POSTURE_SIGMA_RAD,
    USUAL_Q,
    ArmModel,
)
from kinebench_drake.grounding.registration.fit import align, pose_twist
from kinebench_drake.grounding.registration.solver import Correspondences, PartPlacement, Solution, solve
from kinebench_drake.models.panda.description import ARM, RobotPart
from kinebench_drake.models.robot import N_JOINTS

MIN_ROOT_CELLS = 30
MIN_LINK_CELLS = 10
"""Least number of cells of the link that a fit begins with, and of the last link, or of one that a camera explains."""
_ROOTS = (RobotPart.LINK6, RobotPart.LINK5)
_ANGLES = 72
_LEAST_CELLS = 8
"""Fewest cells of a link that determine a joint."""
_COMPARED = 60
"""Greatest number of them that are compared."""
UNKNOWNS = 6 + N_JOINTS
"""Number of parameters of a `ChainModel`."""
_ALIGN_PASSES = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainModel:
    """`FitModel` of arms with free bases; 13 parameters: pose of the hand as in `HandModel`, joint angles."""

    model: ArmModel
    X_CH: Array
    """(B, 4, 4) poses of panda_hand in the camera frame [m], whatever gripper is there."""
    q: Array
    """(B, 7) joint angles [rad]."""
    q_start: Array
    """(B, 7) mean of their prior [rad]."""
    q_sigma: Array = field(default_factory=lambda: np.full(N_JOINTS, POSTURE_SIGMA_RAD))
    """(7,) standard deviations of their prior [rad]."""

    def place(self) -> PartPlacement:
        """Return the poses of the parts; a joint turns what is behind it against the hand."""
        X_BP, axis, point = self.model.poses_and_axes_of(self.q)
        X_CB = self.X_CH @ invert(X_BP[:, RobotPart.HAND])
        R_BC = X_CB[:, :3, :3].swapaxes(1, 2)
        axis_C = axis @ R_BC
        point_C = point @ R_BC + X_CB[:, None, :3, 3]
        joints = np.concatenate([axis_C, cross(point_C, axis_C)], axis=2).swapaxes(1, 2)
        return PartPlacement(
            X_CP=X_CB[:, None] @ X_BP,
            finger_m=None,
            twist=np.concatenate([pose_twist(self.X_CH), joints], axis=2),
            moves=np.hstack([np.ones((len(RobotPart), 6)), self.model.moves - 1.0]),
        )

    def prior(self) -> tuple[Array, Array]:
        """Return the information (B, 13, 13) that keeps unobserved joints near `q_start`, and its gradient (B, 13)."""
        information = np.diag([*[0.0] * 6, *self.q_sigma**-2])
        gradient = np.zeros((len(self.q), 6 + N_JOINTS))
        gradient[:, 6:] = (self.q - self.q_start) / self.q_sigma**2
        return np.tile(information, (len(self.q), 1, 1)), gradient

    def updated(self, step: Array) -> Self:
        """Return the chains after a change (B, 13) of their parameters, within the joint limits."""
        R = rotation_exp(step[:, :3]) @ self.X_CH[:, :3, :3]
        q = np.clip(self.q + step[:, 6:], self.model.lower - OVER_LIMIT_RAD, self.model.upper + OVER_LIMIT_RAD)
        return replace(self, X_CH=make_pose(R, self.X_CH[:, :3, 3] + step[:, 3:6]), q=q)

    def take(self, index: NDArray[np.generic]) -> Self:
        """Return the chains of some of the frames, by index or mask."""
        return replace(self, X_CH=self.X_CH[index], q=self.q[index], q_start=self.q_start[index])


class ChainFitter:
    """Fitter of the last links to cells."""

    def __init__(self, model: ArmModel) -> None:
        self._model = model
        q = np.repeat(USUAL_Q[None, None], N_JOINTS, axis=0).repeat(_ANGLES, axis=1)
        for joint in range(N_JOINTS):
            q[joint, :, joint] = np.linspace(model.lower[joint], model.upper[joint], _ANGLES)
        self._angle = q[np.arange(N_JOINTS), :, np.arange(N_JOINTS)]
        X = model.poses(q.reshape(-1, N_JOINTS)).reshape(N_JOINTS, _ANGLES, -1, 4, 4)
        self._X_after = np.stack([invert(X[j, :, ARM[j]]) @ X[j, :, ARM[j + 1]] for j in range(N_JOINTS)])
        self._X_7H = invert(X[0, 0, RobotPart.LINK7]) @ X[0, 0, RobotPart.HAND]

    def at(self, X_CH: Array, q: Array) -> ChainModel:
        """Return the chain at a pose (4, 4) of panda_hand in the camera frame [m] and joint angles (7,) [rad]."""
        return ChainModel(model=self._model, X_CH=X_CH[None], q=q[None], q_start=q[None])

    def fit(self, cells: Correspondences) -> Solution[ChainModel] | None:
        """Fit the chain to cells of links; None if the last links are not seen."""
        if (cells.part == RobotPart.LINK7).sum() < MIN_LINK_CELLS:
            return None
        solutions = []
        for root in _ROOTS:
            own = cells.take(cells.part == root)
            enough = len(own) >= MIN_ROOT_CELLS
            solution = self.refit(self._follow(root, own, cells), cells, iterations=15) if enough else None
            if solution is not None:
                square = np.minimum((solution.residual[:, :2] ** 2).sum(axis=1), COST_CAP)
                solutions.append((float(square.mean()), solution))
        return min(solutions, key=lambda pair: pair[0])[1] if solutions else None

    def turned(self, chain: ChainModel, angle_rad: Array, sigma_rad: float = POSTURE_SIGMA_RAD) -> ChainModel:
        """Return a single chain with its last joint at each of some angles (M,), the other links where they are.

        The angles [rad] have a prior with the standard deviation `sigma_rad`.
        """
        q = np.repeat(chain.q, len(angle_rad), axis=0)
        q[:, -1] = angle_rad
        before, after = (self._model.poses(posture) for posture in (chain.q, q))
        X_6H, X_6T = (invert(X[:, RobotPart.LINK6]) @ X[:, RobotPart.HAND] for X in (before, after))
        q_sigma = np.array([*chain.q_sigma[:-1], sigma_rad])
        return replace(chain, X_CH=chain.X_CH @ invert(X_6H) @ X_6T, q=q, q_start=q, q_sigma=q_sigma)

    @staticmethod
    def refit(
        chain: ChainModel, cells: Correspondences, log_depth_factor: Array | None = None, iterations: int = 8
    ) -> Solution[ChainModel] | None:
        """Fit a chain, from its present state, to cells of one frame; None if that diverges."""
        stacked = Correspondences.stack([cells])
        solution = solve(chain, stacked, [LINKS_DEPTH_SIGMA], log_depth_factor, iterations=iterations)
        return solution if solution.valid[0] else None

    def _follow(self, root: RobotPart, own: Correspondences, cells: Correspondences) -> ChainModel:
        """Return the chain from the pose of one link, joint by joint to both sides."""
        X_root = _align_robustly(own)
        q = USUAL_Q.copy()
        X = X_root
        for part in range(root + 1, RobotPart.LINK7 + 1):
            joint = part - ARM[1]
            k = self._best(cells, part, X @ self._X_after[joint], joint)
            q[joint] = self._angle[joint, k]
            X = X @ self._X_after[joint, k]
        X_CH = X @ self._X_7H
        X = X_root
        for part in range(root - 1, RobotPart.LINK0 - 1, -1):
            joint = part - ARM[0]
            k = self._best(cells, part, X @ invert(self._X_after[joint]), joint)
            q[joint] = self._angle[joint, k]
            X = X @ invert(self._X_after[joint, k])
        return self.at(X_CH, q)

    def _best(self, cells: Correspondences, part: int, X_CP: Array, joint: int) -> int:
        """Return the number of the angle at which a link at poses `X_CP` (M, 4, 4) matches its cells best."""
        own = cells.take(cells.part == part)
        if len(own) < _LEAST_CELLS:
            return int(np.abs(self._angle[joint] - USUAL_Q[joint]).argmin())
        return int(misfit(own, X_CP).argmin())


def misfit(cells: Correspondences, X_CP: Array) -> Array:
    """Return the mean squared residual (M,), capped, of cells of one link at each of its poses (M, 4, 4) [sigmas]."""
    cells = cells.take(np.linspace(0, len(cells) - 1, min(len(cells), _COMPARED)).astype(int))
    p_C = np.einsum("mij,nj->mni", X_CP[:, :3, :3], cells.p_P) + X_CP[:, None, :3, 3]
    p_L = np.einsum("nij,mnj->mni", cells.R_LC, p_C)
    square = (p_L[..., :2] ** 2).sum(axis=-1) / cells.sigma_m[:, 0] ** 2
    return np.asarray(np.where(p_L[..., 2] > 0, np.minimum(square, COST_CAP), COST_CAP).mean(axis=1))


def _align_robustly(cells: Correspondences) -> Array:
    """Return the pose (4, 4) of the part in the camera frame that matches its cells, by reweighted least squares."""
    weight = 1.0 / (cells.sigma_m[:, 0] ** 2 + (cells.range_sigma * cells.range_m) ** 2)
    robust = np.ones(len(cells))
    X = np.eye(4)
    for _ in range(_ALIGN_PASSES):
        X = align(cells.p_C, cells.p_P, weight * robust)
        error = np.linalg.norm(cells.p_C - cells.p_P @ X[:3, :3].T - X[:3, 3], axis=1)
        robust = 1.0 / (1.0 + (error / (2 * max(float(np.median(error)), 1e-4))) ** 2)
    return X
