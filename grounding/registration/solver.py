"""Correspondences of cells with CAD points, and robust least squares of models' parameters on their residuals.

A correspondence has the line of sight, range and CAD coordinates of a cell. Residuals are reprojection and range.

An estimated depth errs by nearly the same factor everywhere on the robot, so a common factor of all ranges is estimated
as well: the shape of the depth counts more than its absolute value, which is weighed against the apparent size.

Frames are solved together, each with its own parameters: arrays have a leading dimension B of frames. Cells lie along
the last axis, so that every operation runs over whole rows. A part moves by twists, so the derivatives of a frame's
residuals are one product: the twists of its parameters times those of its cells.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, cross
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS, GripperView
from kinebench_drake.models.panda.description import RobotPart

CELLS_INDEPENDENT = 30.0
"""Greatest number of independent measurements that cells of links in a view count as: their errors correlate."""
POINTS_INDEPENDENT = 60.0
"""The same of points on the contour of the hand, or of a surface that is followed."""
MIN_POINTS = 20
"""Least number of points on a contour or surface that is matched."""
BATCH = 8
"""Frames that are best solved together: their cells still fit into a processor's cache."""
CAUCHY = 2.0
"""Residual, in standard deviations, at which Cauchy's weight is one half."""
NEAREST_M = 0.05
"""Least depth of a point that a camera sees [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Base of records all of whose fields are arrays with the same number of rows."""

    def take(self, index: NDArray[np.generic]) -> Self:
        """Select rows by index or mask."""
        return type(self)(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Concatenate records."""
        return cls(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondences(Rows):
    """N correspondences, from one view or several that share the camera's centre.

    Those of several frames (`stack`) have a leading dimension of frames in every field.
    """

    R_LC: Array
    """(N, 3, 3) rotation from the camera frame C to a frame L whose z axis is the line of sight."""
    range_m: Array
    """(N,) distance along the line of sight [m]."""
    range_sigma: Array
    """(N,) relative standard deviation of the range; inf if there is none."""
    p_P: Array
    """(N, 3) CAD point in the frame of its part [m], as in `GripperView.coordinates_P`."""
    sigma_m: Array
    """(N, 2) standard deviation along the first two axes of L [m]; inf where the point is unconstrained."""
    part: NDArray[np.uint8]
    """(N,) values of `RobotPart`."""
    opening_sign: Array
    """(N,) direction along the hand's y axis as the fingers open: 1 or -1 on a finger, else 0."""
    weight: Array
    """(N,) number of independent measurements that it counts as: adjacent cells have correlated errors."""

    def __len__(self) -> int:
        """Return the number N of correspondences, or of frames."""
        return len(self.range_m)

    @property
    def p_C(self) -> Array:
        """(N, 3) points in the camera frame according to their ranges [m]."""
        return np.asarray(self.R_LC[..., 2, :] * self.range_m[..., None])

    @staticmethod
    def stack(frames: "Sequence[Correspondences]") -> "Correspondences":
        """Stack the correspondences of frames; shorter ones are filled up with copies of their first, of no weight."""
        index = np.arange(max(len(cells) for cells in frames))
        padded = [cells.take(np.where(index < len(cells), index, 0)) for cells in frames]
        for cells, filled in zip(frames, padded, strict=True):
            filled.weight[len(cells) :] = 0.0
        return Correspondences(
            **{f.name: np.stack([getattr(cells, f.name) for cells in padded]) for f in fields(Correspondences)}
        )

    @staticmethod
    def without_range(
        R_LC: Array,
        p_P: Array,
        sigma_m: Array,
        part: NDArray[np.uint8],
        independent: float,
        opening_sign: Array | None = None,
    ) -> "Correspondences":
        """Return correspondences whose ranges are unknown; at most `independent` is their total weight."""
        n = len(part)
        return Correspondences(
            R_LC=R_LC,
            range_m=np.ones(n),
            range_sigma=np.full(n, np.inf),
            p_P=p_P,
            sigma_m=sigma_m,
            part=part,
            opening_sign=np.zeros(n) if opening_sign is None else opening_sign,
            weight=np.full(n, min(1.0, independent / n)),
        )

    @staticmethod
    def of_view(
        view: GripperView, mask: NDArray[np.bool_], limit: int = 300, independent: float = CELLS_INDEPENDENT
    ) -> "Correspondences":
        """Return the correspondences of the cells in `mask` (h, w) of a view.

        More than `limit` are evenly subsampled; their total weight is `independent` at most.
        """
        v, u = np.nonzero(mask)
        if len(v) > limit:
            subset = np.linspace(0, len(v) - 1, limit).astype(int)
            v = v[subset]
            u = u[subset]
        rays = view.rays()[v, u] @ view.crop.R_CV.T
        length = np.sqrt((rays**2).sum(axis=1))
        return Correspondences(
            R_LC=line_frames(rays / length[:, None]),
            range_m=view.depth_m[v, u] * length,
            range_sigma=view.depth_sigma[v, u],
            p_P=view.coordinates_P[v, u],
            sigma_m=np.repeat(view.coordinates_sigma_m[v, u, None], 2, axis=1),
            part=view.part[v, u],
            opening_sign=OPENING_SIGNS[view.part[v, u]],
            weight=np.full(len(v), min(1.0, independent / max(1, len(v)))),
        )


def line_frames(z: Array) -> Array:
    """Return rotations (N, 3, 3) whose third rows are the unit vectors `z` (N, 3)."""
    # y x z as first axis: a line of sight is never parallel to the camera's y axis.
    length = np.sqrt(z[:, 0] ** 2 + z[:, 2] ** 2)
    R = np.empty((len(z), 3, 3))
    R[:, 0, 0] = z[:, 2] / length
    R[:, 0, 1] = 0.0
    R[:, 0, 2] = -z[:, 0] / length
    R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = z[:, 1] * R[:, 0, 2], length, -z[:, 1] * R[:, 0, 0]
    R[:, 2] = z
    return R


def edge_frames(ray: Array, normal: Array) -> Array:
    """Return rotations (N, 3, 3) as `Correspondences.R_LC` whose first axes lie across edges of the image.

    Args:
        ray: (N, 3) lines of sight, of any length.
        normal: (N, 2) directions across the edges in the image.
    """
    z = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    x = np.column_stack([normal, np.zeros(len(normal))])
    x -= (x * z).sum(axis=1, keepdims=True) * z
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, cross(z, x), z], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class PartPlacement:
    """Poses of the parts of B frames, and their derivatives by the D parameters that move parts."""

    X_CP: Array
    """(B, PARTS, 4, 4) poses of the parts in the camera frame, fingers closed [m]."""
    finger_m: Array | None
    """(B,) travel of each finger, the parameter after the others [m]; None without fingers."""
    twist: Array
    """(B, 6, D) twist about the camera's centre per parameter: rotation, then velocity."""
    moves: Array
    """(PARTS, D) 1 if the parameter moves the part, -1 if in the opposite direction, else 0."""


class FitModel(Protocol):
    """Model of B frames with K parameters each: those that move parts, then the finger travel if there is one."""

    def place(self) -> PartPlacement:
        """Return the poses of the parts."""
        ...

    def prior(self) -> tuple[Array, Array]:
        """Return the information (B, K, K) of the parameters' prior and the gradient (B, K) of its cost."""
        ...

    def updated(self, step: Array) -> Self:
        """Return the model after a change (B, K) of its parameters."""
        ...

    def take(self, index: NDArray[np.generic]) -> Self:
        """Return the model of some of the frames, by index or mask."""
        ...


ModelType = TypeVar("ModelType", bound=FitModel)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution(Generic[ModelType]):
    """Result of `solve` for B frames with N correspondences each."""

    model: ModelType
    valid: NDArray[np.bool_]
    """(B,) False where a point ends behind the camera: the frame has no solution."""
    log_depth_factor: Array
    """(B,) logarithm of true range over estimated range."""
    residual: Array
    """(B, 3, N) residuals in standard deviations: two across the line of sight, then log range."""
    robust: Array
    """(B, 3, N) robust weights, 0..1."""
    information: Array
    """(B, K, K) inverse covariance of the parameters, with the depth factor marginalized."""

    def take(self, index: NDArray[np.generic]) -> "Solution[ModelType]":
        """Return the solution of some of the frames, by index or mask."""
        arrays = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name != "model"}
        return replace(self, model=self.model.take(index), **arrays)

    def growth(self, frame: int, n: int | None = None) -> float:
        """Return the robust root mean square across the line of sight of a frame's first `n` residuals, or of all."""
        robust = self.robust[frame, :2, :n]
        return float(np.sqrt((robust * self.residual[frame, :2, :n] ** 2).sum() / robust.sum()))


@dataclass(frozen=True, slots=True, kw_only=True)
class CellRows(Rows):
    """Correspondences of B frames as rows of N cells."""

    R_LC: Array
    """(B, 3, 3, N)."""
    p_P: Array
    """(B, 3, N)."""
    opening_sign: Array
    """(B, N)."""
    inverse_sigma: Array
    """(B, 2, N) inverse standard deviations across the line of sight [1/m]; 0 where unconstrained."""
    sigma_m: Array
    """(B, N) standard deviation along the first axis [m]."""
    range_m: Array
    range_sigma: Array
    weight: Array
    is_part: Array
    """(B, PARTS, N) 1 for the part of the cell, else 0."""

    @classmethod
    def of(cls, cells: Correspondences) -> "CellRows":
        """Lay out correspondences (B, N)."""
        return cls(
            R_LC=np.ascontiguousarray(np.moveaxis(cells.R_LC, 1, 3)),
            p_P=np.ascontiguousarray(np.moveaxis(cells.p_P, 1, 2)),
            opening_sign=cells.opening_sign,
            inverse_sigma=np.ascontiguousarray(np.moveaxis(1.0 / cells.sigma_m, 1, 2)),
            sigma_m=np.ascontiguousarray(cells.sigma_m[..., 0]),
            range_m=cells.range_m,
            range_sigma=cells.range_sigma,
            weight=cells.weight,
            is_part=(cells.part[:, None] == np.arange(len(RobotPart))[:, None]).astype(np.float64),
        )

    def place(self, X_CP: Array, finger_m: Array | None = None) -> tuple[Array, Array]:
        """Return the CAD points (B, 3, N) in the camera frame [m], and the direction (B, 3, N) of open fingers.

        Parts are at `X_CP` (B, PARTS, 4, 4), fingers opened by `finger_m` (B,) or closed.
        """
        frames, parts = X_CP.shape[:2]
        rows = X_CP[:, :, :3].reshape(frames, parts, 12).swapaxes(1, 2) @ self.is_part
        X = rows.reshape(frames, 3, 4, -1)  # first rows of the pose of each cell's part
        p_P = self.p_P
        if finger_m is not None:
            p_P = p_P.copy()
            p_P[:, 1] += self.opening_sign * finger_m[:, None]
        return (X[:, :, :3] * p_P[:, None]).sum(axis=2) + X[:, :, 3], X[:, :, 1]

    def in_line_frames(self, p_C: Array) -> Array:
        """Return points (B, 3, N) of the camera frame in the frames L of their cells [m]."""
        return np.asarray((self.R_LC * p_C[:, None]).sum(axis=2))


def residuals(placement: PartPlacement, cells: CellRows, log_depth_factor: Array) -> tuple[Array, Array]:
    """Return the residuals (B, 3, N), as in `Solution`, and their derivatives (B, K + 1, 3, N).

    The last ones are by `log_depth_factor` (B,), the logarithm of true range over estimated range.
    """
    p_C, opening = cells.place(placement.X_CP, placement.finger_m)
    p_L = cells.in_line_frames(p_C)
    z = p_L[:, 2]
    inverse = cells.inverse_sigma
    inverse_range = 1.0 / np.hypot(cells.range_sigma, cells.sigma_m / z)
    r = np.empty_like(p_L)
    r[:, :2] = p_L[:, :2] * inverse
    r[:, 2] = (np.log(np.maximum(z, 1e-3) / cells.range_m) - log_depth_factor[:, None]) * inverse_range
    frames, _, n = p_L.shape
    twist = np.empty((frames, 6, 3, n))  # by residual: moment of the gradient about the camera's centre, gradient
    moment = twist[:, :3]
    gradient = twist[:, 3:]
    line = cells.R_LC[:, 2]
    slope = p_L[:, :2] / z[:, None]
    for k in (0, 1):
        gradient[:, :, k] = (cells.R_LC[:, k] - slope[:, None, k] * line) * inverse[:, None, k]
    gradient[:, :, 2] = line * (inverse_range / z)[:, None]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        moment[:, i] = p_C[:, None, j] * gradient[:, k] - p_C[:, None, k] * gradient[:, j]
    count = placement.twist.shape[2]
    fingers = placement.finger_m is not None
    J = np.zeros((frames, count + fingers + 1, 3, n))
    J[:, :count] = (placement.twist.swapaxes(1, 2) @ twist.reshape(frames, 6, -1)).reshape(frames, count, 3, n)
    J[:, :count] *= (placement.moves.T @ cells.is_part)[:, :, None]
    if fingers:
        J[:, count] = (gradient * opening[:, :, None]).sum(axis=1) * cells.opening_sign[:, None]
    J[:, -1, 2] = -inverse_range
    return r, J


def solve(
    model: ModelType,
    cells: Correspondences,
    depth_factor_sigma: ArrayLike,
    log_depth_factor: Array | None = None,
    *,
    iterations: int = 8,
) -> Solution[ModelType]:
    """Minimize the Cauchy-weighted residuals of B frames by Gauss-Newton, each until its own steps are small.

    Args:
        model: initial parameters.
        cells: correspondences (B, N).
        depth_factor_sigma: (B,) prior relative standard deviation of the depth factor.
        log_depth_factor: (B,) initial logarithm of the depth factor; None for 0.
        iterations: greatest number of steps.
    """
    rows = CellRows.of(cells)
    sigma = np.asarray(depth_factor_sigma, dtype=np.float64)
    count = len(rows.weight)
    log_factor = np.zeros(count) if log_depth_factor is None else np.array(log_depth_factor, dtype=np.float64)
    active = np.arange(count)
    moving = rows
    for _ in range(iterations):
        _, _, H, g = _normal_equations(model.take(active), moving, sigma[active], log_factor[active])
        diagonal = np.einsum("bii->bi", H)
        diagonal += 1e-6 * diagonal + 1e-9
        step = np.zeros((count, g.shape[1]))
        step[active] = -np.linalg.solve(H, g[..., None])[..., 0]
        model = model.updated(step[:, :-1])
        log_factor = log_factor + step[:, -1]
        further = ~(np.abs(step[active]).max(axis=1) < 1e-4)
        if not further.any():
            break
        if not further.all():
            active = active[further]
            moving = moving.take(further)
    r, robust, H, _ = _normal_equations(model, rows, sigma, log_factor)
    placement = model.place()
    p_C, _ = rows.place(placement.X_CP, placement.finger_m)
    valid = np.isfinite(p_C).all(axis=(1, 2)) & (p_C[:, 2] >= NEAREST_M).all(axis=1)
    last = H[:, :-1, -1]
    return Solution(
        model=model,
        valid=np.asarray(valid),
        log_depth_factor=log_factor,
        residual=r,
        robust=robust,
        information=H[:, :-1, :-1] - last[:, :, None] * last[:, None] / H[:, -1:, -1:],
    )


def _normal_equations(
    model: FitModel, cells: CellRows, depth_factor_sigma: Array, log_depth_factor: Array
) -> tuple[Array, Array, Array, Array]:
    """Return residuals, robust weights, normal matrices and gradients; the last unknown is the log depth factor."""
    r, J = residuals(model.place(), cells, log_depth_factor)
    square = r**2
    square[:, :2] = square[:, :1] + square[:, 1:2]
    robust = 1.0 / (1.0 + square / CAUCHY**2)
    W = robust * cells.weight[:, None]
    flat = J.reshape(*J.shape[:2], -1)
    weighted = (J * W[:, None]).reshape(flat.shape)
    H = weighted @ flat.swapaxes(1, 2)
    g = (weighted @ r.reshape(len(r), -1, 1))[..., 0]
    information, gradient = model.prior()
    H[:, :-1, :-1] += information
    g[:, :-1] += gradient
    H[:, -1, -1] += 1.0 / depth_factor_sigma**2
    g[:, -1] += log_depth_factor / depth_factor_sigma**2
    return r, robust, H, g
