"""The joint path that asks least of the joints among all that follow a track of poses.

Dynamic programming over grids of postures finds the branch and rough course, globally; `relaxation` polishes it. Both
look at joint speed over its limit, the polish at acceleration too.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.newton import newton_path
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import Postures
from kinebench_drake.kinematics.relaxation import ALLOWANCE, FROM_REST, peak_ratio, relax

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
_FROM_START = 1e-2  # weight of the squared distance from the start [1/rad^2]
_OUTSIDE = 30.0  # weight of a posture past a limit, per radian
_PEAK = 4.0  # weight of the eighth power of a step's speed ratio beside its square
_TOO_FAST = 1000.0  # weight of a step that no joint speed allows


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
        peak = peak_ratio(plant, t_s[kept], path[kept], noise_rad)
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
    guess = CubicSpline(t_s[chosen], path)(t_s)
    path = postures.nearest(X_BG, guess)
    # Where the redundancy's angle leads out of the branch, Newton steps find the way that it does not know.
    return path if is_sound(plant, t_s, path) else newton_path(plant, X_BG, guess)


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
    noise_s = ALLOWANCE * np.sqrt(2.0) * noise_rad / plant.velocity_limits.min()
    slack = spacing / plant.velocity_limits.min()
    own = [
        o + FROM_REST * np.sum((layers[i] - plant.robot.rest_q) ** 2, axis=-1)
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
