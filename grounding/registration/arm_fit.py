"""Fit of the arm behind the gripper: the posture whose links and gripper match the image.

The base is fixed and the link lengths are known, so the arm determines where the hand is, above all its distance, which
the hand alone determines poorly. The initial posture comes from closed-form inverse kinematics of the hand's own pose
over the angles of the last joint; then all joints are fitted to the cells of links and gripper together.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.registration.arm_model import (
    ArmHandModel,
    ArmModel,
    find_posture,
    flip_evidence,
)
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.fit import (
    HandFit,
    HandModel,
    finger_or_default,
    gripper_cells,
    masked_median,
)
from kinebench_drake.grounding.registration.solver import CellRows, Solution, solve
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.panda.cad import open_fingers
from kinebench_drake.models.panda.description import RobotPart

# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_MAX_CONSISTENCY_PX = 6.0
"""Largest median distance between links as estimated and as posed of an arm that agrees [px of 384 px of width]."""
_MAX_ACROSS_M = 0.025
"""Largest deviation of a hand posed by an arm that agrees from the fit of the hand alone, across the view [m]."""
_MAX_ALONG_M = 0.08
"""The same along the line of sight [m]."""
_MAX_GROWTH = 1.4
"""Largest increase of the hand's residual by the arm: factor."""
_MAX_GROWTH_SIGMAS = 0.3
"""Summand of this increase [standard deviations]."""
_LINKS_ONLY_WEIGHT = 0.03
"""Weight of the hand's cells where the links alone determine its distance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmFit:
    """Posture of the arm fitted to the views of a frame."""

    q: Array
    """(7,) joint angles [rad]."""
    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame at this posture [m]."""
    finger_m: float = float("nan")
    """Travel of each finger [m]; NaN if no finger is visible."""
    finger_sigma_m: float = float("nan")
    """Standard deviation of the travel [m]."""
    agrees: bool = False
    """True if one posture explains both links and hand."""
    consistency_px: float = float("nan")
    """Median distance between the links as estimated and as posed [px of the frame]; NaN if not measured."""
    scale: float = float("nan")
    """Apparent size of the hand over its size at the distance given by the links; NaN if unknown."""
    evidence: float = 0.0
    """Log-likelihood ratio of the hand's pose against the 180-degree flip, from the links."""
    covariance: Array
    """(6, 6) covariance of the hand's rotation about the camera's axes [rad] and position [m]."""
    edge_agreement: float = float("nan")
    """Share of the contour of hand and wrist that lies on edges of the image; NaN if not measured."""
    hand_agreement: float = float("nan")
    """The same of the contour of the hand alone, or of the last link where no hand is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmView:
    """What a frame shows of the arm, and the fit of its hand alone."""

    hand: HandFit
    close: GripperView
    """View of the gripper's crop."""
    gripper: Correspondences
    """Cells of the gripper in that view."""
    links: Correspondences
    """Cells of the links in that view and in one that shows the arm."""

    @classmethod
    def of(cls, hand: HandFit, close: GripperView, wide: GripperView) -> Self:
        """Collect the cells of the views of a gripper's crop and of the arm."""
        links = Correspondences.join([Correspondences.of_view(v, v.arm) for v in (close, wide)])
        return cls(hand=hand, close=close, gripper=gripper_cells(close), links=links)

    @property
    def cells(self) -> Correspondences:
        """Cells of gripper and links."""
        return Correspondences.join([self.gripper, self.links])


class ArmFitter:
    """Fitter of the arm to views of one camera."""

    def __init__(self, camera: Camera, model: ArmModel, places: Array | None = None) -> None:
        """Create the fitter; a moving camera has `places` (T, 3) in the frame of `camera` [m]."""
        X_BC = camera.X_BC if places is None else camera.X_BC @ make_pose(np.eye(3), places)
        self._model = model
        self._camera = camera
        self._X_CB = invert(X_BC).reshape(-1, 4, 4)  # of each frame, or of all
        self._tolerance_px = _MAX_CONSISTENCY_PX * camera.unit_px

    def at(self, numbers: Sequence[int]) -> Self:
        """Return the fitter of some frames, in their order: this one, unless the camera moves."""
        if len(self._X_CB) == 1:
            return self
        fitter = copy(self)
        fitter._X_CB = self._X_CB[list(numbers)]
        return fitter

    def fit_all(self, views: Sequence[ArmView], rims: Sequence[Correspondences | None]) -> list[ArmFit | None]:
        """Fit the arms of B frames; None where too little of the arm is visible.

        Args:
            views: the frames.
            rims: correspondences of the hands' silhouettes (`SilhouetteMatcher.match`).
        """
        fits: list[ArmFit | None] = [None] * len(views)
        X_CB = self._bases(len(views))
        initial = {
            b: posture
            for b, view in enumerate(views)
            if (posture := find_posture(self._model, view.hand.X_CH, view.links, X_CB[b])) is not None
        }
        if not initial:
            return fits
        rows = list(initial)
        views = [views[b] for b in rows]
        rims = [rims[b] for b in rows]
        cells = [view.cells for view in views]
        joined = [
            own if rim is None else Correspondences.join([own, rim]) for own, rim in zip(cells, rims, strict=True)
        ]
        q = np.stack([q for q, _, _ in initial.values()])
        start = self._start(q, [view.hand.finger_m for view in views], views, X_CB[rows])
        sigma, log_depth_factor = depth_priors(views)
        solution = solve(start, Correspondences.stack(joined), sigma, log_depth_factor)
        scale = self._scale(solution, cells, views)
        fitted = self._arm_fits(solution, [view.links for view in views], [view.hand for view in views])
        for row, (b, arm) in enumerate(zip(rows, fitted, strict=True)):
            view = views[row]
            (_, cost, flipped_cost) = initial[b]
            if arm is not None:
                growth = solution.growth(row, len(view.gripper))
                agrees = arm.agrees and _is_consistent(arm.X_CH, view.hand, growth)
                evidence = flip_evidence(cost, flipped_cost)
                fits[b] = replace(arm, agrees=agrees, scale=float(scale[row]), evidence=evidence)
        return fits

    def _bases(self, count: int) -> Array:
        """Return the poses (count, 4, 4) of the base in the camera frames of `count` frames [m]."""
        return np.broadcast_to(self._X_CB, (count, 4, 4))

    def poses(self, arm: ArmFit) -> Array:
        """Return the poses (PARTS, 4, 4) of the parts of an arm in the camera frame [m]."""
        return open_fingers(self.closed(arm), finger_or_default(arm.finger_m))

    def closed(self, arm: ArmFit) -> Array:
        """Return the same with closed fingers."""
        return np.asarray(self._X_CB[0] @ self._model.poses(arm.q[None])[0])

    def _poses(self, arm: ArmHandModel) -> Array:
        """Return the poses (B, PARTS, 4, 4) of the parts in the camera frame [m]."""
        return open_fingers(arm.X_CB[:, None] @ self._model.poses(arm.q), arm.finger_m)

    def _start(self, q: Array, finger_m: Sequence[float], views: Sequence[ArmView], X_CB: Array) -> ArmHandModel:
        return ArmHandModel(
            model=self._model,
            X_CB=X_CB,
            q=q,
            q_start=q,
            finger_m=np.array([finger_or_default(travel) for travel in finger_m]),
            finger_free=np.array([view.hand.finger_free for view in views]),
        )

    def _arm_fits(
        self,
        solution: Solution[ArmHandModel],
        cells: Sequence[Correspondences],
        hands: Sequence[HandFit | None],
    ) -> list[ArmFit | None]:
        """Return the fits of B frames, without scale and evidence; None where they diverged.

        The distance of the `cells` of each frame is its consistency; the fingers are unknown without a fit of the hand.
        """
        arm = solution.model
        unknown = float("nan")
        covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(8))
        X_CH, J = arm.hand()
        of_hand = J @ covariance[:, :7, :7] @ J.swapaxes(1, 2)
        consistency = self._consistency_px(arm, cells)
        return [
            ArmFit(
                q=arm.q[b],
                X_CH=X_CH[b],
                finger_m=unknown if hand is None else float(arm.finger_m[b]) if hand.finger_free else hand.finger_m,
                finger_sigma_m=unknown if hand is None else float(covariance[b, 7, 7] ** 0.5),
                agrees=bool(consistency[b] <= self._tolerance_px),
                consistency_px=float(consistency[b]),
                covariance=of_hand[b],
            )
            if solution.valid[b]
            else None
            for b, hand in enumerate(hands)
        ]

    @staticmethod
    def _scale(solution: Solution[ArmHandModel], cells: Sequence[Correspondences], views: Sequence[ArmView]) -> Array:
        """Return the hands' distances (B,) according to the links over those according to their apparent sizes."""
        arm = solution.model
        (sigma, _) = depth_priors(views)
        stacked = Correspondences.stack(cells)
        by_links = np.where(stacked.part >= RobotPart.LINK0, 1.0, _LINKS_ONLY_WEIGHT) * stacked.weight
        by_links_only = replace(stacked, weight=by_links)
        links_solution = solve(arm, by_links_only, sigma, solution.log_depth_factor, iterations=4)
        free = HandModel(
            X_CH=np.stack([view.hand.X_CH for view in views]),
            finger_m=arm.finger_m,
            finger_free=arm.finger_free,
            pose_free=np.ones(len(views), dtype=bool),
        )
        by_size = Correspondences.stack([view.gripper for view in views])
        by_size = replace(by_size, range_sigma=np.full_like(by_size.range_sigma, np.inf))
        size_solution = solve(free, by_size, sigma, iterations=4)
        distances = [
            np.linalg.norm(X_CH[:, :3, 3], axis=1)
            for X_CH in (links_solution.model.hand()[0], size_solution.model.X_CH)
        ]
        return np.where(links_solution.valid & size_solution.valid, distances[0] / distances[1], np.nan)

    def _consistency_px(self, arm: ArmHandModel, links: Sequence[Correspondences]) -> Array:
        """Return the median distances (B,) between links as estimated and as posed [px of the frame]."""
        cells = Correspondences.stack(links)
        rows = CellRows.of(cells)
        p_L = rows.in_line_frames(rows.place(arm.X_CB[:, None] @ self._model.poses(arm.q))[0])
        distance = np.hypot(p_L[:, 0], p_L[:, 1]) / p_L[:, 2]
        return self._camera.fx * masked_median(distance, cells.weight > 0)


def depth_priors(views: Sequence[ArmView]) -> tuple[Array, Array]:
    """Return the relative standard deviations (B,) of the depth factors, and their logarithms (B,) by the hands."""
    sigma = np.array([view.close.depth_factor_sigma for view in views])
    return sigma, np.log([view.hand.depth_factor for view in views])


def _is_consistent(X_CH: Array, hand: HandFit, residual: float) -> bool:
    """Return whether a hand posed by its arm, with the `residual` of its cells there, is near the pose of its own."""
    along, across = _split(X_CH[:3, 3] - hand.X_CH[:3, 3], hand.X_CH[:3, 3])
    return bool(
        along <= _MAX_ALONG_M
        and across <= _MAX_ACROSS_M
        and pose_difference(X_CH, hand.X_CH)[1] <= bounds.MAX_ANGLE_RAD
        and residual <= _MAX_GROWTH * hand.residual + _MAX_GROWTH_SIGMAS
    )


def _split(difference: Array, direction: Array) -> tuple[float, float]:
    """Return the lengths of a difference (3,) along and across a direction (3,)."""
    along = float(difference @ direction / np.linalg.norm(direction))
    return abs(along), max(0.0, float(difference @ difference) - along**2) ** 0.5
