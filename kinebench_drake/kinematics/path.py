"""Search of the joint path with the least joint rates among all that follow a track of poses.

Dynamic programming over grids of postures selects branch and coarse path globally. Relaxation refines it: it lowers the
joint rates for the same poses, by moving each posture along its null direction. Both minimise joint speed over its
limit, the relaxation also acceleration.
"""

from collections.abc import Callable, Mapping
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.linalg import solveh_banded
from scipy.spatial.distance import cdist

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver
from kinebench_drake.models.joint_limits import JointLimits
from kinebench_drake.segments import spread

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
    """Return the greatest speed or acceleration / limit of a path (T, J) [rad] at times (T,) [s]; 0 for one posture.

    Limits are widened by the noise, as in `relax`.
    """
    if len(q) < 2:
        return 0.0
    problem = _Smoothing(plant, t_s, noise_rad)
    return problem.peak(problem.residuals(q))


def relax(
    plant: ArmPlant, t_s: Array, X_BG: Array, q: Array, noise_rad: float = 0.0, fixed: NDArray[np.bool_] | None = None
) -> Array:
    """Return a path (T, J) [rad] through the same poses with lower joint rates than the path `q` (T, J).

    Gauss-Newton (Levenberg-Marquardt) on one variable per frame, the step along its null direction, with a banded
    system (J. Nocedal and S. Wright, Numerical Optimization, 2006, ch. 10). It minimises the sum of squares of joint
    speed and acceleration over their limits, then, by iteratively reweighted least squares, those that still exceed
    their limit. A weak pull to the rest posture makes the solution unique; a stiff penalty keeps joint limits where
    null motion allows.

    Args:
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q: (T, J) postures that reach them [rad], all finite.
        noise_rad: standard deviation of the noise in the joints [rad], by which limits are widened.
        fixed: (T,) frames that keep their posture; None if none does.
    """
    if len(q) < 2 or q.shape[1] <= 6:  # no null motion
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


def _slow_room(limits: JointLimits) -> Array:
    """Return twice the angle (J,) [rad] before a position limit in which no speed towards it is allowed."""
    if limits.deceleration is None or limits.velocity_offset is None:
        return np.zeros(len(limits.lower))
    return limits.velocity_offset**2 / limits.deceleration


class _Smoothing:
    """The least-squares problem of `relax`: speed, acceleration and limits as functions of the path."""

    def __init__(self, plant: ArmPlant, t_s: Array, noise_rad: float) -> None:
        noise = ALLOWANCE * noise_rad
        dt = np.diff(t_s)[:, None]
        accelerations = plant.acceleration_limits
        if accelerations is None:
            accelerations = ASSUMED_ACCELERATION_PER_SPEED * plant.planned_speeds
        self._rest = plant.robot.rest_q
        near_rad = _NEAR_LIMIT_RAD + _slow_room(plant.robot.limits)
        self._lower = plant.lower + near_rad
        self._upper = plant.upper - near_rad
        v = 1.0 / (dt * plant.planned_speeds + np.sqrt(2.0) * noise)  # (T-1, J)
        self._stencils = [[-v, v]]
        if len(dt) > 1:
            mean = 0.5 * (dt[1:] + dt[:-1])
            before = 1.0 / (dt[:-1] * mean)
            after = 1.0 / (dt[1:] * mean)
            stencil = np.stack([before, -before - after, after])
            self._stencils.append([*(stencil / (accelerations + noise * np.linalg.norm(stencil, axis=0)))])  # (T-2, J)

    def residuals(self, q: Array) -> list[Array]:
        """Return speeds (T-1, J) and accelerations (T-2, J) over their limits."""
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
        """Return the steps (T,) [rad] along the null directions `n` (T, J) of one damped Gauss-Newton iteration."""
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


SAMPLES = (36, 72, 240)
ROUNDS = (0, 5, 5)
"""Samples of the redundancy per pose (of the Panda: joint 7 every 10 degrees) and halvings of intervals whose postures
are far apart; a finer grid is used only if the path of the coarser one is infeasible."""
RESTRICTED_GRIDS = 2
"""Grids used where postures are restricted, which is slow."""
ANCHOR_SPACING_S = 0.15
"""Least time between poses of the grid search [s]; postures between are interpolated."""
PAST_LIMIT_COST = 30.0
"""Cost of a posture past a limit [1/rad]."""
FROM_START = 1e-2
"""Weight of the squared distance of the first posture from the start [1/rad^2]."""
FAST_WEIGHT = 4.0
"""Weight of the eighth power of a step's speed ratio beside its square."""
TOO_FAST_WEIGHT = 1000.0
"""Weight of a step that no joint speed allows."""

_BETWEEN_RAD = np.array([-0.05, 0.0, 0.05])  # joint-7 offsets about the interpolated path
_PAST_LIMIT_RAD = 0.05  # allowed limit excess of grid postures: a path along a limit lies between grid points


def limit_excess(plant: ArmPlant, q: Array) -> Array:
    """Return by how much (..., J) [rad] each joint of `q` exceeds its limit; 0 within limits."""
    return np.asarray(np.maximum(np.maximum(plant.lower - q, q - plant.upper), 0.0))


def limit_margin(plant: ArmPlant, q: Array) -> Array:
    """Return the distance to the nearer limit / half the joint's range (..., J) of `q` (..., J) [rad]: 0 at a limit."""
    return np.asarray(np.minimum(q - plant.lower, plant.upper - q) / (0.5 * (plant.upper - plant.lower)))


def speed_ratios(plant: ArmPlant, t_s: Array, q: Array) -> Array:
    """Return joint speeds / limits (n - 1, J) between consecutive rows of `q` (n, J) [rad] at times `t_s` (n,) [s]."""
    return np.asarray(np.abs(np.diff(q, axis=0)) / np.diff(t_s)[:, None] / plant.planned_speeds)


def within_limits(plant: ArmPlant, layers: list[Array], past_rad: float = 0.0) -> list[Array]:
    """Return the postures (N_t, J) [rad] of each layer that exceed limits by at most `past_rad`."""
    rows = np.concatenate([np.zeros((0, len(plant.lower))), *layers])
    within = limit_excess(plant, rows).max(axis=-1, initial=0.0) <= past_rad
    bounds = pairwise(accumulate(map(len, layers), initial=0))
    return [layer[within[first:last]] for layer, (first, last) in zip(layers, bounds, strict=True)]


def grid_postures(plant: ArmPlant, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
    """Return for each pose (T, 4, 4) the grid postures (N_t, J) [rad] within limits plus _PAST_LIMIT_RAD."""
    return within_limits(plant, posture_solver(plant).all(X_BG, samples, rounds), _PAST_LIMIT_RAD)


def select_anchors(t_s: Array, spacing_s: float) -> NDArray[np.intp]:
    """Return frames (N,) at least `spacing_s` apart, including the first and the last."""
    chosen = [0]
    for i in range(1, len(t_s) - 1):
        if t_s[i] - t_s[chosen[-1]] >= spacing_s - 1e-9:
            chosen.append(i)
    return np.array([*chosen, len(t_s) - 1] if len(t_s) > 1 else chosen)


def search_path(
    plant: ArmPlant,
    t_s: Array,
    X_BG: Array,
    q_start: Array,
    noise_rad: float = 0.0,
    allowed: Mapping[int, Callable[[Array], NDArray[np.bool_]]] | None = None,
) -> Array:
    """Search the path (T, J) [rad]: grid of the anchors, frames between, relaxation; NaN where there is no posture.

    Args:
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q_start: (J,) posture [rad] to start near.
        noise_rad: standard deviation of the joint angles due to the noise of the poses [rad]; excess of limits that it
            explains does not start a finer search.
        allowed: for some frames, a function that returns which (N,) of postures (N, J) may be used; the relaxation
            does not move these frames.
    """
    best = np.full((len(t_s), len(q_start)), np.nan)
    least = (np.inf, np.inf)
    if len(t_s) == 0:
        return best
    allowed = allowed or {}
    chosen = np.arange(len(t_s)) if allowed else select_anchors(t_s, ANCHOR_SPACING_S)
    fixed = np.isin(np.arange(len(t_s)), list(allowed))
    for samples, rounds in list(zip(SAMPLES, ROUNDS, strict=True))[: RESTRICTED_GRIDS if allowed else None]:
        layers = grid_postures(plant, X_BG[chosen], samples, rounds)
        for i, may in allowed.items():
            layers[i] = layers[i][may(layers[i])]
        anchored = find_cheapest_path(plant, t_s[chosen], layers, q_start, 2 * np.pi / samples, noise_rad)
        path = spread(anchored, chosen, len(t_s))
        kept = np.flatnonzero(np.isfinite(path[:, 0]))
        if len(kept) and len(chosen) < len(t_s):
            path[kept] = relax(plant, t_s[kept], X_BG[kept], path[kept], noise_rad)
            path = _between(plant, t_s, X_BG, path, kept, noise_rad)
            kept = np.flatnonzero(np.isfinite(path[:, 0]))
        path[kept] = relax(plant, t_s[kept], X_BG[kept], path[kept], noise_rad, fixed[kept])
        outside = limit_excess(plant, path[kept]).max(axis=-1) > 0.0
        peak = peak_ratio(plant, t_s[kept], path[kept], noise_rad)
        worst = float(outside.sum()) + len(path) - len(kept), peak
        if worst < least:
            best = path
            least = worst
        if least[0] == 0.0 and least[1] <= 1.0:
            break
    return undo_turns(plant, best)[0]


def undo_turns(plant: ArmPlant, q: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return a path (T, J) [rad] with joints turned by the full turn that brings them into their limits; which (J,)."""
    q = q.copy()
    rows = np.isfinite(q).all(axis=-1)
    undone = np.zeros(q.shape[1], dtype=bool)
    if rows.any():
        least = limit_excess(plant, q[rows]).min(axis=0)
        for turn in (2.0 * np.pi, -2.0 * np.pi):
            turned = plant.chain.turns & (limit_excess(plant, q[rows] + turn).max(axis=0) < least)
            q[:, turned] += turn
            undone |= turned
    return q, undone


def is_sound(plant: ArmPlant, t_s: Array, q: Array, past_rad: float = 0.0) -> bool:
    """Return whether a path (T, J) [rad] is finite, exceeds limits by at most `past_rad` and keeps the speed limits."""
    return bool(
        np.isfinite(q).all()
        and limit_excess(plant, q).max(initial=0.0) <= past_rad
        and speed_ratios(plant, t_s, q).max(initial=0.0) <= 1.0
    )


def _between(plant: ArmPlant, t_s: Array, X_BG: Array, path: Array, kept: NDArray[np.intp], noise_rad: float) -> Array:
    """Fill in the path (T, J), finite at the frames `kept`, with the branches nearest to the interpolated postures."""
    within = np.clip(t_s, t_s[kept[0]], t_s[kept[-1]])
    guess = PchipInterpolator(t_s[kept], path[kept])(within) if len(kept) > 1 else np.tile(path[kept], (len(t_s), 1))
    solver = posture_solver(plant)
    filled = solver.nearest(X_BG, guess)
    filled[kept] = path[kept]
    if is_sound(plant, t_s, filled, past_rad=_PAST_LIMIT_RAD):
        return filled
    near = within_limits(plant, solver.around(X_BG, guess, _BETWEEN_RAD), _PAST_LIMIT_RAD)
    return find_cheapest_path(plant, t_s, near, path[kept[0]], float(_BETWEEN_RAD[-1]), noise_rad)


def find_cheapest_path(
    plant: ArmPlant, t_s: Array, layers: list[Array], q_start: Array, spacing: float, noise_rad: float = 0.0
) -> Array:
    """Select one posture per layer (T, J) [rad], of the path of least cost, by dynamic programming.

    A step costs r^2 + 4 r^8, r being its greatest joint speed over the limit, and much more where it exceeds the limit
    by more than the spacing of the grid explains; the distance of the first posture from `q_start` decides between
    equal paths. Layers without a posture give NaN and are skipped.

    Args:
        t_s: (T,) times of the layers [s], increasing.
        layers: T arrays (N_t, J) of postures [rad], some empty.
        q_start: (J,) posture [rad] to start near.
        spacing: distance of grid postures along the redundancy [rad].
        noise_rad: standard deviation of the noise in the joints [rad].
    """
    path = np.full((len(t_s), len(q_start)), np.nan)
    frames = [i for i, layer in enumerate(layers) if len(layer)]
    if not frames:
        return path
    rows = np.concatenate([layers[i] for i in frames])
    own = FROM_REST * np.sum((rows - plant.robot.rest_q) ** 2, axis=-1)
    own += PAST_LIMIT_COST * limit_excess(plant, rows).max(axis=-1)
    ends = np.cumsum([len(layers[i]) for i in frames])[:-1]
    scaled = np.split(rows / plant.planned_speeds, ends)
    costs = np.split(own, ends)
    dt = np.diff(t_s[frames]) + ALLOWANCE * np.sqrt(2.0) * noise_rad / plant.planned_speeds.min()
    slack_s = spacing / plant.planned_speeds.min()
    cost = FROM_START * np.sum((layers[frames[0]] - q_start) ** 2, axis=-1) + costs[0]
    parents = []
    for (before, after), step_s, added in zip(pairwise(scaled), dt, costs[1:], strict=True):
        total = cost + _step_costs(cdist(after, before, "chebyshev"), step_s, slack_s)
        best = total.argmin(axis=-1)
        parents.append(best)
        cost = total[np.arange(len(best)), best] + added
    k = int(np.argmin(cost))
    for n in range(len(frames) - 1, -1, -1):
        path[frames[n]] = layers[frames[n]][k]
        if n:
            k = int(parents[n - 1][k])
    return path


def _step_costs(time_s: Array, step_s: float, slack_s: float) -> Array:
    """Return the costs of steps that take `time_s` at the speed limits [s] and have `step_s`.

    They may exceed the limits by `slack_s`, as the spacing of the grid explains it [s].
    """
    square = (time_s / step_s) ** 2
    fast = np.square(square**2)  # several times as fast as a power of 8
    too_fast = np.maximum((time_s - slack_s) / step_s - 1.0, 0.0) ** 2
    return np.asarray(square + FAST_WEIGHT * fast + TOO_FAST_WEIGHT * too_fast)
