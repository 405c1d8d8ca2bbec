"""Relaxation of a joint path: lower joint rates for the same poses, by moving each posture along its null direction."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver

ALLOWANCE = 4.0
"""Standard deviations of the noise by which limits of speed and acceleration are widened."""
FROM_REST = 1e-3
"""Weight of the squared distance from the rest posture [1/rad^2]."""
ASSUMED_ACCELERATION_PER_SPEED = 5.0
"""Acceleration limit / speed limit of arms that publish no acceleration limit [1/s]."""

_NEAR_LIMIT_RAD = 0.005  # margin to the joint limits where possible
_LIMIT_WEIGHT = 1e4
_STEPS = 8
_PEAK_STEPS = 40
# weight of a ratio's eighth power beside its square, up to this ratio
_PEAK_WEIGHT = 10.0
_PEAK_AT_MOST = 3.0
_LARGEST_STEP_RAD = 0.3


def peak_ratio(plant: ArmPlant, t_s: Array, q: Array, noise_rad: float = 0.0) -> float:
    """Return the greatest speed or acceleration / limit of a path (T, 7) [rad] at times (T,) [s]; 0 for one posture.

    Limits are widened by the noise, as in `relax`.
    """
    if len(q) < 2:
        return 0.0
    problem = _Smoothing(plant, t_s, noise_rad)
    return problem.peak(problem.residuals(q))


def relax(
    plant: ArmPlant, t_s: Array, X_BG: Array, q: Array, noise_rad: float = 0.0, fixed: NDArray[np.bool_] | None = None
) -> Array:
    """Return a path (T, 7) [rad] through the same poses with lower joint rates than the path `q` (T, 7).

    Gauss-Newton (Levenberg-Marquardt) on one variable per frame, the step along its null direction, with a banded
    system (J. Nocedal and S. Wright, Numerical Optimization, 2006, ch. 10). It minimises the sum of squares of joint
    speed and acceleration over their limits, then, by iteratively reweighted least squares, those that still exceed
    their limit. A weak pull to the rest posture makes the solution unique; a stiff penalty keeps joint limits where
    null motion allows.

    Args:
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q: (T, 7) postures that reach them [rad], all finite.
        noise_rad: standard deviation of the noise in the joints [rad], by which limits are widened.
        fixed: (T,) frames that keep their posture; None if none does.
    """
    if len(q) < 2:
        return q
    problem = _Smoothing(plant, t_s, noise_rad)
    solver = posture_solver(plant)
    residual = problem.residuals(q)
    weights = [np.ones_like(r) for r in residual]
    damping = 1e-3
    for step in range(_STEPS + _PEAK_STEPS):
        if step >= _STEPS:
            if problem.peak(residual) <= 1.0:
                break
            # weights grow steeply where a ratio exceeds 1
            weights = [1.0 + _PEAK_WEIGHT * np.minimum(np.abs(r), _PEAK_AT_MOST) ** 6 for r in residual]
        n = solver.direction(X_BG, q)
        if fixed is not None:
            n[fixed] = 0.0
        cost = problem.cost(residual, weights, q)
        for _ in range(3):
            q_new = solver.nearest(X_BG, q + n * problem.step(n, residual, weights, q, damping)[:, None])
            strayed = ~(np.abs(q_new - q).max(axis=-1) < 2 * _LARGEST_STEP_RAD)
            q_new[strayed] = q[strayed]
            residual_new = problem.residuals(q_new)
            cost_new = problem.cost(residual_new, weights, q_new)
            if cost_new < cost:
                break
            damping *= 30.0
        else:
            if step >= _STEPS:
                break
            continue
        q = q_new
        residual = residual_new
        damping = max(damping * 0.1, 1e-6)
        if step < _STEPS and cost - cost_new < 1e-4 * cost and problem.peak(residual) <= 1.0:
            break
    return q


class _Smoothing:
    """The least-squares problem of `relax`: speed, acceleration and limits as functions of the path."""

    def __init__(self, plant: ArmPlant, t_s: Array, noise_rad: float) -> None:
        noise = ALLOWANCE * noise_rad
        dt = np.diff(t_s)[:, None]
        accelerations = plant.acceleration_limits
        if accelerations is None:
            accelerations = ASSUMED_ACCELERATION_PER_SPEED * plant.velocity_limits
        self._rest = plant.robot.rest_q
        self._lower = plant.lower + _NEAR_LIMIT_RAD
        self._upper = plant.upper - _NEAR_LIMIT_RAD
        v = 1.0 / (dt * plant.velocity_limits + np.sqrt(2.0) * noise)  # (T-1, 7)
        self._stencils = [[-v, v]]
        if len(dt) > 1:
            mean = 0.5 * (dt[1:] + dt[:-1])
            before = 1.0 / (dt[:-1] * mean)
            after = 1.0 / (dt[1:] * mean)
            stencil = np.stack([before, -before - after, after])
            self._stencils.append([*(stencil / (accelerations + noise * np.linalg.norm(stencil, axis=0)))])  # (T-2, 7)

    def residuals(self, q: Array) -> list[Array]:
        """Return speeds (T-1, 7) and accelerations (T-2, 7) over their limits."""
        return [
            np.asarray(sum(c * q[k : len(q) - len(stencil) + 1 + k] for k, c in enumerate(stencil)))
            for stencil in self._stencils
        ]

    @staticmethod
    def peak(residual: list[Array]) -> float:
        """Return the largest ratio."""
        return max(float(np.abs(r).max()) for r in residual)

    def _past(self, q: Array) -> Array:
        return np.asarray(np.maximum(q - self._upper, 0.0) - np.maximum(self._lower - q, 0.0))

    def cost(self, residual: list[Array], weights: list[Array], q: Array) -> float:
        """Return the weighted sum of squares, including the limit penalty."""
        return sum(
            (float(np.sum(w * r * r)) for w, r in zip(weights, residual, strict=True)),
            start=_LIMIT_WEIGHT * float(np.sum(self._past(q) ** 2)) + FROM_REST * float(np.sum((q - self._rest) ** 2)),
        )

    def step(self, n: Array, residual: list[Array], weights: list[Array], q: Array, damping: float) -> Array:
        """Return the steps (T,) [rad] along the null directions `n` (T, 7) of one damped Gauss-Newton iteration."""
        T = len(q)
        bands = np.zeros((3, T))  # lower form: bands[k, i] couples frames i and i + k
        gradient = np.zeros(T)
        for stencil, r, w in zip(self._stencils, residual, weights, strict=True):
            size = len(stencil)
            rows = [c * n[k : T - size + 1 + k] for k, c in enumerate(stencil)]
            for k, row in enumerate(rows):
                gradient[k : T - size + 1 + k] += np.sum(w * row * r, axis=-1)
                for other in range(k, size):
                    bands[other - k, k : T - size + 1 + k] += np.sum(w * row * rows[other], axis=-1)
        past = self._past(q)
        stiffness = _LIMIT_WEIGHT * (past != 0.0)
        bands[0] += np.sum((stiffness + FROM_REST) * n * n, axis=-1)
        gradient += np.sum((stiffness * past + FROM_REST * (q - self._rest)) * n, axis=-1)
        bands[0] += damping * (bands[0] + 1e-6) + 1e-9
        delta = solveh_banded(bands[: min(3, T)], -gradient, lower=True, check_finite=False)
        return np.asarray(np.clip(delta, -_LARGEST_STEP_RAD, _LARGEST_STEP_RAD))
