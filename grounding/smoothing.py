"""Smoothing of a pose track on SE(3): each pose is pulled to a local polynomial through its neighbours, jumps are kept.

Local polynomial regression with tricube and robust weights (LOESS, Cleveland 1979), forward and backward in time alike,
in the tangent space at the frame's own pose. What a frame knows well it says louder: its residuals are weighed by the
inverse of its covariance, so that frames that saw the arm from the side mend the range of those that did not.
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
_FLOOR = np.array([1e-2] * 3 + [1e-3] * 3)  # standard deviations [rad, m] that no frame is trusted to fall below


def _local_value(offset: Array, values: Array, weight: Array, information: Array) -> Array:
    """Value (6,) at offset 0 of a polynomial fitted to `values` (n, 6) at `offset` (n,).

    Generalised least squares with `information` (n, 6, 6); least absolute deviations first, which a wild frame cannot
    bend, then Tukey's weights about that.
    """
    degree = min(_DEGREE, int((weight > 0).sum()) - 1)
    A = np.vander(offset, degree + 1, increasing=True)
    robust = np.ones(len(offset))
    coefficients: Array = np.zeros((degree + 1, 6))
    for number in range(1 + _L1_PASSES + _TUKEY_PASSES):
        weighed = (weight * robust)[:, None, None] * information
        H = np.einsum("na,nb,nij->aibj", A, A, weighed).reshape(6 * (degree + 1), -1)
        g = np.einsum("na,nij,nj->ai", A, weighed, values).reshape(-1)
        coefficients = np.linalg.solve(H, g).reshape(degree + 1, 6)
        error = values - A @ coefficients
        residual = np.sqrt(np.einsum("ni,nij,nj->n", error, information, error) / 6)
        if number < _L1_PASSES:
            robust = 1.0 / np.maximum(residual, 0.1)
        else:
            cut = max(6.0 * float(np.median(residual)), 3.0)
            robust = np.clip(1.0 - (residual / cut) ** 2, 0.0, 1.0) ** 2 + 1e-9
    return np.asarray(coefficients[0])


def smooth_track(
    X: ArrayLike, covariance: ArrayLike, weight: ArrayLike, breaks: Iterable[int] = (), *, leave_out: bool = False
) -> Array:
    """Smoothed poses (T, 4, 4) [m].

    Args:
        X: (T, 4, 4) poses X_AH; NaN where there is none, and so in the result.
        covariance: (T, 6, 6) of each: rotation about the axes of A [rad], then position [m].
        weight: (T,) how far each is trusted, 0 for not at all.
        breaks: frames that begin after a jump; nothing is smoothed across them.
        leave_out: give what the neighbours alone say of each frame; NaN where there are fewer than four.
    """
    X, weight = np.asarray(X, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    known = np.isfinite(X).all(axis=(1, 2))
    information = np.full((len(X), 6, 6), np.nan)
    information[known] = np.linalg.inv(np.asarray(covariance)[known] + np.diag(_FLOOR**2))
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
        turn = rotation_log(X[near, :3, :3] @ X[i, :3, :3].T)
        value = _local_value(offset, np.hstack([turn, X[near, :3, 3]]), w, information[near])
        smoothed[i] = make_pose(rotation_exp(value[:3]) @ X[i, :3, :3], value[3:])
    return smoothed
