"""The opening of the fingers along a video, also where the view hides them."""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.cad import MAX_FINGER_M

SHARP_M = 0.004
"""A gap with a smaller standard deviation than this is seen; beyond it fingers hide each other and labels err alike."""
_BLUNT_FACTOR = 3.0  # by which the error of a gap that is not seen well exceeds its standard deviation
_CHANGE_M = 0.010  # standard deviation by which a gap changes from frame to frame
_UNKNOWN_M = 0.015  # a gap known no better than this is not known


def smooth_opening(width_m: ArrayLike, sigma_m: ArrayLike) -> Array:
    """Gaps (T,) between the finger pads [m], NaN where neither the frame nor its neighbours tell.

    A random walk observed with noise, solved forward and backward at once: the smoother of Rauch, Tung and Striebel
    (1965) in information form.

    Args:
        width_m: (T,) gap as measured [m]; NaN where it is not.
        sigma_m: (T,) standard deviation of each [m].
    """
    width_m, sigma_m = np.asarray(width_m, dtype=np.float64), np.asarray(sigma_m, dtype=np.float64)
    seen = np.isfinite(width_m) & np.isfinite(sigma_m)
    sigma_m = np.where(sigma_m <= SHARP_M, np.maximum(sigma_m, 1e-4), _BLUNT_FACTOR * sigma_m)
    observed = np.where(seen, 1.0 / np.where(seen, sigma_m, 1.0) ** 2, 0.0)
    if not seen.any():
        return np.full(len(width_m), np.nan)
    walk = np.diff(np.eye(len(width_m)), axis=0) / _CHANGE_M
    covariance = np.linalg.inv(np.diag(observed) + walk.T @ walk)
    gap = covariance @ (observed * np.where(seen, width_m, 0.0))
    return np.where(np.sqrt(np.diag(covariance)) <= _UNKNOWN_M, np.clip(gap, 0.0, 2 * MAX_FINGER_M), np.nan)
