"""Fit of the gripper's pose to one view, from CAD coordinates and depth: closed form, then robust least squares."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, cross, make_pose, orthonormalize, rotation_exp
from kinebench_drake.grounding.priors import ExternalDepth
from kinebench_drake.grounding.registration.solver import Correspondences, PartPlacement, Rows, Solution, solve
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.panda.cad import MAX_FINGER_M
from kinebench_drake.models.panda.description import RobotPart

MIN_CELLS = 12
"""Least number of gripper cells for a fit."""
UNSEEN_FINGER_M = 0.02
"""Assumed finger travel where none is measured [m]."""
_MAX_CELLS = 400
"""Greatest number of cells of the gripper in a view that are fitted."""
_INDEPENDENT = 40.0
"""Independent measurements that these count as at most."""
_MIN_FINGER_CELLS = 6
_FIXED = 1e12
"""Information of a fixed parameter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HandModel(Rows):
    """`FitModel` of free hands; 7 parameters: rotation about the camera's axes, translation, finger travel."""

    X_CH: Array
    """(B, 4, 4) poses of panda_hand in the camera frame [m]."""
    finger_m: Array
    """(B,) travel of each finger, 0..0.04 [m]."""
    finger_free: NDArray[np.bool_]
    """(B,) whether the travel is estimated; not if it comes from priors or too little of the fingers is visible."""
    pose_free: NDArray[np.bool_]
    """(B,) whether the pose is estimated."""
    max_finger_m: Array
    """(B,) greatest travel of each finger [m]."""

    def place(self) -> PartPlacement:
        """Return the poses of the parts: all of them move with the hand."""
        return PartPlacement(
            X_CP=np.repeat(self.X_CH[:, None], len(RobotPart), axis=1),
            finger_m=self.finger_m,
            twist=pose_twist(self.X_CH),
            moves=np.ones((len(RobotPart), 6)),
        )

    def prior(self) -> tuple[Array, Array]:
        """Return the information (B, 7, 7) that fixes what is not free, and its gradient, 0."""
        information = np.zeros((len(self.X_CH), 7, 7))
        information[:, range(6), range(6)] = np.where(self.pose_free, 0.0, _FIXED)[:, None]
        information[:, 6, 6] = finger_information(self.finger_free)
        return information, np.zeros((len(self.X_CH), 7))

    def updated(self, step: Array) -> Self:
        """Return the hands after a change (B, 7) of their parameters, fingers within their range."""
        X_CH = make_pose(rotation_exp(step[:, :3]) @ self.X_CH[:, :3, :3], self.X_CH[:, :3, 3] + step[:, 3:6])
        return replace(self, X_CH=X_CH, finger_m=np.clip(self.finger_m + step[:, 6], 0.0, self.max_finger_m))


def pose_twist(X_CH: Array) -> Array:
    """Return the twists (B, 6, 6), as in `PartPlacement`, of hands (B, 4, 4): turn about the camera's axes, shift."""
    twist = np.zeros((len(X_CH), 6, 6))
    twist[:, :3, :3] = twist[:, 3:, 3:] = np.eye(3)
    twist[:, 3:, :3] = cross(X_CH[:, None, :3, 3], np.eye(3)).swapaxes(1, 2)
    return twist


def finger_or_default(finger_m: float) -> float:
    """Return the finger travel [m], or `UNSEEN_FINGER_M` for NaN."""
    return finger_m if np.isfinite(finger_m) else UNSEEN_FINGER_M


def finger_information(free: NDArray[np.bool_]) -> Array:
    """Return the prior information (B,) about the finger travel [1/m^2]: next to none if it is free."""
    return np.where(free, 1.0, _FIXED)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandFit:
    """Pose of the hand fitted to one view."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float = float("nan")
    """Travel of each finger, 0..0.04 [m]; NaN if it is neither visible nor from priors."""
    finger_free: bool = False
    """True if the travel was estimated."""
    finger_sigma_m: float = float("nan")
    """Standard deviation of the travel [m], from the cells' sigmas."""
    depth_factor: float
    """True depth over estimated depth."""
    residual: float
    """Robustly weighted root mean square of the coordinate residuals, in standard deviations."""
    points: int
    """Number of gripper cells."""
    sigma_m: float
    """Median standard deviation of the CAD coordinates [m]."""
    covariance: Array
    """(6, 6) covariance of rotation about the camera's axes [rad] and position [m], from the cells' sigmas."""


def gripper_cells(view: GripperView) -> Correspondences:
    """Return the correspondences of hand and fingers in a view."""
    return Correspondences.of_view(view, view.gripper, _MAX_CELLS, _INDEPENDENT)


def align(p_A: Array, p_B: Array, weight: Array) -> Array:
    """Return the poses X_AB (..., 4, 4) of least weighted squares |p_A - X_AB p_B| (Umeyama 1991, without scale).

    Points (..., N, 3) [m] have weights (..., N).
    """
    w = (weight / weight.sum(axis=-1, keepdims=True))[..., None]
    mean_A = (w * p_A).sum(axis=-2)
    mean_B = (w * p_B).sum(axis=-2)
    covariance = np.swapaxes((p_A - mean_A[..., None, :]) * w, -1, -2) @ (p_B - mean_B[..., None, :])
    R = orthonormalize(covariance)
    return make_pose(R, mean_A - (R @ mean_B[..., None])[..., 0])


def _closed_form(cells: Correspondences, finger_m: Array, max_finger_m: float) -> HandModel:
    """Estimate poses and finger travels of B frames by iteratively reweighted 3-D to 3-D alignment of cells (B, N).

    Travels from priors, `finger_m` (B,) [m], are kept; NaN where there is none.
    """
    cloud = cells.p_C
    sign = cells.opening_sign
    exists = cells.weight > 0
    weight = exists / (cells.sigma_m[..., 0] ** 2 + (cells.range_sigma * cells.range_m) ** 2)
    unknown = np.isnan(finger_m)
    finger = np.where(unknown, UNSEEN_FINGER_M, finger_m)
    robust = np.ones(exists.shape)
    X_CH = np.tile(np.eye(4), (len(cloud), 1, 1))
    for _ in range(6):
        model_H = cells.p_P.copy()
        model_H[..., 1] += sign * finger[:, None]
        X_CH = align(cloud, model_H, weight * robust)
        cloud_H = (cloud - X_CH[:, None, :3, 3]) @ X_CH[:, :3, :3]
        error = np.sqrt(((cloud_H - model_H) ** 2).sum(axis=-1))
        scale = np.maximum(masked_median(error, exists), 1e-4)[:, None]
        robust = 1.0 / (1.0 + (error / (2 * scale)) ** 2)
        w = weight * robust * np.abs(sign)
        travel = (w * sign * (cloud_H - cells.p_P)[..., 1]).sum(axis=1) / np.maximum(w.sum(axis=1), 1e-9)
        finger = np.where(unknown & (w.sum(axis=1) > 0), np.clip(travel, 0.0, max_finger_m), finger)
    visible = (exists & (sign != 0)).sum(axis=1) >= _MIN_FINGER_CELLS
    return HandModel(
        X_CH=X_CH,
        finger_m=finger,
        finger_free=unknown & visible,
        pose_free=np.ones(len(cloud), dtype=bool),
        max_finger_m=np.full(len(cloud), max_finger_m),
    )


def masked_median(values: Array, exists: NDArray[np.bool_]) -> Array:
    """Return the medians (B,) of the `values` (B, N) that exist; each row has one at least."""
    ordered = np.sort(np.where(exists, values, np.inf), axis=1)
    count = exists.sum(axis=1)[:, None]
    middle = [np.take_along_axis(ordered, (count - offset) // 2, axis=1) for offset in (0, 1)]
    return np.asarray(0.5 * (middle[0] + middle[1])[:, 0])


def _fits_of(
    solution: Solution[HandModel], cells: Sequence[Correspondences], points: Sequence[int], has_finger: Sequence[bool]
) -> list[HandFit | None]:
    """Return the fits of B frames; None where they diverged."""
    hand = solution.model
    covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(7))
    return [
        HandFit(
            X_CH=hand.X_CH[b],
            finger_m=float(hand.finger_m[b]) if hand.finger_free[b] or has_finger[b] else float("nan"),
            finger_free=bool(hand.finger_free[b]),
            finger_sigma_m=float(covariance[b, 6, 6] ** 0.5),
            depth_factor=float(np.exp(solution.log_depth_factor[b])),
            residual=solution.growth(b, len(cells[b])),
            points=points[b],
            sigma_m=float(np.median(cells[b].sigma_m[:, 0])),
            covariance=np.asarray(covariance[b, :6, :6]),
        )
        if solution.valid[b]
        else None
        for b in range(len(cells))
    ]


def fit(view: GripperView, max_finger_m: float = MAX_FINGER_M) -> HandFit | None:
    """Fit the gripper to one view without priors; None where fewer than `MIN_CELLS` cells show it."""
    return fit_all([view], [None], [None], max_finger_m)[0]


def fit_all(
    views: Sequence[GripperView],
    X_CH: Sequence[Array | None],
    finger_m: Sequence[float | None],
    max_finger_m: float = MAX_FINGER_M,
) -> list[HandFit | None]:
    """Fit the gripper to one view each of B frames; None where fewer than `MIN_CELLS` cells show it.

    Args:
        views: dense estimates.
        X_CH: (4, 4) poses of panda_hand in the camera frame from priors [m].
        finger_m: travels of each finger from priors [m].
        max_finger_m: greatest travel of each finger [m].
    """
    fits: list[HandFit | None] = [None] * len(views)
    cells = {b: own for b, view in enumerate(views) if len(own := gripper_cells(view)) >= MIN_CELLS}
    if not cells:
        return fits
    stacked = Correspondences.stack(list(cells.values()))
    start = _closed_form(
        stacked, np.array([np.nan if finger_m[b] is None else finger_m[b] for b in cells], float), max_finger_m
    )
    fixed = {row: X for row, b in enumerate(cells) if (X := X_CH[b]) is not None}
    for row, X in fixed.items():
        start.X_CH[row] = X
        start.pose_free[row] = False
    solution = solve(start, stacked, np.array([views[b].depth_factor_sigma for b in cells]))
    points = [int(views[b].gripper.sum()) for b in cells]
    solved = _fits_of(solution, list(cells.values()), points, [finger_m[b] is not None for b in cells])
    for b, hand in zip(cells, solved, strict=True):
        fits[b] = hand
    return fits


def refit_all(
    hands: Sequence[HandFit],
    views: Sequence[GripperView],
    rims: Sequence[Correspondences],
    max_finger_m: float = MAX_FINGER_M,
) -> list[HandFit]:
    """Repeat the fits `hands` of B frames with the rims of their silhouettes; those that diverge stay unchanged."""
    if not hands:
        return []
    cells = [gripper_cells(view) for view in views]
    joined = Correspondences.stack([Correspondences.join(pair) for pair in zip(cells, rims, strict=True)])
    start = HandModel(
        X_CH=np.stack([hand.X_CH for hand in hands]),
        finger_m=np.array([finger_or_default(hand.finger_m) for hand in hands]),
        finger_free=np.array([hand.finger_free for hand in hands]),
        pose_free=np.ones(len(hands), dtype=bool),
        max_finger_m=np.full(len(hands), max_finger_m),
    )
    log_depth_factor = np.log([hand.depth_factor for hand in hands])
    solution = solve(start, joined, np.array([view.depth_factor_sigma for view in views]), log_depth_factor)
    has_finger = [bool(np.isfinite(hand.finger_m)) for hand in hands]
    fits = _fits_of(solution, cells, [hand.points for hand in hands], has_finger)
    return [hand if refitted is None else refitted for hand, refitted in zip(hands, fits, strict=True)]


def calibrate_depth(depth: ExternalDepth, view: GripperView, X_CH: Array, finger_m: float) -> ExternalDepth:
    """Scale the estimated depth of a video by the factor that puts the gripper at its known pose.

    That is the pose `X_CH` (4, 4) and the travel of each finger [m] in one frame, whose `view` has this depth.
    """
    cells = gripper_cells(view)
    if len(cells) < MIN_CELLS:
        return depth
    opened_H = cells.p_P + cells.opening_sign[:, None] * np.array([0.0, finger_m, 0.0])
    distance_m = np.linalg.norm(opened_H @ X_CH[:3, :3].T + X_CH[:3, 3], axis=1)
    return replace(depth, depth_m=depth.depth_m * float(np.median(distance_m / cells.range_m)), calibrated=True)
