"""Models compared, two by two, on the episodes that both did; and with direct execution of the expert's track."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import fsum, nan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.report.number import (
    ALL_TASKS,
    NumberComparison,
    compare_numbers,
    comparison_lines,
    motionless_lines,
    share_difference,
    verdict_line,
    verdict_lines,
)
from kinebench_drake.report.suite.episode_result import EpisodeResult, SuitePart, balanced_mean, group_by, list_models
from kinebench_drake.report.suite.pooling import SuiteRun, pool_episodes, read_suite_runs
from kinebench_drake.report.table import Table, Value, make_table
from kinebench_drake.results.aggregate import Estimate
from kinebench_drake.results.power import POWER, least_difference
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.stats import CONFIDENCE, PairedShares, adjust_p_values

if TYPE_CHECKING:
    from kinebench_drake.closed_loop.tolerance import ToleranceAttempt
    from kinebench_drake.suites.composition import Episode

DIRECT = "expert's true track"
"""Label of direct execution in place of a model's name."""
_PRINTED = ("task", "success_first", "success_second", "difference", "p", "p_adjusted", "measured")
"""Keys of the columns printed to a terminal."""
Pair = tuple[Sequence[EpisodeResult], Sequence[EpisodeResult]]
"""Samples of the same episode by two models."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairComparison:
    """Two models on the shared episodes of one task, or of all tasks of a part."""

    part: SuitePart
    task: str
    """Plain task id, or ALL_TASKS."""
    first: str
    second: str
    shared: int
    """Episodes that both have a row of."""
    paired: PairedShares | None
    """Success in those measured for both; None if there is none."""
    counted: PairedShares
    """Success in all shared episodes, unmeasured samples counted as failures."""
    uppers: tuple[float, float]
    """Success of both in all shared episodes, unmeasured samples counted as successes."""
    progress: Estimate
    """Mean over tasks of the differences of progress, first minus second."""
    adjusted_p: float | None = None
    """p-value of a task, adjusted for the number of tasks tested."""

    @property
    def is_clear(self) -> bool:
        """True if the intervals of the difference and of that over all episodes exclude 0, and the p-value confirms it.

        The p-value of a task is the adjusted one.
        """
        if self.paired is None:
            return False
        (low, high), (least, most) = self.paired.interval(), self.counted.interval()
        p = self.paired.p_value if self.task == ALL_TASKS else self.adjusted_p
        return (min(low, least) > 0.0 or max(high, most) < 0.0) and p is not None and p < 1.0 - CONFIDENCE


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelComparison:
    """Comparison of all pairs of models of some runs."""

    runs: Sequence[SuiteRun]
    episodes: Sequence[EpisodeResult]
    pairs: Sequence[PairComparison]
    numbers: Sequence[NumberComparison] = ()
    """Headline numbers on the shared episodes."""

    @property
    def leads(self) -> list[str]:
        """The better of every two models on every part, in success, then in executable videos; motionless samples."""
        models = group_by(self.episodes, lambda e: e.model).items()
        motionless = motionless_lines({model: [e.row for e in own] for model, own in models})
        return [*success_lines(self.pairs), *verdict_lines(self.numbers), *motionless]


def read_comparison(paths: Sequence[Path], seed: int = 0) -> ModelComparison:
    """Compare the models of some suite runs on the episodes they share."""
    runs = read_suite_runs(paths)
    episodes = pool_episodes(runs)
    numbers = [
        number
        for first, second, part, shared in _shared_episodes(episodes)
        for number in compare_numbers(
            [(tuple(e.row for e in a), tuple(e.row for e in b)) for a, b in shared], first, second, part.title, seed
        )
    ]
    return ModelComparison(runs=runs, episodes=episodes, pairs=compare(episodes, seed), numbers=numbers)


def read_ceiling(
    paths: Sequence[Path], execute: "Callable[[Sequence[Episode]], Iterable[ToleranceAttempt]]", seed: int = 0
) -> ModelComparison:
    """Compare each model of some suite runs with direct execution of the expert's true track: each task's ceiling.

    Args:
        paths: output folders of `suite run`.
        execute: executes the expert's track in each of some episodes, in any order.

    Raises:
        UsageError: the folders cannot be used or pooled, or a row lacks its seed, pool or variant.
        KinebenchError: a worker died.
    """
    runs = read_suite_runs(paths)
    episodes = pool_episodes(runs)
    if DIRECT in list_models(episodes):
        raise UsageError(f"a model is named {DIRECT!r}, which is the label of direct execution; give it another name")
    compositions = {e.key: _compose(e) for e in episodes}
    unique = {episode.id: episode for episode in compositions.values()}
    attempts = {attempt.episode.id: attempt for attempt in execute(list(unique.values()))}
    once = {key: own[0] for key, own in group_by(episodes, lambda e: e.key).items()}
    direct = [_direct_result(e, attempts[compositions[key].id]) for key, e in once.items()]
    pairs = [c for c in compare([*episodes, *direct], seed) if c.second == DIRECT]
    return ModelComparison(runs=runs, episodes=[*episodes, *direct], pairs=pairs)


def _compose(result: EpisodeResult) -> "Episode":
    """Compose the episode that a row names."""
    from kinebench_drake.suites.catalog import EpisodeSpec
    from kinebench_drake.suites.composition import Pool
    from kinebench_drake.suites.families.task import TaskVariant

    extra = result.row.extra
    try:
        seed, pool, variant = int(str(extra["seed"])), Pool(extra["pool"]), TaskVariant(extra["variant"])
    except (KeyError, ValueError) as error:
        raise UsageError(f"{result.folder}: row {result.row.id} does not identify its episode ({error})") from None
    return EpisodeSpec(task=result.task, seed=seed, pool=pool, variant=variant).episode()


def _direct_result(result: EpisodeResult, attempt: "ToleranceAttempt") -> EpisodeResult:
    """Convert a direct execution into the result of a model; `result` is a model's in the same episode."""
    labels = {name: result.row.extra[name] for name in ("seed", "pool", "variant")}
    cause = None if attempt.success else {"verdict": None, "text": attempt.reason}
    row = SampleRow(
        id=result.row.episode,
        video="",
        task=result.task,
        model=DIRECT,
        status=Status.OK,
        reason=None,
        content_hash="",
        extra={**labels, "success": attempt.success, "progress": attempt.progress, "cause": cause},
    )
    return EpisodeResult(part=result.part, model=DIRECT, folder=None, row=row)


def compare(episodes: Sequence[EpisodeResult], seed: int = 0) -> list[PairComparison]:
    """Compare every two models on every part: all shared tasks together, then each.

    Raises:
        UsageError: there are not two models, or no two share an episode.
    """
    models = list_models(episodes)
    if len(models) < 2:
        raise UsageError(
            f"all episodes are of one model, {', '.join(models)}: there is nothing to compare; name folders of two "
            "models, or runs distinguished with `suite run --tag KEY=VALUE`"
        )
    comparisons: list[PairComparison] = []
    for _, _, _, shared in _shared_episodes(episodes):
        by_task = group_by(shared, lambda pair: pair[0][0].task)
        tasks = [_compare_pairs(task, by_task[task], seed) for task in sorted(by_task)]
        comparisons += [_compare_pairs(ALL_TASKS, shared, seed), *_adjust(tasks)]
    if not comparisons:
        raise UsageError(
            f"no two of {', '.join(models)} share an episode (the same suite, split, task, seed, pool and variant): "
            "there is nothing to compare"
        )
    return comparisons


def _shared_episodes(episodes: Sequence[EpisodeResult]) -> Iterator[tuple[str, str, SuitePart, list[Pair]]]:
    """Yield every two models and every part of which they share episodes, with these."""
    models = group_by(episodes, lambda e: e.model).items()
    own = {model: group_by(some, lambda e: e.key) for model, some in models}
    for first, second in combinations(own, 2):
        pairs: list[Pair] = [(own[first][key], own[second][key]) for key in own[first] if key in own[second]]
        for part, shared in sorted(group_by(pairs, lambda pair: pair[0][0].part).items()):
            yield first, second, part, shared


def _compare_pairs(task: str, pairs: Sequence[Pair], seed: int) -> PairComparison:
    samples = max(len(own) for pair in pairs for own in pair)

    def pair_shares(values: Array) -> PairedShares:
        return PairedShares(first=values[:, 0], second=values[:, 1], samples=samples, seed=seed)

    shares = _means(pairs, lambda e: e.hit)
    measured = np.isfinite(shares).all(axis=1)
    uppers = _means(pairs, lambda e: 1.0 if e.hit is None else e.hit).mean(axis=0).tolist()
    progress = np.subtract(*_means(pairs, lambda e: e.progress).T)
    differences = group_by(zip(pairs, progress.tolist(), strict=True), lambda item: item[0][0][0].task)
    (first, *_), (second, *_) = pairs[0]
    return PairComparison(
        part=first.part,
        task=task,
        first=first.model,
        second=second.model,
        shared=len(pairs),
        paired=pair_shares(shares[measured]) if measured.any() else None,
        counted=pair_shares(_means(pairs, lambda e: e.hit or 0.0)),
        uppers=(uppers[0], uppers[1]),
        progress=balanced_mean(
            {name: [value for _, value in own if np.isfinite(value)] for name, own in differences.items()}, seed=seed
        ),
    )


def _means(pairs: Sequence[Pair], value: Callable[[EpisodeResult], float | None]) -> Array:
    """Return the mean value (N, 2) of each episode's samples by either model; NaN where none has a value."""

    def mean(samples: Sequence[EpisodeResult]) -> float:
        values = [v for e in samples if (v := value(e)) is not None]
        return fsum(values) / len(values) if values else nan

    return np.array([[mean(samples) for samples in pair] for pair in pairs], dtype=np.float64)


def _adjust(tasks: Sequence[PairComparison]) -> list[PairComparison]:
    """Adjust the p-values of tasks for their number."""
    by_task = adjust_p_values({c.task: c.paired.p_value for c in tasks if c.paired is not None})
    return [replace(c, adjusted_p=by_task.get(c.task)) for c in tasks]


def tabulate_comparison(pairs: Sequence[PairComparison]) -> Table:
    """Build the table of comparisons, one per row."""
    clear = ((i, "difference") for i, c in enumerate(pairs) if c.is_clear)
    return make_table("comparison", map(_row, pairs), bold=clear, power=f"{POWER:.0%}")


def _row(c: PairComparison) -> dict[str, Value]:
    row: dict[str, Value] = {
        **{"part": c.part.title, "first": c.first, "second": c.second, "task": c.task},
        **{"p_adjusted": c.adjusted_p, "progress_difference": c.progress if c.progress.n else None},
        **{"measured": 0, "shared": c.shared, "difference_all": share_difference(c.counted)},
    }
    if (paired := c.paired) is None:
        return row
    return {
        **row,
        **dict(zip(("success_first", "success_second"), paired.rates, strict=True)),
        **dict(zip(("first_only", "second_only"), paired.better, strict=True)),
        **{"difference": share_difference(paired), "p": paired.p_value, "measured": paired.n},
        "least_difference": least_difference(paired),
    }


def success_lines(pairs: Sequence[PairComparison]) -> Iterator[str]:
    """Say of every two models on every part which succeeds more often, unmeasured episodes as failures, a line each."""
    for c in pairs:
        if c.task == ALL_TASKS:
            yield verdict_line(c.first, c.second, c.part.title, "success", c.counted, c.uppers)


def pair_lines(pairs: Sequence[PairComparison]) -> Iterator[str]:
    """Format the main columns of a comparison for a terminal, one block per pair of models and part."""
    return comparison_lines(tabulate_comparison(pairs), _PRINTED)


def ceiling_lines(pairs: Sequence[PairComparison]) -> Iterator[str]:
    """Format each model's share of the successes of direct execution, all tasks together."""
    for c in pairs:
        if c.task == ALL_TASKS and c.paired is not None:
            own, ceiling = (c.paired.n * rate for rate in c.paired.rates)
            share = f", {own / ceiling:.1%} of it" if ceiling else ""
            done = f"success in {own:g} of {c.paired.n}, direct execution in {ceiling:g}"
            yield f"{c.first}, {c.part.title}: {done}{share}"
