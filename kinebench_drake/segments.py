"""Segments of consecutive frames."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array

UNEVEN = 0.02
"""Least deviation from even spacing that counts [frame periods]."""


def segments(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the runs of consecutive true values of `mask` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(start), int(end)) for start, end in zip(edges[::2], edges[1::2], strict=True)]


def finite_rows(rows: Array) -> NDArray[np.bool_]:
    """Return (T,): True where a row of `rows` (T, N) is finite."""
    return np.asarray(np.isfinite(rows).all(axis=-1), dtype=bool)


def spread(values: Array, frames: NDArray[np.bool_] | NDArray[np.intp], count: int) -> Array:
    """Return an array (count, ...) that holds `values` (N, ...) at `frames`, a mask or N indices, and NaN elsewhere."""
    out = np.full((count, *np.shape(values)[1:]), np.nan)
    out[frames] = values
    return out


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return at most `most` of the indices 0 to `count` - 1, evenly spread, the first and the last one included."""
    return np.unique(np.linspace(0, count - 1, most).round().astype(np.intp))


DIFFERENT_VALUES = 10
"""Least number of different values with few decimals that show that all were rounded."""
_HALF_EXACT = 0.125
"""Values from which the unit of half precision is coarse against five decimals."""
_MOST_HALF = 6e4
"""Numbers up to which there is half precision."""


@np.errstate(over="ignore", invalid="ignore")
def rounding_unit(values: Array) -> Array:
    """Return the unit (N,) of the last digit of the columns of finite numbers (T, N); 0 where they were not rounded.

    Numbers are rounded to two to six decimals, all columns alike, or to half precision, whose unit grows with them.
    """
    half = np.minimum(np.abs(values), _MOST_HALF).astype(np.float16)
    units = np.spacing(half).astype(np.float64)
    large = np.abs(values) >= _HALF_EXACT
    off = np.abs(np.abs(values) - half)[large]
    if len(np.unique(half[large])) >= DIFFERENT_VALUES and (off < 0.05 * units[large]).all():
        return np.asarray(units.max(axis=0))
    for decimals in range(2, 7):
        unit = 10.0**-decimals
        rounded = values.round(decimals)
        if len(np.unique(rounded)) >= DIFFERENT_VALUES and np.abs(values - rounded).max() < 0.05 * unit:
            return np.full(values.shape[1], unit)
    return np.zeros(values.shape[1])


def frame_periods(t_s: Array) -> Array:
    """Return times (T,) [s] in frame periods since the first: frame numbers, unless frames are unevenly spaced."""
    numbers = np.arange(len(t_s), dtype=np.float64)
    if len(t_s) < 2:
        return numbers
    periods = (t_s - t_s[0]) / np.median(np.diff(t_s))
    return numbers if np.abs(periods - numbers).max() < UNEVEN else np.asarray(periods)
