"""Pose of the flange in one image: the last links fitted to cells and edges.

Cells give the posture, contours on edges of the image sharpen it. The last link is nearly round: its turn about the
flange comes from its grip, which stands out on one side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp
from kinebench_drake.grounding.registration.arm_fit import FOLLOWED_REACHES_PX, LAST_LINKS, LINKS_DEPTH_SIGMA, ArmFit
from kinebench_drake.grounding.registration.arm_model import (
    COST_CAP,
    POSTURE_SIGMA_RAD,
    USUAL_Q,
    ArmModel,
    joint_twist,
)
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.fit import HandFit, align, pose_twist
from kinebench_drake.grounding.registration.image import GradientImage, follow_surface
from kinebench_drake.grounding.registration.solver import Correspondences, PartPlacement, Solution, solve
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.view import GripperView
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
REACHES_PX = (8.0, 5.0, 3.0, 2.0)
"""Farthest edges of the last links in successive passes [px]."""
_LINKS = (RobotPart.LINK4, *LAST_LINKS)
"""Links whose edges are matched."""
_FLANGE = (RobotPart.LINK7,)
_POINTS = 300
_ON_EDGES = 15.0
"""Log-likelihood of a turn per share of contours on edges."""
_OFF_CELLS = 0.5
"""Log-likelihood of a turn lost per misfit of cells."""
_UNSEEN_SIGMA_M = 0.1
_BEHIND_M = 10.0


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
        X_BP, axis, point = self.model.poses_and_axes(self.q)
        X_CB = self.X_CH @ invert(X_BP[:, RobotPart.HAND])
        return PartPlacement(
            X_CP=X_CB[:, None] @ X_BP,
            finger_m=None,
            twist=np.concatenate([pose_twist(self.X_CH), joint_twist(X_CB, axis, point)], axis=2),
            moves=np.hstack([np.ones((len(RobotPart), 6)), self.model.moves - 1.0]),
        )

    def prior(self) -> tuple[Array, Array]:
        """Return the information (B, 13, 13) that keeps unobserved joints near `q_start`, and its gradient (B, 13)."""
        gradient = np.zeros((len(self.q), 6 + N_JOINTS))
        gradient[:, 6:] = (self.q - self.q_start) / self.q_sigma**2
        return np.tile(np.diag([*[0.0] * 6, *self.q_sigma**-2]), (len(self.q), 1, 1)), gradient

    def updated(self, step: Array) -> Self:
        """Return the chains after a change (B, 13) of their parameters, within the joint limits."""
        X_CH = make_pose(rotation_exp(step[:, :3]) @ self.X_CH[:, :3, :3], self.X_CH[:, :3, 3] + step[:, 3:6])
        return replace(self, X_CH=X_CH, q=self.model.clip(self.q + step[:, 6:]))

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
        roots = {root: cells.take(cells.part == root) for root in _ROOTS}
        solutions = [
            self.refit(self._follow(root, own, cells), cells, iterations=15)
            for root, own in roots.items()
            if len(own) >= MIN_ROOT_CELLS
        ]

        def cost(solution: Solution[ChainModel]) -> float:
            return float(np.minimum((solution.residual[:, :2] ** 2).sum(axis=1), COST_CAP).mean())

        return min((solution for solution in solutions if solution is not None), key=cost, default=None)

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
        unusual = np.abs(self._angle[joint] - USUAL_Q[joint])
        return int((misfit(own, X_CP) if len(own) >= _LEAST_CELLS else unusual).argmin())


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


@dataclass(frozen=True, slots=True, kw_only=True)
class FlangeView:
    """What one frame shows of the last links."""

    view: GripperView
    """Dense estimates of their crop."""
    cells: Correspondences
    """Cells of links in this view and in that of the whole arm."""
    image: GradientImage


@dataclass(frozen=True, slots=True)
class FlangeFitter:
    """Fitter of the last links to single frames."""

    _chain: ChainFitter
    edges: EdgeMatcher

    def detect(self, shown: FlangeView, near: FramePose | None = None) -> FramePose | None:
        """Return the pose in a frame by its cells, or from the posture `near` in a neighbouring one on.

        None if it does not show the last links, or the fit diverges.
        """
        chain = self._chain.fit(shown.cells) if near is None else self._chain.refit(self.chain_of(near), shown.cells)
        return None if chain is None else self._fit(chain.model, shown)

    def follow(self, near: FramePose, before: GradientImage, after: GradientImage) -> FramePose | None:
        """Return the pose in an image by the surface of the arm, followed from a neighbouring one; or None."""
        moved = self._move(self.chain_of(near), before, after)
        chain = None if moved is None else self._sharpen(*moved, after, FOLLOWED_REACHES_PX)
        return None if chain is None else self._pose(chain, after, near.view)

    def fit_turned(
        self,
        chain: ChainModel,
        turn_rad: float,
        sigma_rad: float,
        shown: FlangeView,
        reaches_px: Sequence[float],
        points: Sequence[Correspondences] = (),
    ) -> FramePose | None:
        """Return the pose in a frame from a chain with its last joint turned; None if the fit diverges.

        The angle `turn_rad` of that joint has the standard deviation `sigma_rad`; further `points` of the links are
        followed from neighbouring frames.
        """
        start = self._chain.turned(chain, np.array([turn_rad]), sigma_rad)
        return self._fit(start, replace(shown, cells=Correspondences.join([shown.cells, *points])), reaches_px)

    def log_likelihood(
        self, chain: ChainModel, turns_rad: Array, view: GripperView, image: GradientImage, agreement: float
    ) -> Array:
        """Return the log-likelihoods (M,) of turns (M,) of a chain's last joint [rad] by what turns with it.

        The `agreement` of the contours of the links with edges of the image says how much edges tell there.
        """
        X_CP = self._chain.turned(chain, turns_rad).place().X_CP
        on_edges = _ON_EDGES * np.array([self.edges.agreement(image, X, _FLANGE) for X in X_CP])
        return np.asarray(agreement * on_edges - _OFF_CELLS * _off_cells(view, X_CP))

    def turn_change(
        self, chain: ChainModel, chain_after: ChainModel, before: GradientImage, after: GradientImage
    ) -> float:
        """Return the change of the last joint from one image to the next by the surface of the arm [rad]; or NaN.

        The surface carries the last link itself: errors of the links before it, which differ between frames, cancel.
        """
        moved = self._move(chain, before, after)
        if moved is None:
            return float("nan")
        R = chain_after.X_CH[0, :3, :3].T @ moved[0].X_CH[0, :3, :3]
        turn = np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
        return float((chain_after.q[0, -1] + turn - chain.q[0, -1] + np.pi) % (2 * np.pi) - np.pi)

    def flow(self, chain: ChainModel, before: GradientImage, after: GradientImage) -> Correspondences | None:
        """Return the points of the arm's surface in one image where another shows them; None if too few."""
        return follow_surface(self.edges.caster, chain.place().X_CP[0], before, after)

    def chain_of(self, pose: FramePose) -> ChainModel:
        """Return the chain of a pose."""
        if pose.arm is None:
            raise ValueError("a pose of the flange has a posture")
        return self._chain.at(pose.X_CH, pose.arm.q)

    def _move(
        self, start: ChainModel, before: GradientImage, after: GradientImage
    ) -> tuple[ChainModel, Correspondences] | None:
        """Return a chain moved to the next image by the points of its surface there, and these points."""
        points = self.flow(start, before, after)
        moved = None if points is None else self._chain.refit(start, points)
        return None if points is None or moved is None else (moved.model, points)

    def _fit(self, start: ChainModel, shown: FlangeView, reaches_px: Sequence[float] = REACHES_PX) -> FramePose | None:
        chain = self._sharpen(start, shown.cells, shown.image, reaches_px)
        return None if chain is None else self._pose(chain, shown.image, shown.view)

    def _sharpen(
        self, start: ChainModel, points: Correspondences, image: GradientImage, reaches_px: Sequence[float]
    ) -> Solution[ChainModel] | None:
        """Fit a chain to points of the links and to edges together; None if it diverges or no edges are near."""
        chain = None
        for reach_px in reaches_px:
            model = start if chain is None else chain.model
            edges = self.edges.match(image, model.place().X_CP[0], reach_px, _LINKS, _POINTS)
            if edges is None:
                break
            depth = None if chain is None else chain.log_depth_factor
            chain = self._chain.refit(model, Correspondences.join([points, edges]), depth) or chain
        return chain

    def _pose(self, chain: Solution[ChainModel], image: GradientImage, view: GripperView) -> FramePose:
        """Return the pose of a frame; in place of a hand it has the last link and the residual of the chain."""
        flange = view.part == RobotPart.LINK7
        X_CP = _without_upper_arm(chain.model.place().X_CP[0])
        arm = ArmFit(
            q=chain.model.q[0],
            X_CH=chain.model.X_CH[0],
            covariance=np.asarray(np.linalg.inv(chain.information[0] + 1e-6 * np.eye(UNKNOWNS))[:6, :6]),
            edge_agreement=self.edges.agreement(image, X_CP, LAST_LINKS),
            hand_agreement=self.edges.agreement(image, X_CP, _FLANGE),
        )
        hand = HandFit(
            X_CH=arm.X_CH,
            depth_factor=float(np.exp(chain.log_depth_factor[0])),
            residual=chain.growth(0),
            points=int(flange.sum()),
            sigma_m=float(np.median(view.coordinates_sigma_m[flange])) if flange.any() else _UNSEEN_SIGMA_M,
            covariance=arm.covariance,
        )
        return FramePose(
            X_CH=arm.X_CH,
            hand=hand,
            hand_without_silhouette=hand,
            arm=arm,
            view=view,
            overlap=arm.edge_agreement,
        )


def _without_upper_arm(X_CP: Array) -> Array:
    """Return poses (..., PARTS, 4, 4) with all but the last links behind the camera.

    Without a base their postures are hardly known, and one that hides a bad contour must not look better.
    """
    X_CP = X_CP.copy()
    X_CP[..., ARM[: -len(LAST_LINKS)], :3, 3] = [0.0, 0.0, -_BEHIND_M]
    return X_CP


def _off_cells(view: GripperView, X_CP: Array) -> Array:
    """Return the misfit (M,) of the cells of the last link, with parts at `X_CP` (M, PARTS, 4, 4); 0 without cells."""
    cells = Correspondences.of_view(view, view.part == RobotPart.LINK7)
    return misfit(cells, X_CP[:, RobotPart.LINK7]) if len(cells) >= MIN_LINK_CELLS else np.zeros(len(X_CP))
