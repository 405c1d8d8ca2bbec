"""Statistics of the features of a LeRobot dataset."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""Quantiles by name."""


def row_statistics(values: NDArray[Any]) -> dict[str, list[float] | list[int]]:
    """Return statistics of each element of the rows (N, d) or of the numbers (N,)."""
    rows = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    moments = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    quantiles = {name: np.quantile(rows, share, axis=0) for name, share in QUANTILES.items()}
    return {**{name: value.tolist() for name, value in (moments | quantiles).items()}, "count": [len(rows)]}


def histogram_statistics(counts: NDArray[Any], frames: int) -> dict[str, Any]:
    """Return statistics of `frames` images in 0..1, each (3, 1, 1), from the histograms (3, 256) of their channels."""
    level = np.arange(256) / 255.0
    total = counts.sum(axis=1, keepdims=True)
    mean = (counts * level).sum(axis=1) / total[:, 0]
    present = counts > 0
    ranks = np.cumsum(counts, axis=1) / total
    moments = {
        "min": level[present.argmax(axis=1)],
        "max": level[255 - present[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt((counts * (level - mean[:, None]) ** 2).sum(axis=1) / total[:, 0]),
    }
    quantiles = {name: level[(ranks >= share).argmax(axis=1)] for name, share in QUANTILES.items()}
    statistics = {name: [[[float(x)]] for x in values] for name, values in (moments | quantiles).items()}
    return {**statistics, "count": [frames]}


def feature_statistics(
    rows: Sequence[Mapping[str, NDArray[Any]]], histograms: Mapping[str, Sequence[NDArray[Any]]]
) -> dict[str, dict[str, Any]]:
    """Return statistics of every feature over episodes: of the columns of each, and of the histograms of its images."""
    frames = sum(len(next(iter(columns.values()))) for columns in rows)
    return {
        **{name: row_statistics(np.concatenate([columns[name] for columns in rows])) for name in rows[0]},
        **{name: histogram_statistics(np.sum(counts, axis=0), frames) for name, counts in histograms.items()},
    }
