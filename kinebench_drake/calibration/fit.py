"""A pinhole that can be moved and zoomed: what a calibration looks for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from kinebench_drake.calibration.correspondences import CalibrationCorrespondences
from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points

UNKNOWNS = 7
"""Rotation about the camera's axes [rad], shift [m] and the logarithm of the focal length."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """A camera by the pose of the robot's base in it."""

    camera: Camera
    """Intrinsics; its pose is not read."""
    X_CB: Array
    """(4, 4) pose of the base in the camera frame [m]."""

    def moved(self, step: Array) -> "Lens":
        """The lens after a change (7,): the base turned about the axes of C and shifted, then the zoom."""
        X_CB = make_pose(rotation_exp(step[:3]) @ self.X_CB[:3, :3], self.X_CB[:3, 3] + step[3:6])
        zoom = float(np.exp(step[6]))
        camera = replace(self.camera, fx=self.camera.fx * zoom, fy=self.camera.fy * zoom)
        return Lens(camera=camera, X_CB=X_CB)

    def placed(self) -> Camera:
        """The camera with its pose."""
        return replace(self.camera, X_BC=invert(self.X_CB))

    def project(self, p_B: Array) -> tuple[Array, Array]:
        """Pixels (N, 2) and depths (N,) [m] of points (N, 3) of B; behind the camera they are where they would be."""
        p_C = transform_points(self.X_CB, p_B)
        z = np.where(np.abs(p_C[:, 2]) < 1e-3, 1e-3, p_C[:, 2])
        f, c = [self.camera.fx, self.camera.fy], [self.camera.cx, self.camera.cy]
        return np.asarray(p_C[:, :2] / z[:, None] * f + c), z

    def derivatives(self, p_B: Array) -> tuple[Array, Array]:
        """Of the pixels of points (N, 3): by the unknowns (N, 2, 7), and by the point's place in C (N, 2, 3)."""
        offset = p_B @ self.X_CB[:3, :3].T
        x, y, z = (offset + self.X_CB[:3, 3]).T
        fx, fy = self.camera.fx, self.camera.fy
        zero = np.zeros_like(z)
        by_C = np.stack(
            [
                np.stack([fx / z, zero, -fx * x / z**2], axis=-1),
                np.stack([zero, fy / z, -fy * y / z**2], axis=-1),
            ],
            axis=1,
        )
        J = np.empty((len(z), 2, UNKNOWNS))
        J[:, :, :3] = np.cross(offset[:, None], by_C)  # d p_C / d w = -[offset]x
        J[:, :, 3:6] = by_C
        J[:, 0, 6], J[:, 1, 6] = fx * x / z, fy * y / z
        return J, by_C


CAUCHY = 2.0
"""Residual, in standard deviations, that counts half."""
PIXEL_SIGMA = 0.5
"""Standard deviation that no cell of a picture 384 px wide is better than [px]: the views' own raster."""
_CONSENSUS_PX, _CONSENSUS_ROUNDS, _CONSENSUS_CELLS = 8.0, 200, 600
_INLIER_SIGMAS = 4.0
_LEAST_DEPTH_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class LensFit:
    """A fitted lens."""

    lens: Lens
    cost: float
    """Weighted mean of Cauchy's loss."""
    residual_px: Array
    """(N, 2) reprojection less the picture [px]."""
    sigma_px: Array
    """(N,) its standard deviation, beforehand [px]."""
    information: Array
    """(7, 7) inverse covariance of the lens' unknowns, parts that stand still counted once; of a fixed zoom, 0."""

    @property
    def residual(self) -> Array:
        """(N, 2) reprojection less the picture, in standard deviations."""
        return np.asarray(self.residual_px / self.sigma_px[:, None])

    @property
    def inlier(self) -> NDArray[np.bool_]:
        """(N,) cells that go with the lens."""
        return np.asarray(np.linalg.norm(self.residual, axis=1) <= _INLIER_SIGMAS)


def sigma_px(cells: CalibrationCorrespondences, lens: Lens, p_B: Array) -> Array:
    """(N,) standard deviation of the reprojection of cells that show the points `p_B` (N, 3) [px]."""
    _, z = lens.project(p_B)
    floor = PIXEL_SIGMA * lens.camera.unit_px
    return np.hypot(floor, lens.camera.fx * cells.sigma_m / np.maximum(np.abs(z), _LEAST_DEPTH_M))


def consensus(cells: CalibrationCorrespondences, p_B: Array, cameras: Sequence[Camera]) -> list[Lens]:
    """First lenses for some intrinsics, those first that more cells agree with; none where nothing agrees.

    Args:
        cells: what is seen.
        p_B: (N, 3) its points [m].
        cameras: intrinsics to try.
    """
    some = np.linspace(0, len(cells) - 1, min(len(cells), _CONSENSUS_CELLS)).astype(int)
    object_points, image_points = p_B[some], cells.uv_px[some]
    found = []
    for camera in cameras:
        ok, turn, shift, agreeing = cv2.solvePnPRansac(
            object_points, image_points, camera.K, None,
            iterationsCount=_CONSENSUS_ROUNDS, flags=cv2.SOLVEPNP_SQPNP,
            reprojectionError=_CONSENSUS_PX * camera.unit_px,
        )  # fmt: skip
        if ok and agreeing is not None and np.isfinite(turn).all() and np.isfinite(shift).all():
            X_CB = make_pose(rotation_exp(turn.ravel()), shift.ravel())
            found.append((len(agreeing), Lens(camera=camera, X_CB=X_CB)))
    return [lens for _, lens in sorted(found, key=lambda pair: -pair[0])]


def robust_loss(weight: Array, square: Array) -> Array:
    """Cauchy's loss of weighted squares as scipy wants it (3, N): value and two derivatives."""
    return np.stack([weight * np.log1p(square), weight / (1.0 + square), -weight / (1.0 + square) ** 2])


def refine(cells: CalibrationCorrespondences, p_B: Array, start: Lens, *, zoom_free: bool, rounds: int = 2) -> LensFit:
    """Robust least squares on the reprojection from `start` on.

    Args:
        cells: what is seen.
        p_B: (N, 3) its points [m].
        start: where to begin.
        zoom_free: whether the focal length is looked for.
        rounds: how often the sigmas [px] are taken anew.
    """
    free = UNKNOWNS if zoom_free else UNKNOWNS - 1
    lens = start
    weight = np.repeat(cells.weight, 2)
    for _ in range(rounds):
        sigma = sigma_px(cells, lens, p_B)[:, None]
        origin = lens

        def at(x: Array, origin: Lens = origin) -> Lens:
            return origin.moved(np.concatenate([x, np.zeros(UNKNOWNS - free)]))

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
            loss=lambda z: robust_loss(weight, z),
            f_scale=CAUCHY,
            x_scale="jac",
            max_nfev=60,
        )
        lens = at(solution.x)
    return _described(cells, p_B, lens, free)


def left_jacobian(w: Array) -> Array:
    """How the turn about the axes of C grows with the rotation vector (3,): the left Jacobian of SO(3)."""
    angle = float(np.linalg.norm(w))
    x, y, z = w
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * K)
    return np.asarray(np.eye(3) + (1 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * (K @ K))


def _described(cells: CalibrationCorrespondences, p_B: Array, lens: Lens, free: int) -> LensFit:
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


def with_focal(camera: Camera, fx: float) -> Camera:
    """The camera with another focal length along x [px], the pixels' shape as it was."""
    return replace(camera, fx=fx, fy=camera.fy * fx / camera.fx)
