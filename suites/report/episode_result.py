"""One episode of a suite run as a row of reports, and means over episodes in which every task counts the same."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinebench_drake.io.jsonl import dump
from kinebench_drake.report.table import Table, Value, make_listing
from kinebench_drake.results.aggregate import Estimate, group_by
from kinebench_drake.results.direction import worst_value
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.stats import group_means, percentile_interval, resampled_means

COST = "manipulability_cost_mean"
"""Metric that is scaled over all episodes of a report."""


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class SuitePart:
    """Suite, split and scene variant of a run; episodes of different parts are never pooled."""

    suite: int
    """Number of the suite."""
    split: str
    """Name of its split."""
    variant: str = "plain"
    """Variant of the scenes."""

    @property
    def title(self) -> str:
        """Name on pages, such as "Suite 2 (unseen)"; the split "test" and the variant "plain" are omitted."""
        return f"Suite {self.suite}" + (f" ({', '.join(self._unusual)})" if self._unusual else "")

    @property
    def slug(self) -> str:
        """Name in file names, such as "suite2_unseen"."""
        return "_".join([f"suite{self.suite}", *self._unusual])

    @property
    def _unusual(self) -> list[str]:
        return [name for name, usual in ((self.split, "test"), (self.variant, "plain")) if name != usual]


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """One episode of one model."""

    part: SuitePart
    model: str
    """Label of the model: its name, and what distinguishes this run from its other runs."""
    folder: Path
    """Output folder of the run."""
    row: SampleRow
    """Row of samples.jsonl."""
    cost_scaled: float | None = None
    """`manipulability_cost_mean` scaled over all episodes of the report, 0..1; see `scale_costs`."""

    @property
    def task(self) -> str:
        """Plain task id."""
        return self.row.task or "unnamed"

    @property
    def key(self) -> tuple[SuitePart, str, str]:
        """Identity of the episode across models: part, task, and seed, pool and variant as JSON."""
        row = self.row
        return self.part, self.task, dump([row.seed, row.pool, row.variant])

    @property
    def success(self) -> bool | None:
        """True if the goal was reached; None if not measured, which is neither success nor failure."""
        return self.row.success if self.row.status is Status.OK else None

    @property
    def outcome(self) -> str:
        """The word "success", "failure", "unmeasurable", "error" or "undecided"."""
        if self.success is not None:
            return "success" if self.success else "failure"
        return "undecided" if self.row.status is Status.OK else str(self.row.status.value)

    @property
    def hit(self) -> float | None:
        """Success as 0 or 1."""
        return None if self.success is None else float(self.success)

    @property
    def progress(self) -> float | None:
        """Share of the task's steps completed, 0..1; None if not measured."""
        return self.metric("progress")

    @property
    def rounds(self) -> float | None:
        """Clips requested from the model; None if not measured."""
        return self.metric("rounds")

    @property
    def verdict(self) -> str | None:
        """Cause of a failure; None for a success or an unexplained failure."""
        return self.row.verdict if self.success is False else None

    def metric(self, name: str) -> float | None:
        """Return an outcome or a metric, a truth value as 0 or 1; None if not measurable."""
        return self.row.number(name)


def group_by_run(episodes: Iterable[EpisodeResult]) -> list[tuple[SuitePart, str, list[EpisodeResult]]]:
    """Group episodes by part, sorted, and model, in the order of the episodes."""
    groups = group_by(episodes, lambda e: (e.part, e.model)).items()
    return [(part, model, own) for (part, model), own in sorted(groups, key=lambda item: item[0][0])]


def list_models(episodes: Iterable[EpisodeResult]) -> list[str]:
    """List the labels of the models, in the order of the episodes."""
    return list(group_by(episodes, lambda e: e.model))


def balanced_mean(
    groups: Mapping[str, Sequence[float | None]], *, seed: int = 0, worst: float | None = None
) -> Estimate:
    """Compute the mean over tasks of the mean over each task's episodes, with a percentile bootstrap interval.

    m = 1/T sum_t 1/n_t sum_i x_ti over the tasks that have a value. Each of 2000 resamples draws as many episodes as
    there are within every task, with replacement (Efron and Tibshirani, An Introduction to the Bootstrap, 1993,
    chapters 8 and 13): the tasks are fixed, and the interval covers other episodes of the same tasks, not other tasks.

    Args:
        groups: values of each task's episodes; None if missing. For a single task it is the plain mean.
        worst: value that takes the place of missing ones in the bound of the mean; None for no bound.

    Returns:
        The mean; without an interval if a task has a single value, or if resampling changes nothing: zero spread
        within the samples does not mean zero uncertainty.
    """
    total = sum(map(len, groups.values()))
    filled = [[worst if v is None else v for v in own] for own in groups.values() if own]
    complete = filled and all(v is not None for own in filled for v in own)
    bound = float(np.mean([np.mean(np.array(own, dtype=np.float64)) for own in filled])) if complete else None
    values = [np.array([v for v in own if v is not None], dtype=np.float64) for own in groups.values()]
    values = [own for own in values if len(own)]
    if not values:
        return Estimate(mean=None, low=None, high=None, n=0, total=total, bound=bound)
    pointwise = Estimate(
        mean=float(np.mean([own.mean() for own in values])),
        low=None,
        high=None,
        n=sum(map(len, values)),
        total=total,
        bound=bound,
    )
    if min(map(len, values)) < 2:
        return pointwise
    rng = np.random.default_rng(seed)
    low, high = percentile_interval(np.mean([resampled_means(v, rng) for v in values], axis=0))
    return pointwise if high - low < 1e-12 else replace(pointwise, low=low, high=high)


def mean_over_tasks(
    episodes: Sequence[EpisodeResult],
    value: Callable[[EpisodeResult], float | None],
    worst: float | None = None,
) -> Estimate:
    """Compute the `balanced_mean` of a value of some episodes, of which each counts the same."""
    tasks = group_by(episodes, lambda e: e.task)
    samples = {task: [value(e) for e in own] for task, own in tasks.items()}
    if not has_samples(episodes):
        return balanced_mean(samples, worst=worst)
    # Each episode counts the same, with the mean of its samples; episodes are resampled, not samples.
    filled = {task: [worst if v is None else v for v in own] for task, own in samples.items()}
    bound = balanced_mean({task: _episode_means(own, filled[task]) for task, own in tasks.items()})
    mean = balanced_mean({task: _episode_means(own, samples[task]) for task, own in tasks.items()})
    n = sum(v is not None for own in samples.values() for v in own)
    missing = any(v is None for own in filled.values() for v in own)
    return replace(mean, n=n, total=len(episodes), bound=None if missing else bound.mean)


def has_samples(episodes: Sequence[EpisodeResult]) -> bool:
    """Return whether an episode has several samples."""
    return any(e.row.sample_index for e in episodes)


def _episode_means(episodes: Sequence[EpisodeResult], values: Sequence[float | None]) -> list[float | None]:
    """Return the mean value of each episode's samples, leaving out those without a value."""
    present = [
        (value, (e.model, e.row.episode)) for value, e in zip(values, episodes, strict=True) if value is not None
    ]
    return list(group_means([value for value, _ in present], [key for _, key in present]))


def executable_share(episodes: Sequence[EpisodeResult], among: Iterable[EpisodeResult]) -> Estimate | None:
    """Return the share of executable episodes, mean over tasks; None if no episode of a report, `among`, is judged."""
    if all(e.row.executable is None for e in among):
        return None
    return mean_over_tasks(episodes, lambda e: float(e.row.executable is True))


def worst_metric(name: str, episodes: Iterable[EpisodeResult]) -> float | None:
    """Return the worst value of a metric among the episodes of a report; None without one."""
    return worst_value(name, (v for e in episodes if (v := e.metric(name)) is not None))


_METRICS = ("sparc", "sparc_rotation", "ldlj", "manipulability_mean", COST, "ik_success_rate", "tracked_fraction")
_KEYS = (
    *("part", "suite", "split", "variant", "pool", "task", "seed", "model", "folder", "id", "status", "reason"),
    "sample_index",
    *("executable", "success", "progress", "rounds", "verdict", "manipulability_cost_scaled", *_METRICS),
)


def tabulate_episodes(episodes: Sequence[EpisodeResult]) -> Table:
    """Build the table of all episodes, one per row, for episodes.csv."""
    return make_listing("episodes", _KEYS, map(_row, episodes))


def _row(e: EpisodeResult) -> Sequence[Value]:
    return (
        *(e.part.title, e.part.suite, e.part.split, e.row.variant, e.row.pool, e.task, e.row.seed, e.model),
        *(e.folder.resolve().name, e.row.id, e.row.status.value, e.row.reason),
        e.row.sample_index,
        None if e.row.executable is None else int(e.row.executable),
        *(None if e.success is None else int(e.success), e.progress, e.rounds, e.verdict, e.cost_scaled),
        *(e.metric(name) for name in _METRICS),
    )
