"""Robust least squares of models' parameters on reprojection and range residuals, with a common depth factor.

An estimated depth errs by nearly the same factor everywhere on the robot, so a common factor of all ranges is estimated
as well: the shape of the depth counts more than its absolute value, which is weighed against the apparent size.

Frames are solved together, each with its own parameters: arrays have a leading dimension B of frames. Cells lie along
the last axis, so that every operation runs over whole rows. A part moves by twists, so the derivatives of a frame's
residuals are one product: the twists of its parameters times those of its cells.
"""

from dataclasses import dataclass, fields, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.models.panda.description import RobotPart

BATCH = 8
"""Frames that are best solved together: their cells still fit into a processor's cache."""
CAUCHY = 2.0
"""Residual, in standard deviations, at which Cauchy's weight is one half."""
NEAREST_M = 0.05
"""Least depth of a point that a camera sees [m]."""


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
        r = self.residual[frame, :2, :n]
        return float(np.sqrt((robust * r**2).sum() / robust.sum()))


@dataclass(frozen=True, slots=True, kw_only=True)
class CellRows:
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

    def take(self, index: NDArray[np.generic]) -> "CellRows":
        """Return the rows of some of the frames, by index or mask."""
        return CellRows(**{name: getattr(self, name)[index] for name in self.__slots__})

    def place(self, X_CP: Array, finger_m: Array | None = None) -> tuple[Array, Array]:
        """Return the CAD points (B, 3, N) in the camera frame [m], and the direction (B, 3, N) of open fingers.

        Parts are at `X_CP` (B, PARTS, 4, 4), fingers opened by `finger_m` (B,) or closed.
        """
        X = self._part_poses(X_CP)
        p_P = self.p_P
        if finger_m is not None:
            p_P = p_P.copy()
            p_P[:, 1] += self.opening_sign * finger_m[:, None]
        return (X[:, :, :3] * p_P[:, None]).sum(axis=2) + X[:, :, 3], X[:, :, 1]

    def _part_poses(self, X_CP: Array) -> Array:
        """Return the first rows (B, 3, 4, N) of the pose of each cell's part."""
        frames, parts = X_CP.shape[:2]
        rows = X_CP[:, :, :3].reshape(frames, parts, 12).swapaxes(1, 2) @ self.is_part
        return np.asarray(rows.reshape(frames, 3, 4, -1))

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
