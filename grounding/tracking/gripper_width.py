"""Smoothing of the gripper width over a video, including frames in which the fingers are hidden."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.cad import MAX_FINGER_M

SHARP_M = 0.004
"""Widths with a smaller standard deviation are trusted as measured; larger ones have correlated errors, since fingers
that hide each other are mislabelled together."""
_BLUNT_FACTOR = 2.5  # factor by which the error of a width that is not sharp exceeds its standard deviation
_BLIND_M = 0.010  # standard deviation from which a measurement is ignored
_FLOOR_M = 0.001  # least standard deviation of a measurement
_OUTLIER_SHARE = 0.02
_UNKNOWN_M = 0.015  # posterior standard deviation above which the width is unknown
_STEP_M = 0.002
_SPEEDS = np.array([0, *(s * k for k in (1, 2, 3, 4, 6, 10, 15, 25, 40) for s in (-1, 1))])
"""Changes of the width per frame in grid steps; the first is rest."""
_REST, _GO_ON = 0.96, 0.6  # probabilities that resting, or moving, fingers continue so in the next frame
_BLUR = (0.1, 0.8, 0.1)  # probabilities of one step less, none, one more than the speed


def smooth_gripper_width(width_m: ArrayLike, sigma_m: ArrayLike) -> Array:
    """Return the gripper width (T,) [m], NaN where neither the frame nor its neighbours determine it.

    Fingers rest or keep their speed: a hidden Markov model over widths and speeds, whose posterior is computed by the
    forward-backward algorithm (Rabiner, Proceedings of the IEEE 77, 1989, section III). The result is its median.

    Args:
        width_m: (T,) measured widths [m]; NaN where there is none.
        sigma_m: (T,) standard deviations [m]; 0 of widths taken from priors.
    """
    width_m, sigma_m = np.asarray(width_m, dtype=np.float64), np.asarray(sigma_m, dtype=np.float64)
    if not np.isfinite(width_m).any():
        return np.full(len(width_m), np.nan)
    widths, initial, transition = _model()
    likelihoods = _likelihoods(width_m, sigma_m, widths)
    forward = [_normalized(initial * likelihoods[0])]
    for likelihood in likelihoods[1:]:
        forward.append(_normalized((forward[-1] @ transition) * likelihood))
    backward = [np.ones(likelihoods.shape[1])]
    for likelihood in likelihoods[:0:-1]:
        backward.append(_normalized(transition @ (backward[-1] * likelihood)))
    posterior = (np.array(forward) * np.array(backward[::-1])).reshape(len(width_m), -1, len(_SPEEDS)).sum(axis=2)
    posterior /= posterior.sum(axis=1, keepdims=True)
    grid = np.unique(widths)
    spread = np.sqrt(np.maximum(posterior @ grid**2 - (posterior @ grid) ** 2, 0.0))
    median = [_median(grid, probabilities) for probabilities in posterior]
    return np.where(sigma_m == 0.0, width_m, np.where(spread <= _UNKNOWN_M, median, np.nan))


def _median(grid: Array, probabilities: Array) -> float:
    """Return the median of a density that is uniform within each grid step; a mean could lie between two modes."""
    edges = np.append(grid - _STEP_M / 2, grid[-1] + _STEP_M / 2)
    middle = np.interp(0.5, np.append(0.0, np.cumsum(probabilities)), edges)
    return float(np.clip(middle, grid[0], grid[-1]))


def _likelihoods(width_m: Array, sigma_m: Array, widths: Array) -> Array:
    """Return the likelihoods (T, S) of the states, whose widths are `widths` (S,), given the measurements (T,)."""
    sigma_m = np.where(sigma_m <= SHARP_M, np.maximum(sigma_m, _FLOOR_M), _BLUNT_FACTOR * sigma_m)
    usable = np.isfinite(width_m) & (sigma_m <= _BLUNT_FACTOR * _BLIND_M)
    width_m, sigma_m = np.where(usable, width_m, 0.0)[:, None], np.where(usable, sigma_m, 1.0)[:, None]
    fits = np.exp(-0.5 * ((widths - width_m) / sigma_m) ** 2) / sigma_m
    return np.where(usable[:, None], (1.0 - _OUTLIER_SHARE) * fits + _OUTLIER_SHARE / (2 * MAX_FINGER_M), 1.0)


def _normalized(probabilities: Array) -> Array:
    return np.asarray(probabilities / probabilities.sum())


@lru_cache(maxsize=1)
def _model() -> tuple[Array, Array, Array]:
    """Return the width (S,) [m] and initial probability (S,) of each state, and the transition matrix (S, S)."""
    n, k = round(2 * MAX_FINGER_M / _STEP_M) + 1, len(_SPEEDS)
    change = np.full((k, k), (1.0 - _GO_ON) / (2 * (k - 1)))  # moving fingers stop as often as they change speed
    change[:, 0] += (1.0 - _GO_ON) / 2
    change[np.arange(k), np.arange(k)] = _GO_ON
    change[0] = (1.0 - _REST) / (k - 1)
    change[0, 0] = _REST
    change /= change.sum(axis=1, keepdims=True)
    transition = np.zeros((n, k, n, k))
    for speed, steps in enumerate(_SPEEDS):
        for width in range(n):
            for blur, share in zip((-1, 0, 1), _BLUR, strict=True):
                end = min(max(width + steps + blur, 0), n - 1)
                transition[width, :, end, speed] += share * change[:, speed]
    widths = np.repeat(_STEP_M * np.arange(n), k)
    return widths, np.tile(change[0] / n, n), transition.reshape(n * k, n * k)
