"""Robust least squares of a model's parameters on reprojection and range residuals, with a common depth factor.

An estimated depth errs by nearly the same factor everywhere on the robot, so a common factor of all ranges is estimated
as well: the shape of the depth counts more than its absolute value, which is weighed against the apparent size.
"""

from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.correspondences import Correspondences

_CAUCHY = 2.0  # residual, in standard deviations, whose weight is one half
_NEAREST_M = 0.05


class FitModel(Protocol):
    """Model with K parameters that predicts where CAD points are."""

    def predict(self, cells: Correspondences) -> tuple[Array, Array]:
        """Return the CAD points (N, 3) in the camera frame [m] and their derivatives (N, 3, K) by the parameters."""
        ...

    def prior(self) -> tuple[Array, Array]:
        """Return the information matrix (K, K) of the parameters' prior and the gradient (K,) of its cost."""
        ...

    def updated(self, step: Array) -> Self:
        """Return the model after a change (K,) of its parameters."""
        ...


ModelType = TypeVar("ModelType", bound=FitModel)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution(Generic[ModelType]):
    """Result of `solve`."""

    model: ModelType
    log_depth_factor: float
    """Logarithm of true range over estimated range."""
    residual: Array
    """(N, 3) residuals in standard deviations: two across the line of sight, then log range."""
    robust: Array
    """(N, 3) robust weights, 0..1."""
    information: Array
    """(K, K) inverse covariance of the parameters, with the depth factor marginalized."""


def residuals(p_C: Array, d_p: Array, cells: Correspondences, log_depth_factor: float) -> tuple[Array, Array]:
    """Return the residuals of predicted points and their derivatives.

    Args:
        p_C: (N, 3) predicted points in the camera frame [m].
        d_p: (N, 3, K) their derivatives by the parameters.
        cells: N correspondences.
        log_depth_factor: logarithm of true range over estimated range.

    Returns:
        Residuals (N, 3), as in `Solution`, and their derivatives (N, 3, K + 1), by the log depth factor last.
    """
    p_L = np.einsum("nij,nj->ni", cells.R_LC, p_C)
    d_L = cells.R_LC @ d_p
    z = p_L[:, 2]
    r, J = np.empty((len(z), 3)), np.zeros((len(z), 3, d_p.shape[2] + 1))
    across = cells.sigma_m
    r[:, :2] = p_L[:, :2] / across
    J[:, :2, :-1] = (d_L[:, :2] - (p_L[:, :2] / z[:, None])[..., None] * d_L[:, 2:]) / across[..., None]
    sigma = np.hypot(cells.range_sigma, cells.sigma_m[:, 0] / z)
    r[:, 2] = (np.log(np.maximum(z, 1e-3) / cells.range_m) - log_depth_factor) / sigma
    J[:, 2, :-1] = d_L[:, 2] / (z * sigma)[:, None]
    J[:, 2, -1] = -1.0 / sigma
    return r, J


def solve(
    model: ModelType,
    cells: Correspondences,
    depth_factor_sigma: float,
    log_depth_factor: float = 0.0,
    *,
    iterations: int = 8,
) -> Solution[ModelType] | None:
    """Minimize Cauchy-weighted residuals by Gauss-Newton; None if a point ends behind the camera.

    Args:
        model: initial parameters.
        cells: correspondences.
        depth_factor_sigma: prior relative standard deviation of the depth factor.
        log_depth_factor: initial logarithm of the depth factor.
        iterations: greatest number of steps.
    """
    for _ in range(iterations):
        _, _, H, g = _normal_equations(model, cells, depth_factor_sigma, log_depth_factor)
        step: Array = np.asarray(-np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)) + 1e-9 * np.eye(len(H)), g))
        model, log_depth_factor = model.updated(step[:-1]), log_depth_factor + step[-1]
        if np.abs(step).max() < 1e-4:
            break
    p_C, _ = model.predict(cells)
    if not np.isfinite(p_C).all() or (p_C[:, 2] < _NEAREST_M).any():
        return None
    r, weight, H, _ = _normal_equations(model, cells, depth_factor_sigma, log_depth_factor)
    information = H[:-1, :-1] - np.outer(H[:-1, -1], H[:-1, -1]) / H[-1, -1]
    return Solution(model=model, log_depth_factor=log_depth_factor, residual=r, robust=weight, information=information)


def _normal_equations(
    model: FitModel, cells: Correspondences, depth_factor_sigma: float, log_depth_factor: float
) -> tuple[Array, Array, Array, Array]:
    """Return residuals, robust weights, normal matrix and gradient; the last unknown is the log depth factor."""
    r, J = residuals(*model.predict(cells), cells, log_depth_factor)
    size = np.abs(r)
    size[:, :2] = np.linalg.norm(r[:, :2], axis=1, keepdims=True)
    robust = 1.0 / (1.0 + (size / _CAUCHY) ** 2)
    W = (robust * cells.weight[:, None]).reshape(-1)
    flat = J.reshape(len(W), -1)
    H = flat.T @ (flat * W[:, None])
    g = flat.T @ (r.reshape(-1) * W)
    information, gradient = model.prior()
    H[:-1, :-1] += information
    g[:-1] += gradient
    H[-1, -1] += 1.0 / depth_factor_sigma**2
    g[-1] += log_depth_factor / depth_factor_sigma**2
    return r, robust, H, g
