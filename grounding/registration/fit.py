"""Fit of the gripper's pose to one view, from CAD coordinates and depth: closed form, then robust least squares."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kinebench_drake.geometry import Array, make_pose, orthonormalize, rotation_exp
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.solver import Solution, solve
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.models.panda.cad import MAX_FINGER_M

MIN_CELLS = 12
"""Least number of gripper cells for a fit."""
UNSEEN_FINGER_M = 0.02
"""Assumed finger travel where none is measured [m]."""
_MAX_CELLS = 400
_INDEPENDENT = 40.0  # independent measurements that the gripper cells of a view count as
_MIN_FINGER_CELLS = 6
_FINGER_SIGMA_M = 1.0  # prior of a visible finger's travel: next to none
_FIXED = 1e12  # information of a fixed parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class HandModel:
    """`FitModel` of a free hand; 7 parameters: rotation about the camera's axes, translation, finger travel."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float
    """Travel of each finger, 0..0.04 [m]."""
    finger_free: bool
    """True if the travel is estimated; False if it comes from priors or too little of the fingers is visible."""
    pose_free: bool = True
    """True if the pose is estimated."""

    def predict(self, cells: Correspondences) -> tuple[Array, Array]:
        """Return the CAD points (N, 3) in the camera frame [m] and their derivatives (N, 3, 7)."""
        p_C, offset = place_hand(self.X_CH, self.finger_m, cells)
        d_p = np.zeros((len(cells), 3, 7))
        d_p[:, 0, 1], d_p[:, 0, 2] = offset[:, 2], -offset[:, 1]
        d_p[:, 1, 0], d_p[:, 1, 2] = -offset[:, 2], offset[:, 0]
        d_p[:, 2, 0], d_p[:, 2, 1] = offset[:, 1], -offset[:, 0]
        d_p[:, :, 3:6] = np.eye(3)
        d_p[:, :, 6] = cells.opening_sign[:, None] * self.X_CH[:3, 1]
        return p_C, d_p

    def prior(self) -> tuple[Array, Array]:
        """Return the information (7, 7) that fixes what is not free, and its gradient, 0."""
        pose = 0.0 if self.pose_free else _FIXED
        return np.diag([*[pose] * 6, finger_information(self.finger_free)]), np.zeros(7)

    def updated(self, step: Array) -> Self:
        """Return the hand after a change (7,) of its parameters, fingers within their range."""
        X_CH = make_pose(rotation_exp(step[:3]) @ self.X_CH[:3, :3], self.X_CH[:3, 3] + step[3:6])
        return replace(self, X_CH=X_CH, finger_m=clip_finger(self.finger_m + step[6]))


def place_hand(X_CH: Array, finger_m: float, cells: Correspondences) -> tuple[Array, Array]:
    """Return the CAD points (N, 3) of a gripper at `X_CH` (4, 4) in C [m], and their offsets (N, 3) from its origin."""
    opened_H = cells.p_P + cells.opening_sign[:, None] * np.array([0.0, finger_m, 0.0])
    offset = opened_H @ X_CH[:3, :3].T
    return offset + X_CH[:3, 3], offset


def clip_finger(finger_m: float) -> float:
    """Clip a finger travel to the gripper's range [m]."""
    return float(np.clip(finger_m, 0.0, MAX_FINGER_M))


def finger_or_default(finger_m: float) -> float:
    """Return the finger travel [m], or `UNSEEN_FINGER_M` for NaN."""
    return finger_m if np.isfinite(finger_m) else UNSEEN_FINGER_M


def finger_information(free: bool) -> float:
    """Return the prior information about the finger travel [1/m^2]."""
    return 1.0 / _FINGER_SIGMA_M**2 if free else _FIXED


@dataclass(frozen=True, slots=True, kw_only=True)
class HandFit:
    """Pose of the hand fitted to one view."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float
    """Travel of each finger, 0..0.04 [m]; NaN if it is neither visible nor from priors."""
    finger_free: bool
    """True if the travel was estimated."""
    finger_sigma_m: float
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
    """Return the pose X_AB (4, 4) of least weighted squares |p_A - X_AB p_B| (Umeyama 1991, without scale)."""
    w = weight / weight.sum()
    mean_A, mean_B = w @ p_A, w @ p_B
    covariance = ((p_A - mean_A) * w[:, None]).T @ (p_B - mean_B)
    R = orthonormalize(covariance)
    return make_pose(R, mean_A - R @ mean_B)


def _closed_form(cells: Correspondences, finger_m: float | None) -> HandModel:
    """Estimate pose and finger travel by iteratively reweighted 3-D to 3-D alignment."""
    cloud = cells.p_C
    weight = 1.0 / (cells.sigma_m[:, 0] ** 2 + (cells.range_sigma * cells.range_m) ** 2)
    finger, robust = UNSEEN_FINGER_M if finger_m is None else finger_m, np.ones(len(cloud))
    X_CH = np.eye(4)
    for _ in range(6):
        model_H = cells.p_P + cells.opening_sign[:, None] * [0.0, finger, 0.0]
        X_CH = align(cloud, model_H, weight * robust)
        cloud_H = (cloud - X_CH[:3, 3]) @ X_CH[:3, :3]
        error = np.linalg.norm(cloud_H - model_H, axis=1)
        scale = max(float(np.median(error)), 1e-4)
        robust = 1.0 / (1.0 + (error / (2 * scale)) ** 2)
        w = weight * robust * np.abs(cells.opening_sign)
        if finger_m is None and w.sum() > 0:
            finger = clip_finger(float((w * cells.opening_sign * (cloud_H - cells.p_P)[:, 1]).sum() / w.sum()))
    fingers_visible = (cells.opening_sign != 0).sum() >= _MIN_FINGER_CELLS
    return HandModel(X_CH=X_CH, finger_m=finger, finger_free=bool(finger_m is None and fingers_visible))


def _fit_of(solution: Solution[HandModel], cells: Correspondences, points: int, *, finger_known: bool) -> HandFit:
    hand, n = solution.model, len(cells)
    robust, r = solution.robust[:n], solution.residual[:n]
    covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(7))
    return HandFit(
        X_CH=hand.X_CH,
        finger_m=hand.finger_m if hand.finger_free or finger_known else float("nan"),
        finger_free=hand.finger_free,
        finger_sigma_m=float(covariance[6, 6] ** 0.5),
        depth_factor=float(np.exp(solution.log_depth_factor)),
        residual=float(np.sqrt((robust[:, :2] * r[:, :2] ** 2).sum() / robust[:, :2].sum())),
        points=points,
        sigma_m=float(np.median(cells.sigma_m[:, 0])),
        covariance=np.asarray(covariance[:6, :6]),
    )


def fit(view: GripperView, *, X_CH: Array | None = None, finger_m: float | None = None) -> HandFit | None:
    """Fit the gripper to one view; None if fewer than `MIN_CELLS` cells show it.

    Args:
        view: dense estimates.
        X_CH: (4, 4) pose of panda_hand in the camera frame from priors [m].
        finger_m: travel of each finger from priors [m].
    """
    cells = gripper_cells(view)
    if len(cells) < MIN_CELLS:
        return None
    start = _closed_form(cells, finger_m)
    if X_CH is not None:
        start = replace(start, X_CH=X_CH, pose_free=False)
    solution = solve(start, cells, view.depth_factor_sigma)
    if solution is None:
        return None
    return _fit_of(solution, cells, int(view.gripper.sum()), finger_known=finger_m is not None)


def refit(hand: HandFit, view: GripperView, rim: Correspondences) -> HandFit:
    """Repeat a fit with the silhouette; return `hand` unchanged if that diverges.

    Args:
        hand: fit to the view without the silhouette.
        view: dense estimates.
        rim: correspondences of the silhouette.
    """
    start = HandModel(X_CH=hand.X_CH, finger_m=finger_or_default(hand.finger_m), finger_free=hand.finger_free)
    cells = gripper_cells(view)
    joined = Correspondences.join([cells, rim])
    solution = solve(start, joined, view.depth_factor_sigma, float(np.log(hand.depth_factor)))
    if solution is None:
        return hand
    return _fit_of(solution, cells, hand.points, finger_known=bool(np.isfinite(hand.finger_m)))
