"""Robust least squares of a body's unknowns against cells: reprojection and range, with a common factor of the ranges.

The factor matters: an estimated depth errs by nearly the same factor all over the robot, so its shape is trusted more
than its level, and the level is weighed against the size at which things appear.
"""

from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.correspondences import Correspondences

_CAUCHY = 2.0  # residual, in standard deviations, that counts half
_NEAREST_M = 0.05


class FitModel(Protocol):
    """Something with K unknowns that says where its points are."""

    def points(self, cells: Correspondences) -> tuple[Array, Array]:
        """Points (N, 3) of the cells in the camera frame [m] and their derivatives (N, 3, K) by the unknowns."""
        ...

    def prior(self) -> tuple[Array, Array]:
        """Information matrix (K, K) and its gradient (K,) of what is known of the unknowns beforehand."""
        ...

    def moved(self, step: Array) -> Self:
        """The body after a change (K,) of its unknowns."""
        ...


BodyType = TypeVar("BodyType", bound=FitModel)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution(Generic[BodyType]):
    """Where the body ended."""

    body: BodyType
    level: float
    """Logarithm of true over estimated range."""
    residual: Array
    """(N, 3) residuals in standard deviations: across the line of sight twice, log range."""
    robust: Array
    """(N, 3) the weights that outliers have lost, 0..1."""
    information: Array
    """(K, K) inverse covariance of the unknowns, the level being free."""


def residuals(p_C: Array, d_p: Array, cells: Correspondences, level: float) -> tuple[Array, Array]:
    """Residuals (N, 3) of points (N, 3) and their derivatives (N, 3, K + 1), the level's last, by those of `p_C`."""
    p_L = np.einsum("nij,nj->ni", cells.R_LC, p_C)
    d_L = cells.R_LC @ d_p
    z = p_L[:, 2]
    r, J = np.empty((len(z), 3)), np.zeros((len(z), 3, d_p.shape[2] + 1))
    across = cells.sigma_m
    r[:, :2] = p_L[:, :2] / across
    J[:, :2, :-1] = (d_L[:, :2] - (p_L[:, :2] / z[:, None])[..., None] * d_L[:, 2:]) / across[..., None]
    sigma = np.hypot(cells.range_sigma, cells.sigma_m[:, 0] / z)
    r[:, 2] = (np.log(np.maximum(z, 1e-3) / cells.range_m) - level) / sigma
    J[:, 2, :-1] = d_L[:, 2] / (z * sigma)[:, None]
    J[:, 2, -1] = -1.0 / sigma
    return r, J


def solve(
    body: BodyType, cells: Correspondences, level_sigma: float, level: float = 0.0, *, iterations: int = 8
) -> Solution[BodyType] | None:
    """Cauchy-weighted Gauss-Newton from `body` on; None if it ends before the camera.

    Args:
        body: where to start.
        cells: what was seen.
        level_sigma: prior standard deviation of the ranges' common relative error.
        level: where to start with the ranges' factor.
        iterations: greatest number of steps.
    """
    for _ in range(iterations):
        _, _, H, g = _normal(body, cells, level_sigma, level)
        step: Array = np.asarray(-np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)) + 1e-9 * np.eye(len(H)), g))
        body, level = body.moved(step[:-1]), level + step[-1]
        if np.abs(step).max() < 2e-5:
            break
    p_C, _ = body.points(cells)
    if not np.isfinite(p_C).all() or (p_C[:, 2] < _NEAREST_M).any():
        return None
    r, weight, H, _ = _normal(body, cells, level_sigma, level)
    information = H[:-1, :-1] - np.outer(H[:-1, -1], H[:-1, -1]) / H[-1, -1]
    return Solution(body=body, level=level, residual=r, robust=weight, information=information)


def _normal(
    body: FitModel, cells: Correspondences, level_sigma: float, level: float
) -> tuple[Array, Array, Array, Array]:
    """Residuals, robust weights, normal matrix and gradient of one step; the last unknown is the level."""
    r, J = residuals(*body.points(cells), cells, level)
    size = np.abs(r)
    size[:, :2] = np.linalg.norm(r[:, :2], axis=1, keepdims=True)
    robust = 1.0 / (1.0 + (size / _CAUCHY) ** 2)
    W = (robust * cells.weight[:, None]).reshape(-1)
    flat = J.reshape(len(W), -1)
    H = flat.T @ (flat * W[:, None])
    g = flat.T @ (r.reshape(-1) * W)
    information, gradient = body.prior()
    H[:-1, :-1] += information
    g[:-1] += gradient
    H[-1, -1] += 1.0 / level_sigma**2
    g[-1] += level / level_sigma**2
    return r, robust, H, g
