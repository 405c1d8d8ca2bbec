"""Small operations on series over frames that the detectors share."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import grey_opening

from kinebench_drake.geometry import Array
from kinebench_drake.runs import runs as slices


def runs(flags: ArrayLike) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true values."""
    yield from ((run.start, run.stop - 1) for run in slices(np.asarray(flags, dtype=bool)))


def held(values: ArrayLike, frames: int) -> Array:
    """(T,) at each frame the largest value that some `frames` frames in a row around it all reach; unknown ones are 0.

    A grey opening (Serra 1982): peaks shorter than that are levelled, longer ones stay.
    """
    values = np.nan_to_num(np.asarray(values, dtype=np.float64), nan=0.0)
    if len(values) < frames:
        return np.zeros(len(values))
    padded = np.pad(values, frames)
    return np.asarray(grey_opening(padded, size=frames)[frames:-frames])


def known_median(values: ArrayLike, window: int) -> Array:
    """(T,) running median of what is known in `window` frames around each; NaN where less than half of them is."""
    values = np.asarray(values, dtype=np.float64)
    half = window // 2
    smoothed = np.full(len(values), np.nan)
    for i in range(len(values)):
        near = values[max(0, i - half) : i + half + 1]
        near = near[np.isfinite(near)]
        if len(near) > half:
            smoothed[i] = np.median(near)
    return smoothed


def known(values: ArrayLike) -> NDArray[np.bool_]:
    """(T,) whether all of a frame's values (T,) or (T, n) are there."""
    finite = np.isfinite(np.asarray(values, dtype=np.float64))
    return np.asarray(finite if finite.ndim == 1 else finite.all(axis=1))
