"""Tables of success: the models on the suites, each suite's summary, and task by task."""

from collections.abc import Mapping, Sequence

from kinebench_drake.report.suite.episode import EpisodePart, EpisodeResult, group
from kinebench_drake.report.suite.folders import models_of
from kinebench_drake.report.suite.table import Column, Table, Value
from kinebench_drake.report.suite.tally import NO_VERDICT, VERDICTS, Tally, tally
from kinebench_drake.results.aggregate import Estimate

_PERCENT = "{:.1%}"
_TALLY = (
    Column(key="progress", label="Progress", pattern=_PERCENT, estimated=True, meaning="share of the steps done"),
    Column(key="rounds", label="Rounds", pattern="{:.2f}", estimated=True, meaning="clips asked for"),
    Column(key="sparc", label="SPARC", pattern="{:.2f}", estimated=True, meaning="nearer 0 is smoother"),
    Column(
        key="manipulability_cost_scaled", label="Manipulability cost, scaled", pattern="{:.2f}", estimated=True,
        meaning="0 at the 10th percentile of all episodes here, 1 at the 90th; lower is better",
    ),
    Column(key="measured", label="Measured", meaning="episodes that ended as a success or as a failure"),
    Column(key="episodes", label="Episodes"),
    Column(key="unmeasurable", label="Unmeasurable", meaning="neither success nor failure"),
    Column(key="errors", label="Errors", meaning="neither success nor failure"),
    Column(
        key="success_all", label="Success, unmeasured as failures", pattern=_PERCENT, estimated=True,
        meaning="share of all episodes, with Wilson's interval",
    ),
    *(Column(key=f"failed_{name}", label=f"Failed: {name}") for name in VERDICTS),
    Column(key="failed_no_verdict", label=f"Failed: {NO_VERDICT}"),
)  # fmt: skip


def suites_table(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """Task-balanced success of every model (rows) on every part (columns), the best of each part in bold.

    Models that did fewer tasks of a part than others are not among its best.
    """
    parts, models = sorted({e.part for e in episodes}), models_of(episodes)
    cells = group(episodes, lambda e: (e.model, e.part))
    tallies = {key: tally(own, seed) for key, own in cells.items()}
    rows = [tuple[Value, ...]([m, *(t.success if (t := tallies.get((m, p))) else None for p in parts)]) for m in models]
    return Table(
        name="suites",
        title="Closed-loop success by suite",
        note="Mean over tasks of the share of successes among measured episodes; 95 % bootstrap intervals over "
        "episodes within tasks. A dash: not run." + _unlike(tallies, episodes),
        columns=(
            Column(key="model", label="Model"),
            *(Column(key=p.slug, label=p.title, pattern=_PERCENT, estimated=True) for p in parts),
        ),
        rows=tuple(rows),
        bold=frozenset(at for k, part in enumerate(parts) for at in _best(rows, k + 1, _complete(tallies, part))),
    )


def summary_table(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """All that is counted of every model on every part."""
    groups = sorted(group(episodes, lambda e: (e.part, e.model)).items(), key=lambda item: item[0][0])
    return Table(
        name="summary",
        title="Each suite and model in numbers",
        note="Every task counts the same in success, progress, rounds, SPARC and cost (95 % bootstrap intervals over "
        "episodes within tasks); pooled success counts every episode the same (95 % Wilson intervals). Episodes that "
        "could not be measured are no failures: the last rate shows what they would make of it if they were.",
        columns=(
            Column(key="part", label="Suite"),
            Column(key="model", label="Model"),
            Column(key="tasks", label="Tasks"),
            Column(key="success", label="Success", pattern=_PERCENT, estimated=True, meaning="every task the same"),
            Column(key="success_pooled", label="Success, pooled", pattern=_PERCENT, estimated=True),
            *_TALLY,
        ),
        rows=tuple(
            (part.title, model, t.tasks, t.success, t.pooled, *_told(t))
            for (part, model), own in groups
            for t in [tally(own, seed)]
        ),
    )


def tasks_table(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """The same of every task."""
    groups = sorted(
        group(episodes, lambda e: (e.part, e.task, e.model)).items(), key=lambda item: (item[0][0], item[0][1])
    )
    return Table(
        name="tasks",
        title="Each task",
        note="Success with 95 % Wilson intervals, the other means with 95 % bootstrap intervals over episodes.",
        columns=(
            Column(key="part", label="Suite"),
            Column(key="task", label="Task"),
            Column(key="model", label="Model"),
            Column(key="success", label="Success", pattern=_PERCENT, estimated=True),
            *_TALLY,
        ),
        rows=tuple(
            (part.title, task, model, t.pooled, *_told(t))
            for (part, task, model), own in groups
            for t in [tally(own, seed)]
        ),
        latex=False,
    )


def _told(t: Tally) -> list[Value]:
    means = [t.progress, t.rounds, t.sparc, t.cost]
    return [*means, t.measured, t.episodes, t.unmeasurable, t.errors, t.counted, *t.verdicts.values()]


def _complete(tallies: Mapping[tuple[str, EpisodePart], Tally], part: EpisodePart) -> set[str]:
    """Models that did the most tasks of a part: only their means can be held against each other."""
    tasks = {model: t.tasks for (model, at), t in tallies.items() if at == part}
    return {model for model, n in tasks.items() if n == max(tasks.values())}


def _best(rows: Sequence[tuple[Value, ...]], column: int, models: set[str]) -> list[tuple[int, int]]:
    """Cells of the greatest mean of some models, where there is more than one to choose from."""
    chosen = {i: row[column] for i, row in enumerate(rows) if row[0] in models}
    means = {i: v.mean for i, v in chosen.items() if isinstance(v, Estimate) and v.mean is not None}
    best = max(means.values(), default=0.0)
    return [(i, column) for i, value in means.items() if value == best] if len(set(means.values())) > 1 else []


def _unlike(tallies: Mapping[tuple[str, EpisodePart], Tally], episodes: Sequence[EpisodeResult]) -> str:
    """Which means are over fewer tasks than others of their part: they cannot be held against them as they are."""
    told = []
    for part, own in sorted(group(episodes, lambda e: e.part).items()):
        tasks = len({e.task for e in own})
        told += [
            f"{model} did {t.tasks} of {tasks} tasks of {part.title}"
            for (model, at), t in tallies.items()
            if at == part and t.tasks < tasks
        ]
    return f" Not over the same tasks: {'; '.join(told)}." if told else ""
