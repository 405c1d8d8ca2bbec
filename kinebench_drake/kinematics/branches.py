"""The postures that reach a pose, all of them to a grid's fineness, and the smoothest path through those of a track."""

from itertools import pairwise

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.kinematics.plant import ArmPlant

SWEEP = 128
"""Angles of joint 7 tried over a full turn (one every 2.8 degrees)."""

_COARSE_RAD = 0.15  # joint change that a path along the first grid may owe to the grid alone
_REFINEMENTS_RAD = (0.1, 0.02)  # half widths of the finer grids of joint 7 around the path
_NEAR_RAD = 0.6  # farthest that a refinement may move a joint
_PAST_LIMIT_RAD = 0.03  # how far past a limit postures of the first grid may be
_TOO_FAST = 1000.0  # weight of a step that no joint speed allows


def postures(X_BG: Array, samples: int = SWEEP) -> Array:
    """Postures (N, 7) [rad] that reach `X_BG` (4, 4), joint limits ignored, for joint 7 over a full turn."""
    q7 = np.linspace(-np.pi, np.pi, samples, endpoint=False)
    q = analytic_ik(X_BG, q7).reshape(-1, 7)
    return q[np.isfinite(q[:, 0])]


def excess(plant: ArmPlant, q: Array) -> Array:
    """How far (..., 7) [rad] each joint of `q` is past its limit; 0 within."""
    return np.asarray(np.maximum(np.maximum(plant.lower - q, q - plant.upper), 0.0))


def least_excess(plant: ArmPlant, X_BG: Array) -> Array | None:
    """Posture (7,) [rad] that reaches `X_BG` with its worst joint least past its limit; None if out of reach."""
    q = postures(X_BG)
    return None if len(q) == 0 else np.asarray(q[np.argmin(excess(plant, q).max(axis=-1))])


def smoothest_path(plant: ArmPlant, t_s: Array, X_BG: Array, q_start: Array) -> Array:
    """One posture a pose (T, 7) [rad] of the path that asks least of the joints, to the grid's fineness.

    Dynamic programming over the grid of postures of every pose, then again over finer grids around the path found. A
    step costs (its greatest joint speed / that joint's limit)^2, and very much more where it is faster than the
    limit; the first posture's distance from `q_start` decides between equals. So a branch that leads to a dead end is
    left before the track begins, not at the end. Postures are within limits (on the first grid a little past them too,
    since a path along a limit lies between its points). Poses without a posture get NaN and are bridged.

    Args:
        plant: the robot.
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of panda_hand_tcp in panda_link0 [m].
        q_start: (7,) posture [rad] to start near.
    """
    layers = [_allowed(plant, postures(X, SWEEP // 2), _PAST_LIMIT_RAD) for X in X_BG]
    path = _cheapest(plant, t_s, layers, q_start, grid=_COARSE_RAD)
    for width in _REFINEMENTS_RAD:
        offsets = np.linspace(-width, width, 13)
        for i in np.flatnonzero(np.isfinite(path[:, 0])):
            q = analytic_ik(X_BG[i], path[i, 6] + offsets).reshape(-1, 7)
            q = _allowed(plant, q[np.isfinite(q[:, 0])], 0.0)
            layers[i] = q[np.abs(q - path[i]).max(axis=-1, initial=0.0) < _NEAR_RAD]
        path = _cheapest(plant, t_s, layers, q_start, grid=width / 6)
    return path


def _allowed(plant: ArmPlant, q: Array, slack: float) -> Array:
    return np.asarray(q[excess(plant, q).max(axis=-1, initial=0.0) <= slack])


def _cheapest(plant: ArmPlant, t_s: Array, layers: list[Array], q_start: Array, grid: float) -> Array:
    """Path (T, 7) through `layers` (T of (N_t, 7), some empty); a step may owe `grid` [rad] to the grid alone."""
    path = np.full((len(t_s), 7), np.nan)
    frames = [i for i, layer in enumerate(layers) if len(layer)]
    if not frames:
        return path
    cost = 1e-3 * np.sum((layers[frames[0]] - q_start) ** 2, axis=-1)
    parents = []
    for i, j in pairwise(frames):
        allowed = plant.velocity_limits * (t_s[j] - t_s[i])
        step = np.abs(layers[j][:, None] - layers[i][None])
        ratio = (step / allowed).max(axis=-1)
        over = (np.maximum(step - allowed - grid, 0.0) / allowed).max(axis=-1)
        total = cost + ratio**2 + _TOO_FAST * over**2
        best = np.argmin(total, axis=-1)
        parents.append(best)
        cost = total[np.arange(len(best)), best]
    k = int(np.argmin(cost))
    for n in range(len(frames) - 1, -1, -1):
        path[frames[n]] = layers[frames[n]][k]
        if n:
            k = int(parents[n - 1][k])
    return path


def speed_ratios(plant: ArmPlant, t_s: Array, q: Array) -> Array:
    """Greatest joint speed / its limit (n - 1,) between consecutive finite rows of `q` (T, 7) [rad]."""
    kept = np.isfinite(q[:, 0])
    rate = np.abs(np.diff(q[kept], axis=0)) / np.diff(t_s[kept])[:, None]
    return np.asarray((rate / plant.velocity_limits).max(axis=-1, initial=0.0))


def smooth(q: Array) -> Array:
    """Rows `q` (n, 7) [rad] averaged by the kernel (1, 2, 1) / 4, both ends and jumps over 0.5 rad kept."""
    step = np.abs(np.diff(q, axis=0)).max(axis=-1, initial=0.0) < 0.5
    inner = np.flatnonzero(step[:-1] & step[1:]) + 1
    q_new = q.copy()
    q_new[inner] = 0.25 * q[inner - 1] + 0.5 * q[inner] + 0.25 * q[inner + 1]
    return q_new
