"""Aggregates over many samples: means with intervals, coverage, and run-wise normalization."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.stats import bootstrap_mean, wilson
from kinebench_drake.types import Json

_EXTRA = ("success", "progress", "rounds")


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A mean or a share with its 95 % interval and its coverage."""

    mean: float | None
    """Mean of the values, or share of true ones; None without a value."""
    low: float | None
    """Lower end of the interval; None where the samples are too few to say."""
    high: float | None
    """Upper end of the interval."""
    n: int
    """Samples with a value."""
    total: int
    """Samples in the group, measurable or not."""

    def to_json(self) -> dict[str, Json]:
        """The object that `results.json` holds."""
        return {"mean": self.mean, "low": self.low, "high": self.high, "n": self.n, "total": self.total}


@dataclass(frozen=True, slots=True, kw_only=True)
class Aggregate:
    """A group of samples in numbers."""

    status: Mapping[Status, int]
    """Samples of each status."""
    estimates: Mapping[str, Estimate]
    """`feasible` and every metric that is a number or a truth value, over the samples that are ok."""
    violations: Mapping[str, int]
    """Samples that show a violation, for each kind."""
    anomalies: Mapping[str, int]
    """Samples that show an anomaly, for each kind."""

    @property
    def total(self) -> int:
        """Samples in the group."""
        return sum(self.status.values())

    def to_json(self) -> dict[str, Json]:
        """The object that `results.json` holds."""
        return {
            "samples": {"total": self.total, **{s.value: self.status[s] for s in Status}},
            **{name: estimate.to_json() for name, estimate in self.estimates.items() if name == "feasible"},
            "metrics": {name: e.to_json() for name, e in self.estimates.items() if name != "feasible"},
            "violations": dict(self.violations),
            "anomalies": dict(self.anomalies),
        }


def aggregate(rows: Sequence[SampleRow], seed: int = 0) -> Aggregate:
    """Put a group of rows into numbers. The same rows and seed give the same numbers."""
    columns: dict[str, list[Json]] = {"feasible": []}
    for row in (r for r in rows if r.status is Status.OK):
        columns["feasible"].append(row.feasible)
        extra = {name: row.extra[name] for name in _EXTRA if name in row.extra}
        for name, value in {**row.metrics, **extra}.items():
            if value is None or isinstance(value, bool | int | float):
                columns.setdefault(name, []).append(value)
    counts = Counter(r.status for r in rows)
    return Aggregate(
        status={status: counts[status] for status in Status},
        estimates={name: estimate(values, total=len(rows), seed=seed) for name, values in columns.items()},
        violations=_share({str(v.get("kind")) for v in row.violations} for row in rows),
        anomalies=_share(_anomaly_kinds(row) for row in rows),
    )


def by_key(rows: Iterable[SampleRow], key: str) -> dict[str, list[SampleRow]]:
    """Rows grouped by their `task` or `model`, sorted; rows without one are left out."""
    groups: dict[str, list[SampleRow]] = {}
    for row in rows:
        name = getattr(row, key)
        if name is not None:
            groups.setdefault(name, []).append(row)
    return dict(sorted(groups.items()))


def estimate(values: Sequence[Json], *, total: int, seed: int = 0) -> Estimate:
    """Mean and interval of `values`, of which None does not count.

    Truth values give a share with Wilson's score interval (Wilson 1927); numbers give a mean with the percentile
    bootstrap interval (Efron 1979). A single number has no interval.
    """
    known = [float(v) for v in values if isinstance(v, bool | int | float) and math.isfinite(v)]
    n = len(known)
    if not n:
        return Estimate(mean=None, low=None, high=None, n=0, total=total)
    mean = math.fsum(known) / n
    low: float | None = None
    high: float | None = None
    if all(isinstance(v, bool) for v in values if v is not None):
        low, high = wilson(round(sum(known)), n)
    elif n > 1 and min(known) == max(known):
        low = high = mean
    elif n > 1:
        low, high = bootstrap_mean(np.array(known), np.random.default_rng(seed))
    return Estimate(mean=mean, low=low, high=high, n=n, total=total)


def _share(kinds: Iterable[set[str]]) -> dict[str, int]:
    return dict(sorted(Counter(kind for found in kinds for kind in found).items()))


def _anomaly_kinds(row: SampleRow) -> set[str]:
    found = row.metrics.get("anomalies")
    if isinstance(found, str) or not isinstance(found, Sequence):
        return set()
    return {str(a.get("kind")) for a in found if isinstance(a, Mapping)}


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
