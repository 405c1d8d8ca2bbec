"""The joint path that asks least of the joints among all that follow a track of poses.

First dynamic programming over grids of postures finds the branch and rough course, globally; then Gauss-Newton steps
along each posture's null direction polish it. Both look at joint speed over its limit, the polish at acceleration too.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.linalg import solveh_banded

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import Postures

SAMPLES, ROUNDS = (36, 72, 240), (0, 5, 5)
"""Angles of the redundancy tried for each pose (of the Panda: joint 7 every 10 degrees), and how often they are halved
where postures lie far apart; the finer grids only where the coarser ones lead to a path that the robot cannot do."""
_GRIDS_AROUND = 2  # of them where postures are picked one by one, which takes time
ANCHOR_S = 0.15
"""Least time between poses that the grid search looks at; those between are interpolated [s]."""

WARM_ANCHORS_S = (0.8, 0.4)
"""The same where a path goes on from a known posture, on its branch and, where that does not lead on, on any [s]."""

_WARM_STEP_RAD = 0.3  # spacing of the redundancy's angles there
_WARM_SAMPLES = 24  # angles of the redundancy over a full turn
_WARM_SMOOTHING = 2  # passes of the kernel (1, 2, 1) / 4 over what they give
_BETWEEN_RAD = np.array([-0.05, 0.0, 0.05])  # joint-7 offsets tried about the interpolated path
_PAST_LIMIT_RAD = 0.05  # how far past a limit postures of the grid may be: a path along a limit lies between its points
_FROM_START, _FROM_REST = 1e-2, 1e-3  # weights of squared distances from the start and from the rest posture [1/rad^2]
_OUTSIDE = 30.0  # weight of a posture past a limit, per radian
_PEAK = 4.0  # weight of the eighth power of a step's speed ratio beside its square
_TOO_FAST = 1000.0  # weight of a step that no joint speed allows
_NEAR_LIMIT_RAD = 0.005  # the polish keeps this far from limits where it can
_LIMIT_WEIGHT = 1e4
_STEPS, _PEAK_STEPS = 8, 40
_PEAK_WEIGHT, _PEAK_AT_MOST = 10.0, 3.0  # weight of a ratio's eighth power beside its square, up to this ratio
_LARGEST_STEP_RAD = 0.3
_ALLOWANCE = 4.0  # standard errors of noise that speeds and accelerations may be over their limits
_FALLBACK_ACCELERATION = 5.0  # acceleration limit / speed limit [1/s] of arms that publish none


def excess(plant: ArmPlant, q: Array) -> Array:
    """How far (..., 7) [rad] each joint of `q` is past its limit; 0 within."""
    return np.asarray(np.maximum(np.maximum(plant.lower - q, q - plant.upper), 0.0))


def speed_ratios(plant: ArmPlant, t_s: Array, q: Array) -> Array:
    """Joint speeds / their limits (n - 1, 7) between consecutive rows of `q` (n, 7) [rad] at times `t_s` (n,) [s]."""
    return np.asarray(np.abs(np.diff(q, axis=0)) / np.diff(t_s)[:, None] / plant.velocity_limits)


def candidates(plant: ArmPlant, postures: Postures, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
    """Of each pose (T, 4, 4) the postures (N_t, 7) [rad] of the grid that are within limits, or all but."""
    layers = postures.all(X_BG, samples, rounds)
    return [layer[excess(plant, layer).max(axis=-1, initial=0.0) <= _PAST_LIMIT_RAD] for layer in layers]


def anchors(t_s: Array, spacing_s: float) -> NDArray[np.intp]:
    """Frames (N,) at least `spacing_s` apart, the first and the last among them."""
    chosen = [0]
    for i in range(1, len(t_s) - 1):
        if t_s[i] - t_s[chosen[-1]] >= spacing_s - 1e-9:
            chosen.append(i)
    return np.array([*chosen, len(t_s) - 1] if len(t_s) > 1 else chosen)


def smoothest_path(
    plant: ArmPlant,
    postures: Postures,
    t_s: Array,
    X_BG: Array,
    q_start: Array,
    noise_rad: float = 0.0,
    allowed: Mapping[int, Callable[[Array], NDArray[np.bool_]]] | None = None,
) -> Array:
    """Path (T, 7) [rad] of the whole search: grid, frames between the grid's, polish; NaN where nothing was found.

    Args:
        plant: the robot.
        postures: how its postures are found.
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q_start: (7,) posture [rad] to start near.
        noise_rad: standard deviation of the noise that the poses bring into the joints [rad]: what it explains is no
            reason to search on.
        allowed: for some frames, which (N,) of postures (N, 7) may be used; the polish leaves these frames alone.
    """
    best, least = np.full((len(t_s), 7), np.nan), (np.inf, np.inf)
    allowed = allowed or {}
    chosen = np.arange(len(t_s)) if allowed else anchors(t_s, ANCHOR_S)
    held = np.isin(np.arange(len(t_s)), list(allowed))
    grids = list(zip(SAMPLES, ROUNDS, strict=True))
    for samples, rounds in grids[: _GRIDS_AROUND if allowed else None]:
        layers = candidates(plant, postures, X_BG[chosen], samples, rounds)
        for i, may in allowed.items():
            layers[i] = layers[i][may(layers[i])]
        path = _through(plant, postures, t_s, X_BG, chosen, layers, q_start, 2 * np.pi / samples, noise_rad, held)
        kept = np.flatnonzero(np.isfinite(path[:, 0]))
        outside = excess(plant, path[kept]).max(axis=-1) > 0.0
        peak = _Smoothing(plant, t_s[kept], noise_rad).peak_of(path[kept])
        worst = float(outside.sum()) + len(path) - len(kept), peak
        if worst < least:
            best, least = path, worst
        if least[0] == 0.0 and least[1] <= 1.0:
            break
    return best


def continued_path(plant: ArmPlant, postures: Postures, t_s: Array, X_BG: Array, q_start: Array) -> Array:
    """Path (T, 7) [rad] that goes on from a posture near the first pose: the quick way.

    A posture is chosen for few frames, by dynamic programming, first among those of the start's branch, then among
    all; the joint angles between are interpolated by a cubic spline and put on the poses, polished if need be. NaN
    where that leads past a limit or to a step that is too fast: then `smoothest_path` may find more. Arguments as for
    `smoothest_path`.
    """
    chosen = anchors(t_s, WARM_ANCHORS_S[0])
    path = _bridged(plant, postures, t_s, X_BG, chosen, postures.along_branch(X_BG[chosen], q_start), q_start)
    if not is_sound(plant, t_s, path):
        chosen = anchors(t_s, WARM_ANCHORS_S[1])
        layers = postures.all(X_BG[chosen], _WARM_SAMPLES)
        layers[0] = postures.nearest(X_BG[:1], q_start[None])
        path = _bridged(plant, postures, t_s, X_BG, chosen, layers, q_start)
        if np.isfinite(path).all() and not is_sound(plant, t_s, path):
            path = relax(plant, postures, t_s, X_BG, path)
    return path if is_sound(plant, t_s, path) else np.full((len(t_s), 7), np.nan)


def _bridged(
    plant: ArmPlant,
    postures: Postures,
    t_s: Array,
    X_BG: Array,
    chosen: NDArray[np.intp],
    layers: list[Array],
    q_start: Array,
) -> Array:
    """Path (T, 7) through the best of `layers`, the postures of the frames `chosen`; NaN where one has none."""
    layers = [layer[excess(plant, layer).max(axis=-1, initial=0.0) <= 0.0] for layer in layers]
    path = cheapest(plant, t_s[chosen], layers, q_start, _WARM_STEP_RAD)
    if len(chosen) < 2 or not np.isfinite(path).all():
        return np.full((len(t_s), 7), np.nan)
    for _ in range(_WARM_SMOOTHING):  # the grid's steps
        path[1:-1] = 0.25 * path[:-2] + 0.5 * path[1:-1] + 0.25 * path[2:]
    return postures.nearest(X_BG, CubicSpline(t_s[chosen], path)(t_s))


def is_sound(plant: ArmPlant, t_s: Array, q: Array, past_rad: float = 0.0) -> bool:
    """Whether a path (T, 7) [rad] is known everywhere, at most `past_rad` past limits and nowhere too fast."""
    return bool(
        np.isfinite(q).all()
        and excess(plant, q).max(initial=0.0) <= past_rad
        and speed_ratios(plant, t_s, q).max(initial=0.0) <= 1.0
    )


def _through(
    plant: ArmPlant,
    postures: Postures,
    t_s: Array,
    X_BG: Array,
    chosen: NDArray[np.intp],
    layers: list[Array],
    q_start: Array,
    spacing: float,
    noise_rad: float,
    held: NDArray[np.bool_],
) -> Array:
    """Polished path (T, 7) through `layers` (N of (N_t, 7)), the postures of the frames `chosen` (N,)."""
    path = np.full((len(t_s), 7), np.nan)
    path[chosen] = cheapest(plant, t_s[chosen], layers, q_start, spacing, noise_rad)
    kept = np.flatnonzero(np.isfinite(path[:, 0]))
    if len(kept) == 0:
        return path
    if len(chosen) < len(t_s):
        path[kept] = relax(plant, postures, t_s[kept], X_BG[kept], path[kept], noise_rad)
        path = _between(plant, postures, t_s, X_BG, path, kept, noise_rad)
        kept = np.flatnonzero(np.isfinite(path[:, 0]))
    path[kept] = relax(plant, postures, t_s[kept], X_BG[kept], path[kept], noise_rad, held[kept])
    return path


def _between(
    plant: ArmPlant,
    postures: Postures,
    t_s: Array,
    X_BG: Array,
    path: Array,
    kept: NDArray[np.intp],
    noise_rad: float,
) -> Array:
    """The path (T, 7) known at the frames `kept` filled in: the branches nearest to the interpolated postures."""
    within = np.clip(t_s, t_s[kept[0]], t_s[kept[-1]])
    guess = PchipInterpolator(t_s[kept], path[kept])(within) if len(kept) > 1 else np.tile(path[kept], (len(t_s), 1))
    filled = postures.nearest(X_BG, guess)
    filled[kept] = path[kept]
    if is_sound(plant, t_s, filled, past_rad=_PAST_LIMIT_RAD):
        return filled
    near = postures.around(X_BG, guess, _BETWEEN_RAD)
    near = [layer[excess(plant, layer).max(axis=-1, initial=0.0) <= _PAST_LIMIT_RAD] for layer in near]
    return cheapest(plant, t_s, near, path[kept[0]], float(_BETWEEN_RAD[-1]), noise_rad)


def cheapest(
    plant: ArmPlant, t_s: Array, layers: list[Array], q_start: Array, spacing: float, noise_rad: float = 0.0
) -> Array:
    """One posture a layer (T, 7) [rad] of the path that asks least of the joints, by dynamic programming.

    A step costs r^2 + 4 r^8, r its greatest joint speed over that joint's limit (the second part so that one fast step
    costs more than many slow ones), and very much more where it is faster than the limit by more than the grid's
    spacing explains; the first posture's distance from `q_start` decides between
    equals. So a branch that leads to a dead end is left before the track begins, not at the end. Layers without a
    posture give NaN and are bridged.

    Args:
        plant: the robot.
        t_s: (T,) times of the layers [s], increasing.
        layers: T arrays (N_t, 7) of postures [rad], some empty.
        q_start: (7,) posture [rad] to start near.
        spacing: distance of the grid's postures along the redundancy [rad].
        noise_rad: standard deviation of the noise in the joints [rad].
    """
    path = np.full((len(t_s), 7), np.nan)
    frames = [i for i, layer in enumerate(layers) if len(layer)]
    if not frames:
        return path
    outside = [_OUTSIDE * excess(plant, layers[i]).max(axis=-1) for i in frames]
    scaled = [layers[i] / plant.velocity_limits for i in frames]
    noise_s = _ALLOWANCE * np.sqrt(2.0) * noise_rad / plant.velocity_limits.min()
    slack = spacing / plant.velocity_limits.min()
    own = [
        o + _FROM_REST * np.sum((layers[i] - plant.robot.rest_q) ** 2, axis=-1)
        for i, o in zip(frames, outside, strict=True)
    ]
    cost = _FROM_START * np.sum((layers[frames[0]] - q_start) ** 2, axis=-1) + own[0]
    parents = []
    for k, (i, j) in enumerate(pairwise(frames)):
        dt = float(t_s[j] - t_s[i]) + noise_s
        # Largest of seven differences, one joint at a time: no (N, N, 7) array is made.
        time = np.zeros((len(scaled[k + 1]), len(scaled[k])))
        for a, b in zip(scaled[k + 1].T, scaled[k].T, strict=True):
            np.maximum(time, np.abs(a[:, None] - b), out=time)
        ratio = time / dt
        total = cost + ratio**2 + _PEAK * ratio**8 + _TOO_FAST * np.maximum((time - slack) / dt - 1.0, 0.0) ** 2
        best = np.argmin(total, axis=-1)
        parents.append(best)
        cost = total[np.arange(len(best)), best] + own[k + 1]
    k = int(np.argmin(cost))
    for n in range(len(frames) - 1, -1, -1):
        path[frames[n]] = layers[frames[n]][k]
        if n:
            k = int(parents[n - 1][k])
    return path


def relax(
    plant: ArmPlant,
    postures: Postures,
    t_s: Array,
    X_BG: Array,
    q: Array,
    noise_rad: float = 0.0,
    held: NDArray[np.bool_] | None = None,
) -> Array:
    """Path (T, 7) [rad] through the same poses that asks less of the joints than the path `q` (T, 7) does.

    Gauss-Newton (Levenberg-Marquardt) on one number a frame, the way along its null direction, with a banded system
    (J. Nocedal and S. Wright, Numerical Optimization, 2006, ch. 10). It minimises the sum of squares of joint speed
    and acceleration over their limits; where one of them still is over its limit, steps are weighed anew so that the
    sum approaches the largest (iteratively reweighted least squares). A weak pull to the rest posture settles what
    that leaves open. Limits are kept by a stiff penalty; postures
    that start past a limit are brought within if their null motion can.

    Args:
        plant: the robot.
        postures: how its postures are found.
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q: (T, 7) postures that reach them [rad], all finite.
        noise_rad: standard deviation of the noise in the joints [rad], for which limits are widened.
        held: (T,) frames that keep their posture; None holds none.
    """
    if len(q) < 2:
        return q
    problem = _Smoothing(plant, t_s, noise_rad)
    residual = problem.residuals(q)
    weights = [np.ones_like(r) for r in residual]
    damping = 1e-3
    for step in range(_STEPS + _PEAK_STEPS):
        if step >= _STEPS:
            if problem.peak(residual) <= 1.0:
                break
            weights = problem.reweighted(residual)
        n = postures.direction(X_BG, q)
        if held is not None:
            n[held] = 0.0
        cost = problem.cost(residual, weights, q)
        for _ in range(3):
            delta = problem.step(n, residual, weights, q, damping)
            q_new = postures.nearest(X_BG, q + n * delta[:, None])
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
        q, residual, damping = q_new, residual_new, max(damping * 0.1, 1e-6)
        if step < _STEPS and cost - cost_new < 1e-4 * cost and problem.peak(residual) <= 1.0:
            break
    return q


class _Smoothing:
    """The least-squares problem of `relax`: speed, acceleration and limits as functions of the path."""

    def __init__(self, plant: ArmPlant, t_s: Array, noise_rad: float) -> None:
        noise = _ALLOWANCE * noise_rad
        dt = np.diff(t_s)[:, None]
        accelerations = plant.acceleration_limits
        if accelerations is None:
            accelerations = _FALLBACK_ACCELERATION * plant.velocity_limits
        self._rest = plant.robot.rest_q
        self._lower, self._upper = plant.lower + _NEAR_LIMIT_RAD, plant.upper - _NEAR_LIMIT_RAD
        v = 1.0 / (dt * plant.velocity_limits + np.sqrt(2.0) * noise)  # (T-1, 7)
        self._stencils = [[-v, v]]
        if len(dt) > 1:
            mean = 0.5 * (dt[1:] + dt[:-1])
            before, after = 1.0 / (dt[:-1] * mean), 1.0 / (dt[1:] * mean)
            stencil = np.stack([before, -before - after, after])
            self._stencils.append([*(stencil / (accelerations + noise * np.linalg.norm(stencil, axis=0)))])  # (T-2, 7)

    def residuals(self, q: Array) -> list[Array]:
        """Speeds (T-1, 7) and accelerations (T-2, 7) over their limits."""
        return [
            np.asarray(sum(c * q[k : len(q) - len(stencil) + 1 + k] for k, c in enumerate(stencil)))
            for stencil in self._stencils
        ]

    @staticmethod
    def peak(residual: list[Array]) -> float:
        """Largest ratio of all."""
        return max(float(np.abs(r).max()) for r in residual)

    def peak_of(self, q: Array) -> float:
        """Largest ratio along a path; 0 for fewer than two postures."""
        return self.peak(self.residuals(q)) if len(q) > 1 else 0.0

    @staticmethod
    def reweighted(residual: list[Array]) -> list[Array]:
        """Weights (as the residuals) that draw down what is over its limit and leave the rest about as it is."""
        return [1.0 + _PEAK_WEIGHT * np.minimum(np.abs(r), _PEAK_AT_MOST) ** 6 for r in residual]

    def _past(self, q: Array) -> Array:
        return np.asarray(np.maximum(q - self._upper, 0.0) - np.maximum(self._lower - q, 0.0))

    def cost(self, residual: list[Array], weights: list[Array], q: Array) -> float:
        """Weighted sum of squares, limits included."""
        return sum(
            (float(np.sum(w * r * r)) for w, r in zip(weights, residual, strict=True)),
            start=_LIMIT_WEIGHT * float(np.sum(self._past(q) ** 2)) + _FROM_REST * float(np.sum((q - self._rest) ** 2)),
        )

    def step(self, n: Array, residual: list[Array], weights: list[Array], q: Array, damping: float) -> Array:
        """Ways (T,) along the null directions `n` (T, 7) of one damped Gauss-Newton step [rad]."""
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
        held = _LIMIT_WEIGHT * (past != 0.0)
        bands[0] += np.sum((held + _FROM_REST) * n * n, axis=-1)
        gradient += np.sum((held * past + _FROM_REST * (q - self._rest)) * n, axis=-1)
        bands[0] += damping * (bands[0] + 1e-6) + 1e-9
        delta = solveh_banded(bands[: min(3, T)], -gradient, lower=True, check_finite=False)
        return np.asarray(np.clip(delta, -_LARGEST_STEP_RAD, _LARGEST_STEP_RAD))
