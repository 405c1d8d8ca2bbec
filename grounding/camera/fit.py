"""Robust fit of a lens: camera pose and focal length from correspondences of known points."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points
from kinebench_drake.grounding.camera.correspondences import CalibrationCorrespondences

UNKNOWNS = 7
"""Number of unknowns: rotation about the camera axes [rad], translation [m] and logarithm of the focal length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Camera parameterised by the pose of the robot base in its frame."""

    camera: Camera
    """Intrinsics; its pose is ignored."""
    X_CB: Array
    """(4, 4) pose of the base in the camera frame [m]."""

    def displace(self, step: Array) -> "Lens":
        """Return the lens after a step (7,): rotation of the base about the axes of C, translation, log zoom."""
        X_CB = make_pose(rotation_exp(step[:3]) @ self.X_CB[:3, :3], self.X_CB[:3, 3] + step[3:6])
        zoom = float(np.exp(step[6]))
        camera = replace(self.camera, fx=self.camera.fx * zoom, fy=self.camera.fy * zoom)
        return Lens(camera=camera, X_CB=X_CB)

    def to_camera(self) -> Camera:
        """Return the camera with its pose."""
        return replace(self.camera, X_BC=invert(self.X_CB))

    def project(self, p_B: Array) -> tuple[Array, Array]:
        """Project points (N, 3) in B to pixels (N, 2) and depths (N,) [m], points behind the camera included."""
        p_C = transform_points(self.X_CB, p_B)
        z = np.where(np.abs(p_C[:, 2]) < 1e-3, 1e-3, p_C[:, 2])
        f, c = [self.camera.fx, self.camera.fy], [self.camera.cx, self.camera.cy]
        return np.asarray(p_C[:, :2] / z[:, None] * f + c), z

    def derivatives(self, p_B: Array) -> tuple[Array, Array]:
        """Return the derivatives of the pixels of points (N, 3) by the unknowns (N, 2, 7) and by p_C (N, 2, 3)."""
        offset = p_B @ self.X_CB[:3, :3].T
        x, y, z = (offset + self.X_CB[:3, 3]).T
        fx, fy = self.camera.fx, self.camera.fy
        zero = np.zeros_like(z)
        by_C = np.stack(
            [np.stack([fx / z, zero, -fx * x / z**2], axis=-1), np.stack([zero, fy / z, -fy * y / z**2], axis=-1)],
            axis=1,
        )
        J = np.empty((len(z), 2, UNKNOWNS))
        J[:, :, :3] = np.cross(offset[:, None], by_C)  # d p_C / d w = -[offset]x
        J[:, :, 3:6] = by_C
        J[:, 0, 6], J[:, 1, 6] = fx * x / z, fy * y / z
        return J, by_C

    def position_sigma_m(self, covariance: Array) -> float:
        """Return the standard deviation of the camera's position in B: root of the sum over axes [m].

        Args:
            covariance: (6, 6) covariance of the base's rotation about the axes of C [rad] and its position in C [m].
        """
        x, y, z = self.X_CB[:3, 3]
        by_turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # the camera's position is -R^T t
        J = np.concatenate([by_turn, np.eye(3)], axis=1)
        return float(np.trace(J @ covariance @ J.T) ** 0.5)


CAUCHY = 2.0
"""Residual, in standard deviations, at which Cauchy's weight is one half."""
PIXEL_SIGMA = 0.5
"""Least standard deviation of a cell in an image 384 px wide [px]: the raster of the views."""
_CONSENSUS_PX, _CONSENSUS_ROUNDS, _CONSENSUS_CELLS = 8.0, 200, 600
_INLIER_SIGMAS = 4.0
_LEAST_DEPTH_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class LensFit:
    """Fitted lens."""

    lens: Lens
    cost: float
    """Weighted mean of Cauchy's loss."""
    residual_px: Array
    """(N, 2) reprojection minus observation [px]."""
    sigma_px: Array
    """(N,) prior standard deviation of the residual [px]."""
    information: Array
    """(7, 7) inverse covariance of the unknowns, parts at rest counted once; 0 for a fixed focal length."""

    @property
    def residual(self) -> Array:
        """(N, 2) reprojection minus observation, in standard deviations."""
        return np.asarray(self.residual_px / self.sigma_px[:, None])

    @property
    def inlier(self) -> NDArray[np.bool_]:
        """(N,) cells consistent with the lens."""
        return np.asarray(np.linalg.norm(self.residual, axis=1) <= _INLIER_SIGMAS)


def sigma_px(cells: CalibrationCorrespondences, lens: Lens, p_B: Array) -> Array:
    """Return the standard deviation (N,) [px] of the reprojection of cells that show the points `p_B` (N, 3) [m]."""
    _, z = lens.project(p_B)
    floor = PIXEL_SIGMA * lens.camera.unit_px
    return np.hypot(floor, lens.camera.fx * cells.sigma_m / np.maximum(np.abs(z), _LEAST_DEPTH_M))


def find_consensus(cells: CalibrationCorrespondences, p_B: Array, cameras: Sequence[Camera]) -> list[Lens]:
    """Estimate initial lenses by RANSAC for several intrinsics, by decreasing number of inliers.

    Args:
        cells: observed cells.
        p_B: (N, 3) points of the cells [m].
        cameras: intrinsics.
    """
    some = np.linspace(0, len(cells) - 1, min(len(cells), _CONSENSUS_CELLS)).astype(int)
    object_points, image_points = p_B[some], cells.uv_px[some]
    ranked = []
    for camera in cameras:
        solution = solve_pnp(
            object_points, image_points, camera, rounds=_CONSENSUS_ROUNDS, error_px=_CONSENSUS_PX * camera.unit_px
        )
        if solution is not None:
            X_CB, inliers = solution
            ranked.append((inliers, Lens(camera=camera, X_CB=X_CB)))
    return [lens for _, lens in sorted(ranked, key=lambda pair: -pair[0])]


def solve_pnp(p: Array, uv_px: Array, camera: Camera, *, rounds: int, error_px: float) -> tuple[Array, int] | None:
    """Return the pose (4, 4) of points (N, 3) in the camera frame [m] and the number of inliers; None if there is none.

    Args:
        p: (N, 3) points [m].
        uv_px: (N, 2) their pixels.
        camera: intrinsics.
        rounds: random samples.
        error_px: largest error of an inlier [px].
    """
    try:
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            p, uv_px, camera.K, None,
            iterationsCount=rounds, flags=cv2.SOLVEPNP_SQPNP, reprojectionError=error_px,
        )  # fmt: skip
    except cv2.error:  # raised where the best sample has too few inliers
        return None
    if not ok or inliers is None or not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
        return None
    return make_pose(rotation_exp(rotation.ravel()), translation.ravel()), len(inliers)


def cauchy_loss(weight: Array, square: Array) -> Array:
    """Return Cauchy's loss of weighted squares in scipy's form (3, N): value and two derivatives."""
    return np.stack([weight * np.log1p(square), weight / (1.0 + square), -weight / (1.0 + square) ** 2])


def refine(cells: CalibrationCorrespondences, p_B: Array, start: Lens, *, focal_free: bool, rounds: int = 2) -> LensFit:
    """Refine a lens by robust least squares on the reprojection.

    Args:
        cells: observed cells.
        p_B: (N, 3) points of the cells [m].
        start: initial lens.
        focal_free: True to estimate the focal length.
        rounds: number of rounds, each with newly computed sigmas [px].
    """
    free = UNKNOWNS if focal_free else UNKNOWNS - 1
    lens = start
    weight = np.repeat(cells.weight, 2)
    for _ in range(rounds):
        sigma = sigma_px(cells, lens, p_B)[:, None]
        origin = lens

        def at(x: Array, origin: Lens = origin) -> Lens:
            return origin.displace(np.concatenate([x, np.zeros(UNKNOWNS - free)]))

        def errors(x: Array, sigma: Array = sigma) -> Array:
            return np.asarray(((at(x).project(p_B)[0] - cells.uv_px) / sigma).ravel())

        def slopes(x: Array, sigma: Array = sigma, origin: Lens = origin) -> Array:
            here = at(x)
            J, _ = here.derivatives(p_B)
            J = np.concatenate([J[..., :3] @ left_jacobian(x[:3]), J[..., 3:]], axis=-1)
            return np.asarray((J / sigma[..., None])[..., :free].reshape(-1, free))

        solution = least_squares(
            errors,
            np.zeros(free),
            jac=slopes,
            loss=lambda z: cauchy_loss(weight, z),
            f_scale=CAUCHY,
            x_scale="jac",
            max_nfev=60,
        )
        lens = at(solution.x)
    return _summarise(cells, p_B, lens, free)


def left_jacobian(w: Array) -> Array:
    """Return the left Jacobian (3, 3) of SO(3) at a rotation vector (3,)."""
    angle = float(np.linalg.norm(w))
    x, y, z = w
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * K)
    return np.asarray(np.eye(3) + (1 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * (K @ K))


def _summarise(cells: CalibrationCorrespondences, p_B: Array, lens: Lens, free: int) -> LensFit:
    sigma = sigma_px(cells, lens, p_B)[:, None]
    uv, _ = lens.project(p_B)
    residual_px = uv - cells.uv_px
    residual = residual_px / sigma
    square = (residual / CAUCHY) ** 2
    J = (lens.derivatives(p_B)[0] / sigma[..., None])[..., :free].reshape(-1, free)
    W = ((cells.weight / cells.repeats)[:, None] / (1.0 + square)).reshape(-1)
    information = np.zeros((UNKNOWNS, UNKNOWNS))
    information[:free, :free] = J.T @ (J * W[:, None])
    cost = float((cells.weight[:, None] * np.log1p(square)).sum() / (2 * cells.weight.sum()))
    return LensFit(lens=lens, cost=cost, residual_px=residual_px, sigma_px=sigma[:, 0], information=information)


def focal_px(side_px: int, fov_deg: float) -> float:
    """Return the focal length [px] with which a field of view [degrees] fills a side of an image."""
    return side_px / 2 / float(np.tan(np.deg2rad(fov_deg) / 2))


def with_focal(camera: Camera, fx: float) -> Camera:
    """Return the camera with another focal length along x [px] and the same pixel aspect ratio."""
    return replace(camera, fx=fx, fy=camera.fy * fx / camera.fx)
