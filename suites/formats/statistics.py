"""Statistics of a dataset's features, as LeRobot names them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
"""Quantiles by name."""


def of_rows(values: NDArray[Any]) -> dict[str, list[float] | list[int]]:
    """Statistics of each element of the rows (N, d) or of the numbers (N,)."""
    rows = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    moments = {"min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0), "std": rows.std(axis=0)}
    quantiles = {name: np.quantile(rows, share, axis=0) for name, share in QUANTILES.items()}
    return {**{name: found.tolist() for name, found in (moments | quantiles).items()}, "count": [len(rows)]}


def of_histograms(counts: NDArray[Any], frames: int) -> dict[str, Any]:
    """Statistics of pictures in 0..1, each (3, 1, 1), from how often (3, 256) each channel has each of its values.

    Args:
        counts: the histograms.
        frames: pictures that they are of.
    """
    level = np.arange(256) / 255.0
    total = counts.sum(axis=1, keepdims=True)
    mean = (counts * level).sum(axis=1) / total[:, 0]
    seen = counts > 0
    ranks = np.cumsum(counts, axis=1) / total
    moments = {
        "min": level[seen.argmax(axis=1)],
        "max": level[255 - seen[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt((counts * (level - mean[:, None]) ** 2).sum(axis=1) / total[:, 0]),
    }
    quantiles = {name: level[(ranks >= share).argmax(axis=1)] for name, share in QUANTILES.items()}
    found = {name: [[[float(x)]] for x in values] for name, values in (moments | quantiles).items()}
    return {**found, "count": [frames]}


def of_features(
    rows: Sequence[Mapping[str, NDArray[Any]]], histograms: Mapping[str, Sequence[NDArray[Any]]]
) -> dict[str, dict[str, Any]]:
    """Statistics of every feature over some episodes.

    Args:
        rows: columns by name, one mapping an episode.
        histograms: those of each camera's pictures, one an episode.
    """
    frames = sum(len(next(iter(columns.values()))) for columns in rows)
    told = {name: of_rows(np.concatenate([columns[name] for columns in rows])) for name in rows[0]}
    return {
        **told,
        **{name: of_histograms(np.sum(counts, axis=0), frames) for name, counts in histograms.items()},
    }
