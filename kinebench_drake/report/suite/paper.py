"""Tables and figures of the paper: each as a part of a page, or what is missing in its place."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from kinebench_drake.report.parts import MissingPart, Part, Section, make_missing
from kinebench_drake.report.suite import correlation, extraction, kinematics, scaling, transfer
from kinebench_drake.report.suite.command import run_command
from kinebench_drake.report.suite.episode_result import EpisodeResult, SuitePart, group_by
from kinebench_drake.report.suite.extraction import DEPTH, ROBUSTNESS, Measurements
from kinebench_drake.report.suite.pooling import (
    SuiteRun,
    differing_settings,
    pool_episodes,
    read_suite_runs,
    setting_warnings,
    spec_warnings,
)
from kinebench_drake.report.suite.success import Tally, best_models, incomplete_note, sample_note, tally_runs
from kinebench_drake.report.table import Column, Table, Value, make_table, read_caption

_HELDOUT = "kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --with-depth --out heldout/"
_TRAINED = "baseline/baseline.safetensors"
_BASELINE_COMMANDS = (
    "kinebench-drake suite demos --suite 1 --split train --episodes 100 --size 256 --out demos/",
    "python -m training baseline train --data demos/ --out baseline/",
    "kinebench-drake suite demos --suite 1 --split unseen --episodes 5 --out unseen/",
    f"python -m training baseline evaluate unseen/ --weights {_TRAINED} --out comparison/",
)
_ROBUSTNESS_COMMANDS = (
    *_BASELINE_COMMANDS[:2],
    _HELDOUT,
    f"python -m benchmarks perturb heldout/ --baseline {_TRAINED} --json robustness.json",
)
_DEPTH_COMMANDS = (_HELDOUT, "python -m benchmarks depth-ablation heldout/ --json depth.json")
_GRID = (*((100, steps) for steps in (1500, 4500, 7500, 15000)), *((data, 7500) for data in (10, 25, 50)))
"""Demonstrations a task and optimisation steps of the paper's scaling study."""
_SUITE_0 = SuitePart(suite=0, split="test")
ROWS: Mapping[SuitePart, str] = {
    SuitePart(suite=0, split="test"): "Suite 0",
    SuitePart(suite=1, split="unseen"): "Suite 1",
    SuitePart(suite=2, split="seen"): "Suite 2 (seen)",
    SuitePart(suite=2, split="unseen"): "Suite 2 (unseen)",
    SuitePart(suite=3, split="test"): "Suite 3",
}
"""Rows of the paper's Table 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperData:
    """Everything that the parts of the report are made from."""

    runs: Sequence[SuiteRun]
    episodes: Sequence[EpisodeResult]
    measurements: Measurements
    warnings: Sequence[str]
    seed: int

    def command(self, part: SuitePart, model: str | None = None, tasks: Sequence[str] | None = None) -> str:
        """Return the command of a run of a model on a part, with the settings of another run of the model."""
        paths = {e.folder for e in self.episodes if e.model == model}
        return run_command(part, next((run for run in self.runs if run.path in paths), None), self.runs, tasks=tasks)


def read_paper_data(paths: Sequence[Path], seed: int = 0) -> PaperData:
    """Read runs and measurements.

    Raises:
        UsageError: there is none, or one cannot be used.
    """
    measured = [path for path in paths if extraction.is_measurement(path)]
    folders = [path for path in paths if path not in measured]
    runs = read_suite_runs(folders) if folders or not paths else []
    episodes = pool_episodes(runs)
    return PaperData(
        runs=runs,
        episodes=kinematics.scale_costs(episodes),
        measurements=extraction.read_measurements(measured),
        warnings=[*spec_warnings(runs), *setting_warnings(runs, episodes)],
        seed=seed,
    )


def make_sections(data: PaperData) -> list[tuple[Section, list[Part]]]:
    """Make all tables and figures, or what is missing in their place, in the order of the paper."""
    makers = {
        "extraction": _extraction_parts,
        "success": _success_parts,
        "drop": _drop_parts,
        "sparc": _sparc_parts,
        "manipulability": _manipulability_parts,
        "scaling": _scaling_parts,
    }
    return [
        (Section(**{**read_caption("sections", key), "name": f"section-{key}"}), make(data))
        for key, make in makers.items()
    ]


def _extraction_parts(data: PaperData) -> list[Part]:
    measurements, parts = data.measurements, list[Part]()
    parts.append(
        extraction.draw_trajectories(measurements.baseline) or make_missing("paper_trajectories", _BASELINE_COMMANDS)
    )
    robustness, depth = measurements.studies.get(ROBUSTNESS), measurements.studies.get(DEPTH)
    if robustness is not None:
        parts.append(extraction.draw_conditions(robustness, "figure4b_perturbations"))
    if robustness is None or not robustness.has_baseline:
        of = "" if robustness is None else ", of the learned baseline"
        parts.append(make_missing("paper_perturbations", _ROBUSTNESS_COMMANDS, of=of))
    table, lacking = extraction.tabulate_extraction(measurements), dict[str, Sequence[str]]()
    parts += [] if table is None else [table]
    if depth is None:
        lacking["depth.json"] = _DEPTH_COMMANDS
    if not any(g.pooled and not g.trained for g in measurements.baseline):
        lacking["comparison/"] = _BASELINE_COMMANDS
    if lacking:
        commands = [command for own in lacking.values() for command in own]
        rest = ", other rows" if table else ""
        parts.append(make_missing("paper_extraction", commands, rest=rest, files=" and ".join(lacking)))
    maps = None if depth is None else extraction.draw_depth_maps(depth.relative_depth_error)
    parts += [] if depth is None else [extraction.draw_conditions(depth, "figure5a_depth_quality")]
    return [*parts, maps or make_missing("paper_depth", _DEPTH_COMMANDS)]


def _success_parts(data: PaperData) -> list[Part]:
    parts: list[Part] = [*tabulate_table1(data.runs, data.episodes, data.seed)] if data.episodes else []
    models, _ = split_models(data.runs, data.episodes)
    for part, row in ROWS.items():
        if part.suite == scaling.SUITE:
            continue
        done = {m: {e.task for e in data.episodes if e.part == part and e.model == m} for m in models}
        absent = [m for m, tasks in done.items() if not tasks]
        if absent or not models:
            commands = [data.command(part, model) for model in absent] or [data.command(part)]
            parts.append(_missing_runs("paper_row", commands, row=row, models=", ".join(absent) or "any model"))
        others = {m: [t for t in tasks_of(part) if t not in tasks] for m, tasks in done.items() if tasks}
        commands = [data.command(part, model, tasks) for model, tasks in others.items() if tasks]
        if commands:
            parts.append(_missing_runs("paper_row_tasks", commands, row=row))
    return parts


def _missing_runs(key: str, commands: Sequence[str], **values: object) -> MissingPart:
    note = "; SPEC is the model's own, of which results hold a hash only"
    return make_missing(key, commands, spec=note if any(" SPEC " in command for command in commands) else "", **values)


def _drop_parts(data: PaperData) -> list[Part]:
    parts: list[Part] = []
    episodes = [e for e in data.episodes if e.part.split in (transfer.SEEN, transfer.UNSEEN)]
    for (model, suite), own in group_by(episodes, lambda e: (e.model, e.part.suite)).items():
        paths = {e.folder for e in own}
        if names := differing_settings([run for run in data.runs if run.path in paths]):
            command = data.command(SuitePart(suite=suite, split=transfer.UNSEEN), model)
            values = {"model": model, "suite": suite, "settings": " and ".join(names)}
            parts.append(make_missing("paper_drop_settings", [command], **values))
            episodes = [e for e in episodes if (e.model, e.part.suite) != (model, suite)]
    drops = transfer.study_drops(episodes, _transfers(), data.seed)
    if drops:
        parts = [transfer.tabulate_drops(drops), *transfer.draw_drops(drops), *parts]
    wanted = sorted(transfer.missing_splits(episodes), key=lambda item: item[1])
    for part, group in groupby(wanted, key=lambda item: item[1]):
        models = [model for model, _ in group]
        tasks = _counterparts(part, [e.task for e in episodes if e.part.suite == part.suite])
        commands = [data.command(part, model, tasks) for model in models]
        parts.append(make_missing("paper_drop", commands, models=", ".join(models), part=part))
    if not parts:
        commands = [data.command(SuitePart(suite=2, split=split)) for split in (transfer.SEEN, transfer.UNSEEN)]
        parts.append(make_missing("paper_drops", commands))
    return parts


def _transfers() -> Mapping[str, Sequence[str]]:
    """Return the trained tasks that each unseen task of suite 1 derives from."""
    from kinebench_drake.suites.catalog import load_suite

    return {t.task: t.of for t in load_suite(1).transfers}


def _counterparts(part: SuitePart, tasks: Sequence[str]) -> list[str] | None:
    """Return the tasks of a split of suite 1 that compare with tasks of the other one; None for other suites."""
    if part.suite != 1:
        return None
    pairs = [(task, origin) for task, own in _transfers().items() for origin in own]
    chosen = {b for a, b in pairs if a in tasks} if part.split == transfer.SEEN else {a for a, b in pairs if b in tasks}
    return sorted(chosen) or None


def _study_parts(data: PaperData, predictor: correlation.Predictor, name: str, title: str) -> list[Part]:
    """Return figure and table of a metric against success."""
    study = correlation.study_correlation(data.episodes, predictor)
    figure = correlation.draw_correlation(data.episodes, study, data.seed) if data.episodes else None
    parts: list[Part] = [] if figure is None else [replace(figure, name=name, title=title)]
    if study.is_defined:
        return [*parts, correlation.tabulate_correlation(study, data.seed)]
    command = data.command(next(iter(sorted(e.part for e in data.episodes)), _SUITE_0))
    what = "Figure and rank correlation" if figure is None else "Rank correlation"
    points = correlation.MIN_POINTS
    return [*parts, make_missing("paper_correlation", [command], what=what, title=title, points=points)]


def _sparc_parts(data: PaperData) -> list[Part]:
    return _study_parts(data, correlation.SPARC, "figure6_sparc_success", "Figure 6: SPARC and success")


def _manipulability_parts(data: PaperData) -> list[Part]:
    figure = kinematics.draw_manipulability(data.episodes) if data.episodes else None
    missing = make_missing("paper_manipulability", [data.command(_SUITE_0)])
    violins = missing if figure is None else replace(figure, name="figure7_manipulability", title=missing.title)
    name, title = "manipulability_success", "Manipulability cost and success"
    return [violins, *_study_parts(data, correlation.MANIPULABILITY, name, title)]


def _scaling_parts(data: PaperData) -> list[Part]:
    part = SuitePart(suite=scaling.SUITE, split="test")
    studies = scaling.study_scaling(data.runs, data.episodes, scaling.task_difficulties(), data.seed)
    parts: list[Part] = [scaling.tabulate_scaling(studies)] if studies else []

    def commands(like: SuiteRun | None, budgets: Sequence[tuple[int, int]]) -> list[str]:
        tags = [{"data": count, "steps": steps} for count, steps in budgets]
        return [run_command(part, like, data.runs, tags=own) for own in tags]

    for study, figure in scaling.draw_studies(studies):
        parts += [figure] if figure else []
        like = next((run for run in data.runs if scaling.budget_of(run) and study.model in run.models), None)
        done = {(budget.data, budget.steps) for budget in study.budgets}
        if absent := [budget for budget in _GRID if budget not in done]:
            others = ", other trainings of the paper" if figure else ""
            parts.append(make_missing("paper_scaling_runs", commands(like, absent), model=study.model, others=others))
    for run in scaling.untagged(data.runs):
        command = run_command(part, run, data.runs, tags={**run.tags, "data": "N", "steps": "N"})
        parts.append(make_missing("paper_scaling_tags", [command], run=run.name))
    return parts or [make_missing("paper_scaling", commands(None, _GRID))]


def tabulate_table1(runs: Sequence[SuiteRun], episodes: Sequence[EpisodeResult], seed: int = 0) -> list[Table]:
    """Build the paper's Table 1, suites (rows) by models (columns): success, and executable shares.

    A row of the paper without a run has dashes; other splits and variants follow below.
    """
    tallies = tally_runs(episodes, seed)
    main, study = split_models(runs, episodes)
    groups = {**dict.fromkeys(main, "Main model comparison"), **dict.fromkeys(study, "Scaling configurations")}
    parts = [*ROWS, *sorted({e.part for e in episodes} - {*ROWS})]
    rows = [
        {"suite": ROWS.get(part, part.title), **_coverage(part, [e for e in episodes if e.part == part])}
        for part in parts
    ]

    def columns(value: Callable[[Tally], Value]) -> list[tuple[Column, list[Value]]]:
        return [
            (
                Column(key=m, label=m, pattern="{:.1%}", estimated=True, group=group if main and study else ""),
                [value(t) if (t := tallies.get((m, part))) else None for part in parts],
            )
            for m, group in groups.items()
        ]

    return [
        make_table(
            "table1_success",
            rows,
            more=columns(lambda t: t.success),
            note=incomplete_note(tallies, episodes) + sample_note(episodes),
            bold=[(i, m) for i, part in enumerate(parts) for m in best_models(tallies, part)],
        ),
        make_table("table1_executable", rows, more=columns(lambda t: t.executable)),
    ]


def split_models(runs: Sequence[SuiteRun], episodes: Sequence[EpisodeResult]) -> tuple[list[str], list[str]]:
    """Return the models of the main comparison, and those of the scaling study alone (suite 3 with both tags)."""
    scaled = {run.path for run in runs if run.part.suite == scaling.SUITE and scaling.budget_of(run) is not None}
    own = group_by(episodes, lambda e: e.model)
    study = [model for model, some in own.items() if all(e.folder in scaled for e in some)]
    return [model for model in own if model not in study], study


def tasks_of(part: SuitePart) -> tuple[str, ...]:
    """Return the tasks of a split of a suite, of the variant if it is not the plain one."""
    from kinebench_drake.suites.catalog import chosen_tasks, load_suite
    from kinebench_drake.suites.families.task import TaskVariant

    return tuple(chosen_tasks(load_suite(part.suite), part.split, None, TaskVariant(part.variant)))


def _coverage(part: SuitePart, episodes: Sequence[EpisodeResult]) -> dict[str, Value]:
    """Return the numbers of tasks and of episodes of each model on a part, as text."""
    if not episodes:
        return {}
    counts = sorted(len({e.key for e in own}) for own in group_by(episodes, lambda e: e.model).values())
    return {
        "tasks": f"{len({e.task for e in episodes})} of {len(tasks_of(part))}",
        "episodes": f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}",
    }
