"""Success of all models on all suites in the paper's orientation: suites as rows, models as columns."""

from collections.abc import Callable, Mapping, Sequence

from kinebench_drake.report.suite.episode import (
    EpisodeResult,
    SuitePart,
    group_by,
    list_models,
)
from kinebench_drake.report.suite.folders import RunFolder
from kinebench_drake.report.suite.scaling import budget_of
from kinebench_drake.report.suite.success import Tally, best_models, incomplete_note, sample_note, tally
from kinebench_drake.report.table import Column, Table, Value

ROWS: Mapping[SuitePart, str] = {
    SuitePart(suite=0, split="test"): "Suite 0",
    SuitePart(suite=1, split="unseen"): "Suite 1",
    SuitePart(suite=2, split="seen"): "Suite 2 (seen)",
    SuitePart(suite=2, split="unseen"): "Suite 2 (unseen)",
    SuitePart(suite=3, split="test"): "Suite 3",
}
"""Rows of the paper's table."""
_MAIN, _SCALING = "Main model comparison", "Scaling configurations"


def split_models(folders: Sequence[RunFolder], episodes: Sequence[EpisodeResult]) -> tuple[list[str], list[str]]:
    """Return the models of the main comparison, and those of the scaling study alone (suite 3 with both tags)."""
    scaled = {f.path for f in folders if f.part.suite == 3 and budget_of(f) is not None}
    own = group_by(episodes, lambda e: e.model)
    study = [model for model, some in own.items() if all(e.folder in scaled for e in some)]
    return [model for model in list_models(episodes) if model not in study], study


def tasks_of(part: SuitePart) -> tuple[str, ...]:
    """Return the tasks of a split of a suite, of the variant if it is not the plain one."""
    from kinebench_drake.suites.catalog import chosen_tasks, load_suite
    from kinebench_drake.suites.families.task import TaskVariant

    return tuple(chosen_tasks(load_suite(part.suite), part.split, None, TaskVariant(part.variant)))


def _coverage(part: SuitePart, episodes: Sequence[EpisodeResult]) -> tuple[Value, Value]:
    """Return the numbers of tasks and of episodes of each model on a part, as text."""
    if not episodes:
        return None, None
    counts = sorted(len({e.key for e in own}) for own in group_by(episodes, lambda e: e.model).values())
    tasks = f"{len({e.task for e in episodes})} of {len(tasks_of(part))}"
    return tasks, f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"


def tabulate_main(folders: Sequence[RunFolder], episodes: Sequence[EpisodeResult], seed: int = 0) -> list[Table]:
    """Build the tables of success and of executable shares, suites by models.

    A row of the paper without a run has dashes; other splits and variants follow below.
    """
    tallies = {key: tally(own, seed, episodes) for key, own in group_by(episodes, lambda e: (e.model, e.part)).items()}
    groups = dict(zip((_MAIN, _SCALING), split_models(folders, episodes), strict=True))
    models = [model for own in groups.values() for model in own]
    parts = [*ROWS, *sorted({e.part for e in episodes} - {*ROWS})]
    columns = (
        Column(key="suite", label="Suite"),
        Column(key="tasks", label="Tasks", meaning="tasks run by any model, of those of the suite"),
        Column(key="episodes", label="Episodes", meaning="least and greatest number of a model"),
        *(
            Column(key=model, label=model, pattern="{:.1%}", estimated=True, group=name if all(groups.values()) else "")
            for name, own in groups.items()
            for model in own
        ),
    )

    def rows(value: Callable[[Tally], Value]) -> tuple[tuple[Value, ...], ...]:
        return tuple(
            (
                *(ROWS.get(part, part.title), *_coverage(part, [e for e in episodes if e.part == part])),
                *(value(t) if (t := tallies.get((m, part))) else None for m in models),
            )
            for part in parts
        )

    best = [(i, 3 + models.index(m)) for i, part in enumerate(parts) for m in best_models(tallies, part)]
    return [
        Table(
            name="table1_success",
            title="Closed-loop success by suite",
            note="Mean over tasks of the share of successes among measured episodes, with 95 % bootstrap intervals "
            "over episodes within tasks. Where episodes were not measured: how many were, and the bound, which counts "
            "the others as failures. Bold: the greatest bound of a suite, among the models that did the most of its "
            "tasks. A dash: not evaluated." + incomplete_note(tallies, episodes) + sample_note(episodes),
            columns=columns,
            rows=rows(lambda t: t.success),
            bold=frozenset(best),
        ),
        Table(
            name="table1_executable",
            title="Executable videos by suite",
            note="Share of all episodes whose generated videos a robot can execute as a whole, mean over tasks, with "
            "95 % bootstrap intervals over episodes within tasks; an episode without a verdict is not executable.",
            columns=columns,
            rows=rows(lambda t: t.executable),
        ),
    ]
