"""Two models on the episodes that both did."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby

from kinebench_drake.errors import UsageError
from kinebench_drake.report.suite.episode import EpisodePart, EpisodeResult, group
from kinebench_drake.report.suite.folders import models_of
from kinebench_drake.report.suite.table import Column, Table, Value, lines
from kinebench_drake.report.suite.tally import balanced
from kinebench_drake.results.aggregate import Estimate
from kinebench_drake.stats import PairedOutcomes

ALL = "all tasks"
_PRINTED = (
    *("task", "success_first", "success_second", "difference", "p", "p_adjusted", "progress_difference"),
    *("measured", "shared"),
)
"""Keys of the columns that a terminal has room for."""
Pair = tuple[EpisodeResult, EpisodeResult]


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """Two models on the shared episodes of one task, or of all tasks of a part."""

    part: EpisodePart
    task: str
    """Plain task id, or ALL."""
    first: str
    second: str
    shared: int
    """Episodes that both have a row of."""
    paired: PairedOutcomes | None
    """Outcomes of those that both have measured; None if there is none."""
    counted: PairedOutcomes
    """Outcomes of all shared ones, what was not measured counted as a failure."""
    progress: Estimate
    """Mean over tasks of the differences of progress, first less second."""
    adjusted_p: float | None = None
    """p-value adjusted for the number of tasks tested, of a task."""


def compare(episodes: Sequence[EpisodeResult], seed: int = 0) -> list[Compared]:
    """Every two models on every part: each task they share, and all of these together first.

    Raises:
        UsageError: there are not two models, or no two share an episode.
    """
    models = models_of(episodes)
    if len(models) < 2:
        raise UsageError(
            f"all episodes are of one model, {', '.join(models)}: there is nothing to compare; name folders of two "
            "models, or runs told apart with `suite run --tag KEY=VALUE`"
        )
    own = {model: {e.key: e for e in some} for model, some in group(episodes, lambda e: e.model).items()}
    found: list[Compared] = []
    for first, second in combinations(models, 2):
        keys = [key for key in own[first] if key in own[second]]
        pairs = [(own[first][key], own[second][key]) for key in keys]
        for part in sorted({a.part for a, _ in pairs}):
            found += _compare_part(part, [pair for pair in pairs if pair[0].part == part], seed)
    if not found:
        raise UsageError(
            f"no two of {', '.join(models)} share an episode (the same suite, split, task, seed, pool and variant): "
            "there is nothing to compare"
        )
    return found


def comparison_table(compared: Sequence[Compared]) -> Table:
    """All comparisons, one a row."""
    return Table(
        name="comparison",
        title="PairedOutcomes comparison on shared episodes",
        note="Differences are the first model's less the second's, over the episodes that both have measured. Success "
        "with 95 % intervals by Newcombe's method 10; p: McNemar's exact test; adjusted p: by Benjamini and Hochberg "
        "over the tasks of two models on one suite. Progress, every task the same, with 95 % bootstrap intervals over "
        "episodes within tasks.",
        columns=(
            Column(key="part", label="Suite"),
            Column(key="first", label="First"),
            Column(key="second", label="Second"),
            Column(key="task", label="Task"),
            Column(key="success_first", label="Success, first", pattern="{:.1%}"),
            Column(key="success_second", label="Success, second", pattern="{:.1%}"),
            Column(key="difference", label="Difference", pattern="{:+.1%}", estimated=True),
            Column(key="p", label="p", pattern="{:.3g}"),
            Column(key="p_adjusted", label="Adjusted p", pattern="{:.3g}"),
            Column(key="first_only", label="First only", meaning="episodes in which the first model alone succeeds"),
            Column(key="second_only", label="Second only", meaning="episodes in which the second alone succeeds"),
            Column(key="progress_difference", label="Progress", pattern="{:+.1%}", estimated=True),
            Column(key="measured", label="Measured by both"),
            Column(key="shared", label="Shared"),
            Column(key="difference_all", label="Difference, unmeasured as failures", pattern="{:+.1%}", estimated=True),
        ),
        rows=tuple(_row(c) for c in compared),
        bold=frozenset((i, 6) for i, c in enumerate(compared) if c.task == ALL),
    )


def comparison_lines(table: Table) -> Iterator[str]:
    """The table to print: what matters most, two models on one part at a time."""
    keep = [k for k, column in enumerate(table.columns) if column.key in _PRINTED]
    columns = tuple(table.columns[k] for k in keep)
    for (part, first, second), rows in groupby(table.rows, key=lambda row: row[:3]):
        yield f"{first} - {second}, {part}"
        chosen = tuple(tuple(row[k] for k in keep) for row in rows)
        yield from lines(replace(table, columns=columns, rows=chosen, bold=frozenset()))
        yield ""
    yield table.note


def _compare_part(part: EpisodePart, pairs: Sequence[Pair], seed: int) -> list[Compared]:
    tasks = [_compared(part, task, own, seed) for task, own in sorted(_by_task(pairs).items())]
    return [_compared(part, ALL, pairs, seed), *_adjusted(tasks)]


def _compared(part: EpisodePart, task: str, pairs: Sequence[Pair], seed: int) -> Compared:
    outcomes = [(a.success, b.success) for a, b in pairs]
    known = [(a, b) for a, b in outcomes if a is not None and b is not None]
    differences = {
        name: [a.progress - b.progress for a, b in own if a.progress is not None and b.progress is not None]
        for name, own in _by_task(pairs).items()
    }
    return Compared(
        part=part,
        task=task,
        first=pairs[0][0].model,
        second=pairs[0][1].model,
        shared=len(pairs),
        paired=PairedOutcomes.of([a for a, _ in known], [b for _, b in known]) if known else None,
        counted=PairedOutcomes.of([a is True for a, _ in outcomes], [b is True for _, b in outcomes]),
        progress=balanced(differences, seed=seed),
    )


def _by_task(pairs: Sequence[Pair]) -> dict[str, list[Pair]]:
    groups: dict[str, list[Pair]] = {}
    for pair in pairs:
        groups.setdefault(pair[0].task, []).append(pair)
    return groups


def _adjusted(tasks: Sequence[Compared]) -> list[Compared]:
    """The tasks with p-values adjusted as by Benjamini and Hochberg (J. R. Statist. Soc. B 57, 1995)."""
    from scipy.stats import false_discovery_control

    tested = [c for c in tasks if c.paired is not None]
    values = [c.paired.p_value for c in tested if c.paired is not None]
    adjusted = false_discovery_control(values) if values else []
    found = {c.task: float(p) for c, p in zip(tested, adjusted, strict=True)}
    return [replace(c, adjusted_p=found.get(c.task)) for c in tasks]


def difference_of(paired: PairedOutcomes | None) -> Estimate | None:
    """Difference of the success rates with Newcombe's interval."""
    if paired is None:
        return None
    low, high = paired.interval()
    return Estimate(mean=paired.difference, low=low, high=high, n=paired.n, total=paired.n)


def _row(c: Compared) -> tuple[Value, ...]:
    p = c.paired
    return (
        *(c.part.title, c.first, c.second, c.task),
        None if p is None else (p.both + p.first_only) / p.n,
        None if p is None else (p.both + p.second_only) / p.n,
        difference_of(p),
        None if p is None else p.p_value,
        c.adjusted_p,
        None if p is None else p.first_only,
        None if p is None else p.second_only,
        c.progress if c.progress.n else None,
        0 if p is None else p.n,
        c.shared,
        difference_of(c.counted),
    )
