"""Segments: runs of consecutive frames."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array


def segments(mask: NDArray[np.bool_]) -> list[slice]:
    """Stretches of consecutive true values of `mask` (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [slice(int(start), int(end)) for start, end in zip(edges[::2], edges[1::2], strict=True)]


def complete(rows: Array) -> NDArray[np.bool_]:
    """Which of `rows` (T, N) are known: without NaN."""
    return np.asarray(np.isfinite(rows).all(axis=-1), dtype=bool)
