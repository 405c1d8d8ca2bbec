"""The gripper's pose in one view from CAD coordinates and depth: closed form first, then robust least squares."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kinebench_drake.geometry import Array, make_pose, orthonormalize, rotation_exp
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.solver import Solution, solve
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.models.panda.cad import MAX_FINGER_M

MIN_CELLS = 12
"""Fewer cells make no gripper."""
_MAX_CELLS = 400
_INDEPENDENT = 40.0  # measurements that the cells of a gripper are worth
_MIN_FINGER_CELLS = 6
_FINGER_SIGMA_M = 1.0  # prior of an opening that is seen: none to speak of
_FIXED = 1e12  # information about what must not move
UNSEEN_FINGER_M = 0.02  # opening that a gripper is taken to have where neither sight nor anything else tells


@dataclass(frozen=True, slots=True, kw_only=True)
class HandModel:
    """A hand that is free to be anywhere, with its fingers: seven unknowns."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float
    """Opening of each finger, 0..0.04 [m]."""
    opening_free: bool
    """Whether the opening is to be found: not where it is known, or too little is seen of the fingers."""
    pose_free: bool = True
    """Whether the pose is to be found."""

    def points(self, cells: Correspondences) -> tuple[Array, Array]:
        """See `Body`; the unknowns are a rotation about the camera's axes at the hand, a shift, and the opening."""
        p_C, offset = place_hand(self.X_CH, self.finger_m, cells)
        d_p = np.zeros((len(cells), 3, 7))
        d_p[:, 0, 1], d_p[:, 0, 2] = offset[:, 2], -offset[:, 1]
        d_p[:, 1, 0], d_p[:, 1, 2] = -offset[:, 2], offset[:, 0]
        d_p[:, 2, 0], d_p[:, 2, 1] = offset[:, 1], -offset[:, 0]
        d_p[:, :, 3:6] = np.eye(3)
        d_p[:, :, 6] = cells.opening_sign[:, None] * self.X_CH[:3, 1]
        return p_C, d_p

    def prior(self) -> tuple[Array, Array]:
        """See `Body`: what is not free stays."""
        pose = 0.0 if self.pose_free else _FIXED
        return np.diag([*[pose] * 6, opening_information(self.opening_free)]), np.zeros(7)

    def moved(self, step: Array) -> Self:
        """See `Body`."""
        X_CH = make_pose(rotation_exp(step[:3]) @ self.X_CH[:3, :3], self.X_CH[:3, 3] + step[3:6])
        return replace(self, X_CH=X_CH, finger_m=opened(self.finger_m, step[6]))


def place_hand(X_CH: Array, finger_m: float, cells: Correspondences) -> tuple[Array, Array]:
    """Where the points of gripper `cells` are for a hand at `X_CH` (4, 4): (N, 3) in C [m], and from its origin."""
    opened_H = cells.p_P + cells.opening_sign[:, None] * np.array([0.0, finger_m, 0.0])
    offset = opened_H @ X_CH[:3, :3].T
    return offset + X_CH[:3, 3], offset


def opened(finger_m: float, change_m: float) -> float:
    """An opening after a change, within what fingers can do [m]."""
    return float(np.clip(finger_m + change_m, 0.0, MAX_FINGER_M))


def drawn(finger_m: float) -> float:
    """An opening to render with, where it may be unknown (NaN) [m]."""
    return finger_m if np.isfinite(finger_m) else UNSEEN_FINGER_M


def opening_information(free: bool) -> float:
    """Information [1/m^2] about an opening beforehand."""
    return 1.0 / _FINGER_SIGMA_M**2 if free else _FIXED


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A fitted pose."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    finger_m: float
    """Opening of each finger, 0..0.04 [m]; NaN where it is neither known nor seen."""
    opening_free: bool
    """Whether the opening was found here."""
    finger_sigma_m: float
    """Standard deviation of the opening [m], as far as the cells' own sigmas tell."""
    depth_factor: float
    """True depth over estimated depth, as fitted."""
    residual: float
    """Root mean square of the robustly weighted coordinate residuals, in standard deviations."""
    points: int
    """Number of gripper cells."""
    sigma_m: float
    """Median standard deviation of the CAD coordinates used [m]."""
    covariance: Array
    """(6, 6) of rotation about the camera's axes [rad] and position [m], as far as the cells' own sigmas tell."""


def gripper_cells(view: GripperView) -> Correspondences:
    """The cells of a view that show hand or fingers."""
    return Correspondences.of_view(view, view.gripper, _MAX_CELLS, _INDEPENDENT)


def align(p_A: Array, p_B: Array, weight: Array) -> Array:
    """Rigid pose X_AB (4, 4) that minimises the weighted squares |p_A - X_AB p_B| (Umeyama 1991, without scale)."""
    w = weight / weight.sum()
    mean_A, mean_B = w @ p_A, w @ p_B
    covariance = ((p_A - mean_A) * w[:, None]).T @ (p_B - mean_B)
    R = orthonormalize(covariance)
    return make_pose(R, mean_A - R @ mean_B)


def _closed_form(cells: Correspondences, finger_m: float | None) -> HandModel:
    """Pose and opening from 3-D to 3-D alignment, reweighted a few times against outliers."""
    cloud = cells.p_C
    weight = 1.0 / (cells.sigma_m[:, 0] ** 2 + (cells.range_sigma * cells.range_m) ** 2)
    finger, robust = UNSEEN_FINGER_M if finger_m is None else finger_m, np.ones(len(cloud))
    X_CH = np.eye(4)
    for _ in range(6):
        model = cells.p_P + cells.opening_sign[:, None] * [0.0, finger, 0.0]
        X_CH = align(cloud, model, weight * robust)
        seen_H = (cloud - X_CH[:3, 3]) @ X_CH[:3, :3]
        error = np.linalg.norm(seen_H - model, axis=1)
        scale = max(float(np.median(error)), 1e-4)
        robust = 1.0 / (1.0 + (error / (2 * scale)) ** 2)
        w = weight * robust * np.abs(cells.opening_sign)
        if finger_m is None and w.sum() > 0:
            finger = opened(0.0, float((w * cells.opening_sign * (seen_H - cells.p_P)[:, 1]).sum() / w.sum()))
    seen = (cells.opening_sign != 0).sum() >= _MIN_FINGER_CELLS
    return HandModel(X_CH=X_CH, finger_m=finger, opening_free=bool(finger_m is None and seen))


def _describe(solution: Solution[HandModel], cells: Correspondences, points: int, *, opening_known: bool) -> Fit:
    hand, n = solution.body, len(cells)
    robust, r = solution.robust[:n], solution.residual[:n]
    covariance = np.linalg.inv(solution.information + 1e-6 * np.eye(7))
    return Fit(
        X_CH=hand.X_CH,
        finger_m=hand.finger_m if hand.opening_free or opening_known else float("nan"),
        opening_free=hand.opening_free,
        finger_sigma_m=float(covariance[6, 6] ** 0.5),
        depth_factor=float(np.exp(solution.level)),
        residual=float(np.sqrt((robust[:, :2] * r[:, :2] ** 2).sum() / robust[:, :2].sum())),
        points=points,
        sigma_m=float(np.median(cells.sigma_m[:, 0])),
        covariance=np.asarray(covariance[:6, :6]),
    )


def fit(view: GripperView, *, X_CH: Array | None = None, finger_m: float | None = None) -> Fit | None:
    """Fit the gripper to one view; None when fewer than `MIN_CELLS` cells show it.

    Args:
        view: what is seen.
        X_CH: (4, 4) pose of panda_hand in the camera frame [m], where it is known.
        finger_m: opening of each finger [m], where it is known.
    """
    cells = gripper_cells(view)
    if len(cells) < MIN_CELLS:
        return None
    start = _closed_form(cells, finger_m)
    if X_CH is not None:
        start = replace(start, X_CH=X_CH, pose_free=False)
    solution = solve(start, cells, view.level_sigma)
    if solution is None:
        return None
    return _describe(solution, cells, int(view.gripper.sum()), opening_known=finger_m is not None)


def refit(hand: Fit, view: GripperView, rim: Correspondences) -> Fit:
    """A fit again, with its outline; as it was where that leads nowhere.

    Args:
        hand: fitted to the view.
        view: what is seen.
        rim: what the outline says of the hand there.
    """
    known = bool(np.isfinite(hand.finger_m))
    start = HandModel(
        X_CH=hand.X_CH, finger_m=hand.finger_m if known else UNSEEN_FINGER_M, opening_free=hand.opening_free
    )
    cells = gripper_cells(view)
    solution = solve(start, Correspondences.join([cells, rim]), view.level_sigma, float(np.log(hand.depth_factor)))
    return hand if solution is None else _describe(solution, cells, hand.points, opening_known=known)
