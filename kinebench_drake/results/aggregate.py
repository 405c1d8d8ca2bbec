"""Aggregates over samples: means with intervals and coverage."""

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TypeVar

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.direction import BOUND, worst_value
from kinebench_drake.results.row import OUTCOMES, VERDICT_SHARES, SampleRow, Status
from kinebench_drake.stats import bootstrap_mean, group_means, pass_at_k, share_interval

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Mean or share with its 95 % interval and its coverage."""

    mean: float | None
    """Mean of the values, or share of true values; None without values."""
    low: float | None
    """Lower end of the interval; None with a single sample, and where all are equal: that makes no mean certain."""
    high: float | None
    """Upper end of the interval."""
    n: int
    """Number of samples with a value."""
    total: int
    """Number of samples in the group, measurable or not."""
    bound: float | None = None
    """The mean if every lost frame were at its worst and every sample without a value had the worst value of the run;
    None if no value is the worst."""
    upper: float | None = None
    """The share if every open verdict on execution were yes; None of other numbers."""

    def to_json(self) -> dict[str, Json]:
        """Return the object in `results.json`."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Aggregate:
    """Statistics of a group of samples."""

    status: Mapping[Status, int]
    """Number of samples by status."""
    estimates: Mapping[str, Estimate]
    """`executable` over all samples, those without a verdict counted as not executable; `feasible` and every numerical
    or boolean metric over the samples with status ok."""
    violations: Mapping[str, int]
    """Number of samples with a violation, by kind."""
    anomalies: Mapping[str, int]
    """Number of samples with an anomaly, by kind."""
    executable_reasons: Mapping[str, int]
    """Number of samples by what is against executing them."""

    @property
    def total(self) -> int:
        """Number of samples in the group."""
        return sum(self.status.values())

    def to_json(self) -> dict[str, Json]:
        """Return the object in `results.json`."""
        return {
            "samples": {"total": self.total, **{s.value: self.status[s] for s in Status}},
            **{name: self.estimates[name].to_json() for name in VERDICT_SHARES},
            "metrics": {name: e.to_json() for name, e in self.estimates.items() if name not in VERDICT_SHARES},
            "violations": dict(self.violations),
            "anomalies": dict(self.anomalies),
            "executable_reasons": dict(self.executable_reasons),
        }


def worst_values(rows: Sequence[SampleRow]) -> dict[str, float | None]:
    """Return the worst value of each verdict and metric among all rows of a run; None where no value is the worst.

    Of values that are true or false it is false, 0.
    """
    worst: dict[str, float | None] = {}
    for name, column in _columns(rows).items():
        both = _to_array([*column.values, *column.bounds])
        numbers = both[np.isfinite(both)].tolist()
        worst[name] = 0.0 if numbers and _is_share(column.values) else worst_value(name, numbers)
    return worst


def aggregate(rows: Sequence[SampleRow], seed: int = 0, worst: Mapping[str, float | None] | None = None) -> Aggregate:
    """Compute the statistics of a group of rows; the same rows and seed give the same numbers.

    Args:
        worst: worst values of the run, which bound the means; None if the group is the whole run.
    """
    worst = worst_values(rows) if worst is None else worst
    counts = Counter(r.status for r in rows)
    judged = worst.get("executable") is not None
    estimates = {
        name: estimate(
            column.values,
            total=len(rows),
            seed=seed,
            worst=worst.get(name),
            episodes=column.episodes,
            bounds=column.bounds,
        )
        for name, column in _columns(rows).items()
    }
    if judged:
        estimates["executable"] = estimate_executable(rows, seed)
    passes = {f"pass_at_{k}": share for k, share in estimate_passes(rows, seed).items()}
    return Aggregate(
        status={status: counts[status] for status in Status},
        estimates={**estimates, **passes},
        violations=_count_kinds({v.kind.value for v in row.violations} for row in rows),
        anomalies=_count_kinds({a.kind.value for a in row.anomalies} for row in rows),
        executable_reasons=_count_kinds(
            {reason.partition(":")[0] for reason in row.executable_reasons} for row in rows
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunStatistics:
    """Statistics of a run, whatever the order of its rows."""

    total: Aggregate
    """All samples."""
    groups: Mapping[str, Mapping[str, Aggregate]]
    """Samples of each task under "task", of each model under "model"."""

    @classmethod
    def of(cls, rows: Iterable[SampleRow], seed: int = 0) -> "RunStatistics":
        """Compute the statistics; `seed` is that of the bootstrap intervals."""
        ordered = sorted(rows, key=lambda row: row.id)
        worst = worst_values(ordered)
        return cls(
            total=aggregate(ordered, seed, worst),
            groups={
                key: {name: aggregate(group, seed, worst) for name, group in split_rows(ordered, key).items()}
                for key in ("task", "model")
            },
        )


@dataclass(frozen=True, slots=True)
class _MetricValues:
    """Values of a verdict or metric over the rows of a group."""

    values: list[float | None] = field(default_factory=list)
    bounds: list[float | None] = field(default_factory=list)
    """The worst that each can be."""
    episodes: list[Hashable] = field(default_factory=list)

    def add(self, value: float | None, bound: float | None, episode: str) -> None:
        self.values.append(value)
        self.bounds.append(bound)
        self.episodes.append(episode)


def _columns(rows: Sequence[SampleRow]) -> dict[str, _MetricValues]:
    """Return the values of verdicts and metrics by name; a null verdict on execution is no if any row has one."""
    columns: dict[str, _MetricValues] = {name: _MetricValues() for name in VERDICT_SHARES}
    for row in rows if any(row.executable is not None for row in rows) else ():
        columns["executable"].add(row.executable is True, row.executable is True, row.episode)
    for row in (r for r in rows if r.status is Status.OK):
        columns["feasible"].add(row.feasible, row.feasible, row.episode)
        outcomes = {name: row.value(name) for name in OUTCOMES if row.has(name)}
        for name, value in {**row.metrics.numbers, **outcomes}.items():
            if not name.endswith(BOUND):
                columns.setdefault(name, _MetricValues()).add(value, row.bound(name), row.episode)
    return columns


def estimate_executable(rows: Sequence[SampleRow], seed: int = 0) -> Estimate:
    """Estimate the share of executable samples among all: open verdicts are no, and yes in `upper`."""
    episodes = [row.episode for row in rows]
    total = len(rows)
    lower = estimate([row.executable is True for row in rows], total=total, seed=seed, episodes=episodes)
    upper = estimate([row.executable is not False for row in rows], total=total, episodes=episodes)
    return replace(lower, upper=upper.mean)


def estimate_passes(rows: Sequence[SampleRow], seed: int = 0) -> dict[int, Estimate]:
    """Estimate pass@k, the probability that one of k samples of an episode succeeds, for k = 1, 2, 4, ... and all.

    Means over the episodes with k measured samples (`stats.pass_at_k`) with intervals over episodes. In the bound
    samples that were not measured are failures. Empty if every episode has one sample.
    """
    groups = group_by(rows, lambda row: row.episode)
    episodes = {name: [row.success if row.status is Status.OK else None for row in own] for name, own in groups.items()}
    most = max(map(len, episodes.values()), default=0)
    if most < 2:
        return {}
    hits = {episode: sum(outcome is True for outcome in own) for episode, own in episodes.items()}
    measured = {episode: sum(isinstance(outcome, bool) for outcome in own) for episode, own in episodes.items()}
    passes = {}
    for k in sorted({2**i for i in range(most.bit_length()) if 2**i <= most} | {most}):
        shares = np.array([pass_at_k(hits[e], n, k) for e, n in measured.items() if n >= k])
        all_shares = [pass_at_k(hits[e], len(own), k) for e, own in episodes.items() if len(own) >= k]
        low, high = share_interval(shares, np.random.default_rng(seed))
        passes[k] = Estimate(
            mean=float(shares.mean()) if len(shares) else None,
            low=low if len(shares) else None,
            high=high if len(shares) else None,
            n=len(shares),
            total=len(episodes),
            bound=math.fsum(all_shares) / len(all_shares),
        )
    return passes


def split_rows(rows: Iterable[SampleRow], key: str) -> dict[str, list[SampleRow]]:
    """Group rows by their `task` or `model`, sorted; rows without one are left out."""
    groups = group_by((row for row in rows if getattr(row, key) is not None), lambda row: str(getattr(row, key)))
    return dict(sorted(groups.items()))


def estimate(
    values: Sequence[float | None],
    *,
    total: int,
    seed: int = 0,
    worst: float | None = None,
    episodes: Sequence[Hashable] | None = None,
    bounds: Sequence[float | None] | None = None,
) -> Estimate:
    """Compute mean, interval and bound of `values`, ignoring None.

    Booleans give a share with Wilson's score interval (Wilson 1927); numbers give a mean with the percentile bootstrap
    interval (Efron 1979). A single number has no interval. In the bound each missing value is `worst`; of booleans
    false. If an episode has several samples, each episode counts the same, with the mean of its values, and intervals
    are those over episodes (`share_interval`).

    Args:
        total: number of samples in the group, measurable or not.
        episodes: episode of each sample; None: each its own.
        bounds: the worst that each value can be; None: the values.
    """
    column = _to_array(values)
    finite = np.isfinite(column)
    numbers = column[finite].tolist()
    n = len(numbers)
    if not n:
        return Estimate(mean=None, low=None, high=None, n=0, total=total, bound=worst)
    units = numbers
    if episodes is not None and len(set(episodes)) < len(episodes):
        measured = [episode for episode, is_finite in zip(episodes, finite.tolist(), strict=True) if is_finite]
        units = group_means(numbers, measured).tolist()
    mean = math.fsum(units) / len(units)
    low: float | None = None
    high: float | None = None
    if _is_share(values):
        worst = 0.0
        low, high = share_interval(np.array(units), np.random.default_rng(seed))
    elif len(units) > 1 and min(units) < max(units):  # equal values do not mean a certain mean
        low, high = bootstrap_mean(np.array(units), np.random.default_rng(seed))
    least = column if bounds is None else _to_array(bounds)
    least = least[np.isfinite(least)].tolist()
    missing = total - len(least)
    bound = None if missing and worst is None else (math.fsum(least) + missing * (worst or 0.0)) / total
    bound = mean if least == numbers and not missing else bound
    return Estimate(mean=mean, low=low, high=high, n=n, total=total, bound=bound)


def _is_share(values: Sequence[float | None]) -> bool:
    """Return whether all values that there are are true or false."""
    return all(isinstance(v, bool) for v in values if v is not None)


def _to_array(values: Sequence[float | None]) -> Array:
    """Return numbers and truth values (N,) as numbers; NaN where there is none."""
    return np.array(values, dtype=np.float64)  # None becomes NaN


def _count_kinds(samples: Iterable[set[str]]) -> dict[str, int]:
    return dict(sorted(Counter(kind for kinds in samples for kind in kinds).items()))


def group_by(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Group items, such as rows, by a key, in the order of the keys' first occurrence."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups
