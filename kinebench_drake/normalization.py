"""Metrics put on the scale that the samples of their own run span, as papers compare manipulability costs."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.aggregate import by_key
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.row import Json, SampleRow, Status

NORMALIZED = ("manipulability_cost_mean",)
"""Metrics that results give on that scale, too."""
PERCENTILES = (10.0, 90.0)
"""Ends of the scale: values of these percentiles count as 0 and 1."""


def robust_normalize(values: ArrayLike, low: float = PERCENTILES[0], high: float = PERCENTILES[1]) -> Array:
    """Values (N,) of a run's samples on the scale 0 (at the `low`-th percentile or below) to 1 (`high`-th or above).

    clip((v - p_low) / (p_high - p_low), 0, 1) over the finite values, percentiles by linear interpolation; NaN stays
    NaN. Where both percentiles are the same number there is no scale: what is below it becomes 0, what is above it 1,
    the number itself 0.5. The result compares samples of one run with each other, never with another run's.

    Raises:
        UsageError: the percentiles are not 0 <= low < high <= 100.
    """
    if not 0.0 <= low < high <= 100.0:
        raise UsageError(f"percentiles are {low:g} and {high:g}, expected 0 <= low < high <= 100")
    values = np.asarray(values, dtype=np.float64)
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return np.full(values.shape, np.nan)
    bottom, top = np.percentile(finite, [low, high])
    if top > bottom:
        scaled = np.clip((values - bottom) / (top - bottom), 0.0, 1.0)
    else:
        scaled = 0.5 + 0.5 * np.sign(values - bottom)
    return np.asarray(np.where(np.isnan(values), np.nan, scaled))


def normalize_run(rows: Sequence[SampleRow]) -> dict[str, Json]:
    """Ends of the scale of each metric of NORMALIZED, and the mean on it of all samples, of each task and each model.

    Metrics that fewer than two samples have are left out: they span no scale.
    """
    found: dict[str, Json] = {}
    for name in NORMALIZED:
        known = [row for row in rows if row.status is Status.OK and isinstance(row.metrics.get(name), int | float)]
        values = np.array([row.metrics[name] for row in known], dtype=np.float64)
        if len(values) < 2:
            continue
        scaled = dict(zip((row.id for row in known), robust_normalize(values).tolist(), strict=True))
        low, high = np.percentile(values, PERCENTILES)
        found[name] = {
            "low": float(low),
            "high": float(high),
            "n": len(known),
            "mean": float(np.mean(list(scaled.values()))),
            **{
                f"per_{key}": {
                    group: float(np.mean([scaled[row.id] for row in members]))
                    for group, members in by_key(known, key).items()
                }
                for key in ("task", "model")
            },
        }
    return found
