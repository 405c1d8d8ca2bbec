"""Samples that a recording lost: steps twice as long as their neighbours, where the path is smooth at twice the time.

A step that breaks a limit of the robot changes the direction or the speed of the motion; a lost sample changes neither.
Around each step a cubic polynomial is fitted to six samples, with the times as they are and with one more period in the
step.
"""

import numpy as np

from kinebench_drake.geometry import Array

DOUBLED = (1.4, 2.8)
"""Range of the ratio of the step to the mean of its neighbours: accelerations change it."""
LONGEST_PERIOD_S = 0.1
"""Longest period at which lost samples are looked for: between slower ones robots start and stop [s]."""
LACKING = 0.4
"""Greatest ratio of the residuals with and without the additional period."""
UNUSUAL = 5.0
"""Least ratio of the residual as the times are to the median residual."""

_LEVER_M = 0.2  # at which a rotation counts as a motion
# samples and degree of a fit
_SIZE = 6
_DEGREE = 3
_NEAR = 0.25  # deviation of a stamped step from one or two periods [periods]


def fill_gaps(t_s: Array, X_BG: Array | None, q: Array | None) -> tuple[Array, tuple[int, ...]]:
    """Return times (T,) [s] in which steps over a lost sample last two periods, and the frames after such samples.

    Args:
        t_s: (T,) times, increasing [s].
        X_BG: (T, 4, 4) poses [m], or
        q: (T, N) joint angles [rad].
    """
    if len(t_s) < 2 * _SIZE:
        return t_s, ()
    steps = np.diff(t_s)
    period = float(np.median(np.diff(t_s)))
    if (np.abs(steps / period - 1.0) < _NEAR).mean() < 0.8:  # least share of the steps that are one period
        return t_s, ()
    stamped = np.flatnonzero(np.abs(steps / period - 2.0) < _NEAR)
    path = _path(X_BG) if q is None else q
    if period > LONGEST_PERIOD_S or not np.isfinite(path).all():
        return t_s, tuple((stamped + 1).tolist())
    t_s = t_s.copy()
    lost = set(stamped.tolist())
    for _ in range(10):  # lost samples that lie close together are found one after the other
        fresh = _find(t_s, path, period)
        if not fresh:
            break
        for step in fresh:
            t_s[step + 1 :] += period
        lost.update(fresh)
    return t_s, tuple(sorted(step + 1 for step in lost))


def _path(X_BG: Array | None) -> Array:
    """Return the path (T, 9) [m] of three points that move with the poses (T, 4, 4)."""
    X = np.empty((0, 4, 4)) if X_BG is None else X_BG
    p = X[:, :3, 3]
    return np.concatenate([p, p + _LEVER_M * X[:, :3, 0], p + _LEVER_M * X[:, :3, 1]], axis=1)


def _find(t_s: Array, path: Array, period: float) -> list[int]:
    """Return the steps that lack a sample, of close ones the clearest."""
    n = len(t_s)
    step = np.arange(1, len(t_s) - 2)
    around = np.clip(step - 2, 0, n - _SIZE)[:, None] + np.arange(_SIZE)
    times = t_s[around]
    points = path[around]
    as_is, filled = (_residuals(t, points) for t in (times, times + period * (around > step[:, None])))
    speed = np.linalg.norm(np.diff(path, axis=0), axis=-1) / np.diff(t_s)
    ratio = 2.0 * speed[step] / np.maximum(speed[step - 1] + speed[step + 1], 1e-12)
    lacks = (filled < LACKING * as_is) & (
        as_is > UNUSUAL * max(float(np.median(as_is)), 1e-5)
    )  # least residual [m or rad]
    lacks &= (ratio > DOUBLED[0]) & (ratio < DOUBLED[1]) & (np.diff(t_s)[step] < (1.0 + _NEAR) * period)
    clear = np.where(lacks, as_is, 0.0)
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(clear, 3), 7).max(axis=-1)
    return [int(k) for k in step[lacks & (clear >= nearby)]]


def _residuals(times: Array, points: Array) -> Array:
    """Return the residuals (N,) of cubics through points (N, n, axes) at times (N, n)."""
    x = times - times.mean(axis=-1, keepdims=True)
    x /= np.abs(x).max(axis=-1, keepdims=True)
    Q = np.linalg.qr(x[:, :, None] ** np.arange(_DEGREE + 1))[0]
    return np.asarray(np.linalg.norm(points - Q @ (np.swapaxes(Q, -1, -2) @ points), axis=(-2, -1)))
