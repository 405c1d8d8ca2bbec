"""The gripper's pose in one view from CAD coordinates and depth: closed form first, then robust least squares.

Unknowns are the pose of the hand in the crop's virtual camera V, the opening of the fingers, and a common factor of the
depth. The latter matters: an estimated depth errs by nearly the same factor all over the gripper, so its shape is
trusted more than its level, and the level is weighed against the size at which the gripper appears.
"""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array, make_pose, orthonormalize, rotation_exp
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.models.panda.cad import MAX_FINGER_M

_MAX_POINTS = 600
_LEVEL_SIGMA = 0.012
"""Prior standard deviation of the depth's common relative error."""
_CAUCHY = 2.0  # residual, in standard deviations, that counts half
_ITERATIONS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A fitted pose."""

    X_VH: Array
    """(4, 4) pose of panda_hand in the crop's camera [m]."""
    finger_m: float
    """Opening of each finger, 0..0.04 [m]; NaN when no finger was seen."""
    depth_factor: float
    """True depth over estimated depth, as fitted."""
    residual: float
    """Root mean square of the robustly weighted coordinate residuals, in standard deviations."""
    points: int
    """Number of gripper cells used."""
    sigma_m: float
    """Median standard deviation of the CAD coordinates used [m]."""


@dataclass(frozen=True, slots=True)
class _Points:
    """The gripper cells of a view, N of them."""

    rays: Array
    depth: Array
    depth_sigma: Array
    p_H: Array
    sigma: Array
    sign: Array


def _points(view: GripperView) -> _Points:
    v, u = np.nonzero(view.gripper)
    if len(v) > _MAX_POINTS:
        chosen = np.linspace(0, len(v) - 1, _MAX_POINTS).astype(int)
        v, u = v[chosen], u[chosen]
    return _Points(
        view.rays()[v, u],
        view.depth_m[v, u],
        view.depth_sigma[v, u],
        view.coordinates_P[v, u],
        view.coordinates_sigma_m[v, u],
        view.opening_sign[v, u],
    )


def align(p_A: Array, p_B: Array, weight: Array) -> Array:
    """Rigid pose X_AB (4, 4) that minimises the weighted squares |p_A - X_AB p_B| (Umeyama 1991, without scale)."""
    w = weight / weight.sum()
    mean_A, mean_B = w @ p_A, w @ p_B
    covariance = ((p_A - mean_A) * w[:, None]).T @ (p_B - mean_B)
    R = orthonormalize(covariance)
    return make_pose(R, mean_A - R @ mean_B)


def _closed_form(points: _Points) -> tuple[Array, float]:
    """Pose and opening from 3-D to 3-D alignment, reweighted a few times against outliers."""
    cloud = points.rays * points.depth[:, None]
    weight = 1.0 / (points.sigma**2 + (points.depth_sigma * points.depth) ** 2)
    finger, robust = 0.02, np.ones(len(cloud))
    X_VH = np.eye(4)
    for _ in range(6):
        model = points.p_H + points.sign[:, None] * [0.0, finger, 0.0]
        X_VH = align(cloud, model, weight * robust)
        seen_H = (cloud - X_VH[:3, 3]) @ X_VH[:3, :3]
        error = np.linalg.norm(seen_H - model, axis=1)
        scale = max(float(np.median(error)), 1e-4)
        robust = 1.0 / (1.0 + (error / (2 * scale)) ** 2)
        finger = _opening(points, seen_H[:, 1] - points.p_H[:, 1], weight * robust, finger)
    return X_VH, finger


def _opening(points: _Points, shift: Array, weight: Array, default: float) -> float:
    w = weight * np.abs(points.sign)
    if w.sum() <= 0:
        return default
    return float(np.clip((w * points.sign * shift).sum() / w.sum(), 0.0, MAX_FINGER_M))


def _residuals(points: _Points, X_VH: Array, finger: float, level: float) -> tuple[Array, Array]:
    """Residuals (N, 3) in standard deviations - image x, image y, log depth - and their Jacobian (N, 3, 8).

    Columns of the Jacobian: rotation (about V's axes at the hand's origin), translation, opening, level.
    """
    offset = (points.p_H + points.sign[:, None] * [0.0, finger, 0.0]) @ X_VH[:3, :3].T
    p = offset + X_VH[:3, 3]
    z = p[:, 2]
    sigma_image = points.sigma / z
    r = np.empty((len(z), 3))
    r[:, 0] = (p[:, 0] / z - points.rays[:, 0]) / sigma_image
    r[:, 1] = (p[:, 1] / z - points.rays[:, 1]) / sigma_image
    sigma_depth = np.hypot(points.depth_sigma, points.sigma / z)
    r[:, 2] = (np.log(z / points.depth) - level) / sigma_depth
    d_p = np.zeros((len(z), 3, 8))  # change of p with each unknown
    d_p[:, 0, 1], d_p[:, 0, 2] = offset[:, 2], -offset[:, 1]
    d_p[:, 1, 0], d_p[:, 1, 2] = -offset[:, 2], offset[:, 0]
    d_p[:, 2, 0], d_p[:, 2, 1] = offset[:, 1], -offset[:, 0]
    d_p[:, :, 3:6] = np.eye(3)
    d_p[:, :, 6] = points.sign[:, None] * X_VH[:3, 1]
    J = np.empty((len(z), 3, 8))
    for axis in (0, 1):
        J[:, axis] = (d_p[:, axis] - (p[:, axis] / z)[:, None] * d_p[:, 2]) / (z * sigma_image)[:, None]
    J[:, 2] = d_p[:, 2] / (z * sigma_depth)[:, None]
    J[:, 2, 7] = -1.0 / sigma_depth
    return r, J


def fit(view: GripperView, level_sigma: float = _LEVEL_SIGMA) -> Fit | None:
    """Fit the gripper to one view; None when fewer than 12 cells show it.

    Cauchy-weighted Gauss-Newton on reprojection and depth residuals. Cells next to each other err alike, so the
    common depth factor gets a prior (`level_sigma`) worth many cells.
    """
    points = _points(view)
    n = len(points.depth)
    if n < 12:
        return None
    X_VH, finger = _closed_form(points)
    has_fingers = bool((np.abs(points.sign) > 0).sum() >= 6)
    level, weight = 0.0, np.ones((n, 3))
    cells_alike = max(1.0, n / 40.0)  # neighbouring cells are one measurement: about 40 a view are independent
    for _ in range(_ITERATIONS):
        r, J = _residuals(points, X_VH, finger, level)
        size = np.abs(r)
        size[:, :2] = np.linalg.norm(r[:, :2], axis=1, keepdims=True)
        weight = 1.0 / (1.0 + (size / _CAUCHY) ** 2) / cells_alike
        flat = J.reshape(-1, 8)
        W = weight.reshape(-1, 1)
        H = flat.T @ (flat * W)
        g = flat.T @ (r.reshape(-1, 1) * W)
        H[7, 7] += 1.0 / level_sigma**2
        g[7] += level / level_sigma**2
        H[6, 6] += 1.0 if has_fingers else 1e12  # opening unseen: keep it
        step = -np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)), g)[:, 0]
        X_VH = make_pose(rotation_exp(step[:3]) @ X_VH[:3, :3], X_VH[:3, 3] + step[3:6])
        if X_VH[2, 3] < 0.05:
            return None
        finger = float(np.clip(finger + step[6], 0.0, MAX_FINGER_M))
        level += step[7]
        if np.abs(step[3:6]).max() < 1e-5 and np.abs(step[:3]).max() < 1e-5:
            break
    r, _ = _residuals(points, X_VH, finger, level)
    return Fit(
        X_VH=X_VH,
        finger_m=finger if has_fingers else float("nan"),
        depth_factor=float(np.exp(level)),
        residual=float(np.sqrt((weight[:, :2] * r[:, :2] ** 2).sum() / weight[:, :2].sum())),
        points=int(view.gripper.sum()),
        sigma_m=float(np.median(points.sigma)),
    )
