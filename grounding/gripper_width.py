"""The opening of the fingers along a video, also where the view hides them."""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array
from kinebench_drake.models.panda.cad import MAX_FINGER_M

SHARP_M = 0.004
"""A gap with a smaller standard deviation than this is seen; beyond it fingers hide each other and labels err alike."""
_BLUNT_FACTOR = 2.5  # by which the error of a gap that is not seen well exceeds its standard deviation
_BLIND_M = 0.010  # standard deviation of a reading that says nothing any more
_FLOOR_M = 0.001  # no reading is better
_WILD = 0.02  # share of readings that are anything
_UNKNOWN_M = 0.015  # a gap known no better than this is not known
_STEP_M = 0.002
_SPEEDS = np.array([0, *(s * k for k in (1, 2, 3, 4, 6, 10, 15, 25, 40) for s in (-1, 1))])
"""Steps a frame, in which the gap may change; the first is rest."""
_REST, _GO_ON = 0.96, 0.6  # chances that fingers that rest, or move, do so in the next frame, too
_BLUR = (0.1, 0.8, 0.1)  # of a step


def smooth_gripper_width(width_m: ArrayLike, sigma_m: ArrayLike) -> Array:
    """Gaps (T,) between the finger pads [m], NaN where neither the frame nor its neighbours tell.

    Fingers rest, or move on at the speed they have: a hidden Markov model over gaps and speeds, whose posterior comes
    from the forward-backward algorithm (Rabiner, Proceedings of the IEEE 77, 1989, section III). Its median is told.

    Args:
        width_m: (T,) gap as measured [m]; NaN where it is not.
        sigma_m: (T,) standard deviation of each [m]; 0 of those that are known.
    """
    width_m, sigma_m = np.asarray(width_m, dtype=np.float64), np.asarray(sigma_m, dtype=np.float64)
    if not np.isfinite(width_m).any():
        return np.full(len(width_m), np.nan)
    gaps, first, transition = _model()
    seen = _likelihoods(width_m, sigma_m, gaps)
    forward = [_scaled(first * seen[0])]
    for likelihood in seen[1:]:
        forward.append(_scaled((forward[-1] @ transition) * likelihood))
    backward = [np.ones(seen.shape[1])]
    for likelihood in seen[:0:-1]:
        backward.append(_scaled(transition @ (backward[-1] * likelihood)))
    posterior = (np.array(forward) * np.array(backward[::-1])).reshape(len(width_m), -1, len(_SPEEDS)).sum(axis=2)
    posterior /= posterior.sum(axis=1, keepdims=True)
    grid = np.unique(gaps)
    spread = np.sqrt(np.maximum(posterior @ grid**2 - (posterior @ grid) ** 2, 0.0))
    median = [_median(grid, chances) for chances in posterior]
    return np.where(sigma_m == 0.0, width_m, np.where(spread <= _UNKNOWN_M, median, np.nan))


def _median(grid: Array, chances: Array) -> float:
    """Of a distribution that is even within each step of the grid; unlike the mean it is not between two peaks."""
    edges = np.append(grid - _STEP_M / 2, grid[-1] + _STEP_M / 2)
    middle = np.interp(0.5, np.append(0.0, np.cumsum(chances)), edges)
    return float(np.clip(middle, grid[0], grid[-1]))


def _likelihoods(width_m: Array, sigma_m: Array, gaps: Array) -> Array:
    """(T, S) of the readings (T,) in the states."""
    sigma_m = np.where(sigma_m <= SHARP_M, np.maximum(sigma_m, _FLOOR_M), _BLUNT_FACTOR * sigma_m)
    told = np.isfinite(width_m) & (sigma_m <= _BLUNT_FACTOR * _BLIND_M)
    width_m, sigma_m = np.where(told, width_m, 0.0)[:, None], np.where(told, sigma_m, 1.0)[:, None]
    fits = np.exp(-0.5 * ((gaps - width_m) / sigma_m) ** 2) / sigma_m
    return np.where(told[:, None], (1.0 - _WILD) * fits + _WILD / (2 * MAX_FINGER_M), 1.0)


def _scaled(chances: Array) -> Array:
    return np.asarray(chances / chances.sum())


@lru_cache(maxsize=1)
def _model() -> tuple[Array, Array, Array]:
    """Gap (S,) [m] of each state, its chance (S,) at first, and the chances (S, S) of what a frame leads to."""
    n, k = round(2 * MAX_FINGER_M / _STEP_M) + 1, len(_SPEEDS)
    change = np.full((k, k), (1.0 - _GO_ON) / (2 * (k - 1)))  # fingers that move stop as often as they change speed
    change[:, 0] += (1.0 - _GO_ON) / 2
    change[np.arange(k), np.arange(k)] = _GO_ON
    change[0] = (1.0 - _REST) / (k - 1)
    change[0, 0] = _REST
    change /= change.sum(axis=1, keepdims=True)
    transition = np.zeros((n, k, n, k))
    for speed, steps in enumerate(_SPEEDS):
        for gap in range(n):
            for blur, share in zip((-1, 0, 1), _BLUR, strict=True):
                end = min(max(gap + steps + blur, 0), n - 1)
                transition[gap, :, end, speed] += share * change[:, speed]
    gaps = np.repeat(_STEP_M * np.arange(n), k)
    return gaps, np.tile(change[0] / n, n), transition.reshape(n * k, n * k)
