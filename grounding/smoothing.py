"""Smoothing of a pose track on SE(3): each pose is pulled to a local polynomial through its neighbours, jumps are kept.

Local polynomial regression with tricube and robust weights (LOESS, Cleveland 1979) on positions and, in the tangent
space at the frame's own rotation, on rotations.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose, rotation_exp, rotation_log

HALF_WINDOW = 3
"""Frames before and after that a pose is smoothed with."""
_DEGREE = 2
_MIN_NEIGHBOURS = 4
_L1_PASSES, _TUKEY_PASSES = 4, 2
_FLOOR = (1e-3, 1e-2)  # residuals [m, rad] below which no neighbour is doubted


def _local_value(offset: Array, values: Array, weight: Array, floor: float) -> Array:
    """Value at offset 0 of a polynomial fitted to `values` (n, 3) at `offset` (n,).

    Least absolute deviations first, which a wild frame cannot bend, then Tukey's weights about that.
    """
    degree = min(_DEGREE, int((weight > 0).sum()) - 1)
    A = np.vander(offset, degree + 1, increasing=True)
    robust = np.ones(len(offset))
    coefficients: Array = np.zeros((degree + 1, values.shape[1]))
    for number in range(1 + _L1_PASSES + _TUKEY_PASSES):
        w = np.sqrt(weight * robust)[:, None]
        coefficients = np.asarray(np.linalg.lstsq(A * w, values * w, rcond=None)[0], dtype=np.float64)
        residual = np.linalg.norm(values - A @ coefficients, axis=1)
        if number < _L1_PASSES:
            robust = floor / np.maximum(residual, 0.1 * floor)
        else:
            cut = max(6.0 * float(np.median(residual)), 3.0 * floor)
            robust = np.clip(1.0 - (residual / cut) ** 2, 0.0, 1.0) ** 2 + 1e-9
    return np.asarray(coefficients[0])


def smooth_track(X: ArrayLike, weight: ArrayLike, breaks: Iterable[int] = (), *, leave_out: bool = False) -> Array:
    """Smoothed poses (T, 4, 4) [m].

    Args:
        X: (T, 4, 4) poses; NaN where there is none, and so in the result.
        weight: (T,) how far each is trusted, 0 for not at all.
        breaks: frames that begin after a jump; nothing is smoothed across them.
        leave_out: give what the neighbours alone say of each frame; NaN where there are fewer than four.
    """
    X, weight = np.asarray(X, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    known = np.isfinite(X).all(axis=(1, 2))
    segment = np.zeros(len(X), dtype=int)
    for frame in breaks:
        segment[frame:] += 1
    smoothed = np.full_like(X, np.nan) if leave_out else X.copy()
    for i in np.flatnonzero(known).tolist():
        near = np.arange(max(0, i - HALF_WINDOW), min(len(X), i + HALF_WINDOW + 1))
        near = near[known[near] & (segment[near] == segment[i]) & ~(leave_out & (near == i))]
        if len(near) < _MIN_NEIGHBOURS:
            continue
        offset = (near - i).astype(np.float64)
        w = (1.0 - np.abs(offset / (HALF_WINDOW + 1)) ** 3) ** 3 * np.maximum(weight[near], 1e-3)
        turn = rotation_log(X[i, :3, :3].T @ X[near, :3, :3])
        R = X[i, :3, :3] @ rotation_exp(_local_value(offset, turn, w, _FLOOR[1]))
        smoothed[i] = make_pose(R, _local_value(offset, X[near, :3, 3], w, _FLOOR[0]))
    return smoothed
