"""Pose of the flange in one image: the last links, and a gripper of known shape, fitted to cells and edges.

Cells give the posture, contours on edges of the image sharpen it. The last link is nearly round: its turn about the
flange comes from its grip, which stands out on one side, and from the gripper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.arm_fit import FOLLOWED_REACHES_PX, LAST_LINKS, ArmFit
from kinebench_drake.grounding.registration.chain_fit import MIN_LINK_CELLS, UNKNOWNS, ChainFitter, ChainModel, misfit
from kinebench_drake.grounding.registration.edges import OPENINGS, FlangeShape
from kinebench_drake.grounding.registration.fit import HandFit
from kinebench_drake.grounding.registration.image import GradientImage, follow_surface
from kinebench_drake.grounding.registration.solver import Correspondences, Solution
from kinebench_drake.grounding.tracking.markov import TURNS_RAD
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.panda.description import ARM, RobotPart

REACHES_PX = (8.0, 5.0, 3.0, 2.0)
"""Farthest edges of the last links in successive passes [px]."""
_WIDE_REACHES_PX = (14.0, 10.0, *FOLLOWED_REACHES_PX)
"""The same of a gripper, which the links place only roughly [px]."""
_LINKS = (RobotPart.LINK4, *LAST_LINKS)
"""Links whose edges are matched."""
_FLANGE = (RobotPart.LINK7,)
_POINTS = 300
_STARTS = 4
"""Turns from which a frame is fitted with a gripper."""
_START_SIGMA_RAD = np.deg2rad(15.0)
"""Standard deviation of their prior [rad]."""
_ON_EDGES = 15.0
"""Log-likelihood of a turn per share of contours on edges."""
_OFF_CELLS = 0.5
"""Log-likelihood of a turn lost per misfit of cells."""
_ON_GRIPPER = 30.0
"""Log-likelihood of a turn per share of the gripper's contours on edges: they stand out on two sides."""
_UNSEEN_SIGMA_M = 0.1
_BEHIND_M = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FlangeView:
    """What one frame shows of the last links."""

    view: GripperView
    """Dense estimates of their crop."""
    cells: Correspondences
    """Cells of links in this view and in that of the whole arm."""
    image: GradientImage


class FlangeFitter:
    """Fitter of the last links, with one gripper, to single frames."""

    def __init__(self, chain: ChainFitter, shape: FlangeShape) -> None:
        """Fit chains of `chain` with the contours of `shape`."""
        self._chain = chain
        self.shape = shape

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

    def fit_gripper(self, pose: FramePose, shown: FlangeView) -> FramePose | None:
        """Return the pose with the contours of the gripper, from the likeliest turns of the last joint; or None."""
        chain = self.chain_of(pose)
        coarse = FlangeFitter(self._chain, replace(self.shape, edges=self.shape.edges[:: OPENINGS // 2]))
        likeliest = _peaks(coarse.log_likelihood(chain, TURNS_RAD, shown.view, shown.image, pose.overlap))[:_STARTS]
        fits = [
            self.fit_turned(chain, turn_rad, _START_SIGMA_RAD, shown, _WIDE_REACHES_PX)
            for turn_rad in TURNS_RAD[likeliest]
        ]
        return max((fit for fit in fits if fit is not None), key=lambda fit: self._support(fit, 0.0), default=None)

    def support(self, pose: FramePose, image: GradientImage) -> float:
        """Return the log-likelihood of the gripper by a pose that was fitted with it to an image."""
        X_CP = self._place(self.chain_of(pose))[0]
        return self._support(pose, _ON_GRIPPER * float(self.shape.gripper_agreement(image, X_CP).max()))

    def log_likelihood(
        self, chain: ChainModel, turns_rad: Array, view: GripperView, image: GradientImage, agreement: float
    ) -> Array:
        """Return the log-likelihoods (M,) of turns (M,) of a chain's last joint [rad] by what turns with it.

        The `agreement` of the contours of the links with edges of the image says how much edges tell there.
        """
        X_CP = self._place(self._chain.turned(chain, turns_rad))
        on_edges = _ON_EDGES * np.array([self.shape.edges[0].agreement(image, X, _FLANGE) for X in X_CP])
        by_links = np.asarray(agreement * on_edges - _OFF_CELLS * _off_cells(view, X_CP))
        if not self.shape.gripper:
            return by_links
        return by_links + self.gripper_log_likelihood(chain, turns_rad, image, agreement)

    def gripper_log_likelihood(
        self, chain: ChainModel, turns_rad: Array, image: GradientImage, agreement: float
    ) -> Array:
        """Return the log-likelihoods (M,) of turns by the contours of the gripper alone; see `log_likelihood`.

        After half a turn it looks alike, so its contours are projected at one of two such turns only.
        """
        _, first, same = np.unique((turns_rad % np.pi).round(6), return_index=True, return_inverse=True)
        X_CP = self._place(self._chain.turned(chain, turns_rad[first]))
        return _ON_GRIPPER * agreement * np.array([self.shape.gripper_agreement(image, X).max() for X in X_CP])[same]

    def at_likeliest(self, chain: ChainModel, image: GradientImage) -> "FlangeFitter":
        """Return a fitter with the opening of the gripper alone whose contours lie best on edges."""
        return FlangeFitter(self._chain, self.shape.at_likeliest(image, self._place(chain)[0]))

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
        X_CP = self._place(chain)[0]
        return follow_surface(self.shape.at_likeliest(before, X_CP).edges[0].caster, X_CP, before, after)

    def chain_of(self, pose: FramePose) -> ChainModel:
        """Return the chain of a pose."""
        if pose.arm is None:
            raise ValueError("a pose of the flange has a posture")
        return self._chain.at(pose.X_CH, pose.arm.q)

    def _place(self, chain: ChainModel, links: Sequence[RobotPart] = LAST_LINKS) -> Array:
        """Return the poses (B, PARTS, 4, 4) of the parts; with a gripper, which little hides, without the upper arm."""
        X_CP = chain.place().X_CP
        return _without_upper_arm(X_CP, links) if self.shape.gripper else X_CP

    def _move(
        self, start: ChainModel, before: GradientImage, after: GradientImage
    ) -> tuple[ChainModel, Correspondences] | None:
        """Return a chain moved to the next image by the points of its surface there, and these points."""
        points = self.flow(start, before, after)
        moved = None if points is None else self._chain.refit(start, points)
        return None if points is None or moved is None else (moved.model, points)

    def _support(self, pose: FramePose, on_gripper: float) -> float:
        off_cells = _off_cells(pose.view, self._place(self.chain_of(pose)))[0]
        return float(pose.overlap * (_ON_EDGES + on_gripper) - _OFF_CELLS * off_cells)

    def _fit(self, start: ChainModel, shown: FlangeView, reaches_px: Sequence[float] = REACHES_PX) -> FramePose | None:
        chain = self._sharpen(start, shown.cells, shown.image, reaches_px)
        return None if chain is None else self._pose(chain, shown.image, shown.view)

    def _sharpen(
        self, start: ChainModel, points: Correspondences, image: GradientImage, reaches_px: Sequence[float]
    ) -> Solution[ChainModel] | None:
        """Fit a chain to points of the links and to edges together; None if it diverges or no edges are near."""
        chain = None
        (matcher,) = self.shape.at_likeliest(image, self._place(start, _LINKS)[0]).edges
        parts = (*_LINKS, *self.shape.gripper)
        for reach_px in reaches_px:
            model = start if chain is None else chain.model
            edges = matcher.match(image, self._place(model, _LINKS)[0], reach_px, parts, _POINTS)
            if edges is None:
                break
            depth = None if chain is None else chain.log_depth_factor
            chain = self._chain.refit(model, Correspondences.join([points, edges]), depth) or chain
        return chain

    def _pose(self, chain: Solution[ChainModel], image: GradientImage, view: GripperView) -> FramePose:
        """Return the pose of a frame; in place of a hand it has the last link and the residual of the chain."""
        flange = view.part == RobotPart.LINK7
        X_CP = _without_upper_arm(chain.model.place().X_CP[0])
        shape = self.shape.at_likeliest(image, X_CP)
        arm = ArmFit(
            q=chain.model.q[0],
            X_CH=chain.model.X_CH[0],
            covariance=np.asarray(np.linalg.inv(chain.information[0] + 1e-6 * np.eye(UNKNOWNS))[:6, :6]),
            edge_agreement=shape.agreement(image, X_CP, LAST_LINKS),
            hand_agreement=shape.agreement(image, X_CP, _FLANGE),
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


def _without_upper_arm(X_CP: Array, links: Sequence[RobotPart] = LAST_LINKS) -> Array:
    """Return poses (..., PARTS, 4, 4) with all but the last `links` behind the camera.

    Without a base their postures are hardly known, and one that hides a bad contour must not look better.
    """
    X_CP = X_CP.copy()
    X_CP[..., ARM[: -len(links)], :3, 3] = [0.0, 0.0, -_BEHIND_M]
    return X_CP


def _off_cells(view: GripperView, X_CP: Array) -> Array:
    """Return the misfit (M,) of the cells of the last link, with parts at `X_CP` (M, PARTS, 4, 4); 0 without cells."""
    cells = Correspondences.of_view(view, view.part == RobotPart.LINK7)
    return misfit(cells, X_CP[:, RobotPart.LINK7]) if len(cells) >= MIN_LINK_CELLS else np.zeros(len(X_CP))


def _peaks(values: Array) -> list[int]:
    """Return the numbers of the local maxima of `values` (N,), highest first."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    peak = (values >= padded[:-2]) & (values > padded[2:])
    return sorted(np.flatnonzero(peak).tolist(), key=lambda k: -values[k])
