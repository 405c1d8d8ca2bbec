"""Search of the joint path with the least joint rates among all that follow a track of poses.

Dynamic programming over grids of postures selects branch and coarse path globally; `relaxation` refines it. Both
minimise joint speed over its limit, the relaxation also acceleration.
"""

from collections.abc import Callable, Mapping
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.distance import cdist

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver
from kinebench_drake.kinematics.relaxation import ALLOWANCE, FROM_REST, peak_ratio, relax
from kinebench_drake.segments import spread

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
    """Return by how much (..., 7) [rad] each joint of `q` exceeds its limit; 0 within limits."""
    return np.asarray(np.maximum(np.maximum(plant.lower - q, q - plant.upper), 0.0))


def limit_margin(plant: ArmPlant, q: Array) -> Array:
    """Return the distance to the nearer limit / half the joint's range (..., 7) of `q` (..., 7) [rad]: 0 at a limit."""
    return np.asarray(np.minimum(q - plant.lower, plant.upper - q) / (0.5 * (plant.upper - plant.lower)))


def speed_ratios(plant: ArmPlant, t_s: Array, q: Array) -> Array:
    """Return joint speeds / limits (n - 1, 7) between consecutive rows of `q` (n, 7) [rad] at times `t_s` (n,) [s]."""
    return np.asarray(np.abs(np.diff(q, axis=0)) / np.diff(t_s)[:, None] / plant.velocity_limits)


def within_limits(plant: ArmPlant, layers: list[Array], past_rad: float = 0.0) -> list[Array]:
    """Return the postures (N_t, 7) [rad] of each layer that exceed limits by at most `past_rad`."""
    rows = np.concatenate([np.zeros((0, 7)), *layers])
    within = limit_excess(plant, rows).max(axis=-1, initial=0.0) <= past_rad
    bounds = pairwise(accumulate(map(len, layers), initial=0))
    return [layer[within[first:last]] for layer, (first, last) in zip(layers, bounds, strict=True)]


def grid_postures(plant: ArmPlant, X_BG: Array, samples: int, rounds: int = 0) -> list[Array]:
    """Return for each pose (T, 4, 4) the grid postures (N_t, 7) [rad] within limits plus _PAST_LIMIT_RAD."""
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
    """Search the path (T, 7) [rad]: grid of the anchors, frames between, relaxation; NaN where there is no posture.

    Args:
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in the base [m].
        q_start: (7,) posture [rad] to start near.
        noise_rad: standard deviation of the joint angles due to the noise of the poses [rad]; excess of limits that it
            explains does not start a finer search.
        allowed: for some frames, a function that returns which (N,) of postures (N, 7) may be used; the relaxation
            does not move these frames.
    """
    best = np.full((len(t_s), 7), np.nan)
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
    return best


def is_sound(plant: ArmPlant, t_s: Array, q: Array, past_rad: float = 0.0) -> bool:
    """Return whether a path (T, 7) [rad] is finite, exceeds limits by at most `past_rad` and keeps the speed limits."""
    return bool(
        np.isfinite(q).all()
        and limit_excess(plant, q).max(initial=0.0) <= past_rad
        and speed_ratios(plant, t_s, q).max(initial=0.0) <= 1.0
    )


def _between(plant: ArmPlant, t_s: Array, X_BG: Array, path: Array, kept: NDArray[np.intp], noise_rad: float) -> Array:
    """Fill in the path (T, 7), finite at the frames `kept`, with the branches nearest to the interpolated postures."""
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
    """Select one posture per layer (T, 7) [rad], of the path of least cost, by dynamic programming.

    A step costs r^2 + 4 r^8, r being its greatest joint speed over the limit, and much more where it exceeds the limit
    by more than the spacing of the grid explains; the distance of the first posture from `q_start` decides between
    equal paths. Layers without a posture give NaN and are skipped.

    Args:
        t_s: (T,) times of the layers [s], increasing.
        layers: T arrays (N_t, 7) of postures [rad], some empty.
        q_start: (7,) posture [rad] to start near.
        spacing: distance of grid postures along the redundancy [rad].
        noise_rad: standard deviation of the noise in the joints [rad].
    """
    path = np.full((len(t_s), 7), np.nan)
    frames = [i for i, layer in enumerate(layers) if len(layer)]
    if not frames:
        return path
    rows = np.concatenate([layers[i] for i in frames])
    own = FROM_REST * np.sum((rows - plant.robot.rest_q) ** 2, axis=-1)
    own += PAST_LIMIT_COST * limit_excess(plant, rows).max(axis=-1)
    ends = np.cumsum([len(layers[i]) for i in frames])[:-1]
    scaled = np.split(rows / plant.velocity_limits, ends)
    costs = np.split(own, ends)
    dt = np.diff(t_s[frames]) + ALLOWANCE * np.sqrt(2.0) * noise_rad / plant.velocity_limits.min()
    slack_s = spacing / plant.velocity_limits.min()
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
