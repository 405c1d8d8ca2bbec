"""Sections of the paper's report: each table and figure, or what is missing in its place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from kinebench_drake.report.parts import MissingPart, Part, Section
from kinebench_drake.report.suite import correlation, extraction, kinematics, scaling, transfer
from kinebench_drake.report.suite.command import run_command
from kinebench_drake.report.suite.episode import EpisodeResult, SuitePart, group_by
from kinebench_drake.report.suite.folders import RunFolder, differing_settings
from kinebench_drake.report.suite.main_table import ROWS, split_models, tabulate_main, tasks_of
from kinebench_drake.report.suite.measurement import DEPTH, ROBUSTNESS, Measurements

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


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperData:
    """Everything that the parts of the report are made from."""

    folders: Sequence[RunFolder]
    episodes: Sequence[EpisodeResult]
    measurements: Measurements
    warnings: Sequence[str]
    seed: int

    def like(self, model: str) -> RunFolder | None:
        """Return a run of a model; None if there is none."""
        paths = {e.folder for e in self.episodes if e.model == model}
        return next((f for f in self.folders if f.path in paths), None)

    def command(self, part: SuitePart, model: str | None = None, **options: object) -> str:
        """Return the command of a run of a model on a part."""
        like = None if model is None else self.like(model)
        return run_command(part, like, self.folders, **options)  # type: ignore[arg-type]


def make_sections(data: PaperData) -> list[tuple[Section, list[Part]]]:
    """Make all tables and figures, or what is missing in their place, in the order of the paper."""
    return [
        (Section(name=f"section-{name}", title=title, text=text), make(data))
        for name, title, text, make in (
            ("extraction", "Figures 4 and 5: motion extraction", _EXTRACTION, _extraction_parts),
            ("success", "Table 1: success", _SUCCESS, _success_parts),
            ("drop", "From seen to unseen", _DROP, _drop_parts),
            ("sparc", "Figure 6: SPARC and success", _SPARC, _sparc_parts),
            ("manipulability", "Figure 7: manipulability", _MANIPULABILITY, _manipulability_parts),
            ("scaling", "Scaling", _SCALING, _scaling_parts),
        )
    ]


_EXTRACTION = (
    "Errors of the gripper poses that are read from videos, against the simulator's truth (section 4.2 of the paper: "
    "Figures 4 and 5, and the ablation of depth). Figures 1 to 3 are schematic."
)
_SUCCESS = "The paper's Table 1, suites by models, and the share of videos that a robot can execute as a whole."
_DROP = "Success lost on assets, looks and tasks that were not trained, for the same model."
_SPARC = "One point per model and suite: task-balanced mean SPARC, and success standardised within tasks."
_MANIPULABILITY = (
    "Manipulability cost of the generated motion by suite and model, and whether it goes along with success."
)
_SCALING = "Success on suite 3 by demonstrations and optimisation steps, for tasks of rising difficulty."


def _extraction_parts(data: PaperData) -> list[Part]:
    measurements, parts = data.measurements, list[Part]()
    parts.append(
        extraction.draw_trajectories(measurements.baseline)
        or MissingPart(
            title="Figure 4a, errors of grounding and learned inverse dynamics on unseen tasks",
            needs="comparison/ among the arguments",
            commands=_BASELINE_COMMANDS,
        )
    )
    robustness, depth = measurements.studies.get(ROBUSTNESS), measurements.studies.get(DEPTH)
    title = "Figure 4b: errors under perturbations of the frames"
    if robustness is not None:
        caption = "Errors of the same videos, unchanged and with perturbed frames."
        parts.append(extraction.draw_conditions(robustness, "figure4b_perturbations", title, caption))
    if robustness is None or not robustness.has_baseline:
        of = "" if robustness is None else ", of the learned baseline"
        needs = "robustness.json, measured with --baseline, among the arguments"
        parts.append(MissingPart(title=title + of, needs=needs, commands=_ROBUSTNESS_COMMANDS))
    table, lacking = extraction.tabulate_extraction(measurements), dict[str, Sequence[str]]()
    parts += [] if table is None else [table]
    if depth is None:
        lacking["depth.json"] = _DEPTH_COMMANDS
    if not any(g.pooled and not g.trained for g in measurements.baseline):
        lacking["comparison/"] = _BASELINE_COMMANDS
    if lacking:
        rest = ", other rows" if table else ""
        title = f"Extraction with true depth, estimated depth and learned inverse dynamics{rest}"
        needs = f"{' and '.join(lacking)} among the arguments"
        commands = tuple(command for own in lacking.values() for command in own)
        parts.append(MissingPart(title=title, needs=needs, commands=commands))
    maps = None if depth is None else extraction.draw_depth_maps(depth.relative_depth_error)
    if depth is not None:
        title = "Figure 5a: pose errors by quality of the depth"
        caption = "Errors with true depth, with the network's depth, and with that depth degraded."
        parts.append(extraction.draw_conditions(depth, "figure5a_depth_quality", title, caption))
    parts += [] if maps is None else [maps]
    if depth is None or maps is None:
        title = "Figure 5, pose errors by quality of the depth, and map of the depth error"
        parts.append(MissingPart(title=title, needs="depth.json among the arguments", commands=_DEPTH_COMMANDS))
    return parts


def _success_parts(data: PaperData) -> list[Part]:
    parts: list[Part] = [*tabulate_main(data.folders, data.episodes, data.seed)] if data.episodes else []
    models, _ = split_models(data.folders, data.episodes)
    for part, title in ROWS.items():
        if part.suite == scaling.SUITE:
            continue
        done = {m: {e.task for e in data.episodes if e.part == part and e.model == m} for m in models}
        absent = [m for m, tasks in done.items() if not tasks]
        commands = [data.command(part, model) for model in absent] if models else [data.command(part)]
        if absent or not models:
            needs = f"runs of {', '.join(absent) or 'any model'}"
            parts.append(_missing_runs(f"Table 1, row {title}", needs, commands))
        others = {m: [t for t in tasks_of(part) if t not in tasks] for m, tasks in done.items() if tasks}
        commands = [data.command(part, model, tasks=tasks) for model, tasks in others.items() if tasks]
        if commands:
            needs = "the tasks of the suite that a model did not run"
            parts.append(_missing_runs(f"Table 1, row {title}, other tasks", needs, commands))
    return parts


def _missing_runs(title: str, needs: str, commands: Sequence[str]) -> MissingPart:
    note = _SPEC_NOTE if any(" SPEC " in command for command in commands) else ""
    return MissingPart(title=title, needs=needs + note, commands=tuple(commands))


_SPEC_NOTE = "; SPEC is the model's own, of which results hold a hash only"


def _drop_parts(data: PaperData) -> list[Part]:
    parts: list[Part] = []
    episodes = [e for e in data.episodes if e.part.split in (transfer.SEEN, transfer.UNSEEN)]
    for (model, suite), own in group_by(episodes, lambda e: (e.model, e.part.suite)).items():
        paths = {e.folder for e in own}
        if names := differing_settings([f for f in data.folders if f.path in paths]):
            needs = f"runs on both splits with the same {' and '.join(names)}"
            command = data.command(SuitePart(suite=suite, split=transfer.UNSEEN), model)
            parts.append(MissingPart(title=f"Drop of {model} on suite {suite}", needs=needs, commands=(command,)))
            episodes = [e for e in episodes if (e.model, e.part.suite) != (model, suite)]
    drops = transfer.study_drops(episodes, _transfers(), data.seed)
    if drops:
        parts = [transfer.tabulate_drops(drops), *transfer.draw_drops(drops), *parts]
    wanted = sorted(transfer.missing_splits(episodes), key=lambda item: item[1])
    for part, group in groupby(wanted, key=lambda item: item[1]):
        models = [model for model, _ in group]
        tasks = _counterparts(part, [e.task for e in episodes if e.part.suite == part.suite])
        commands = tuple(data.command(part, model, tasks=tasks) for model in models)
        title = f"Drop of {', '.join(models)} on suite {part.suite}"
        parts.append(MissingPart(title=title, needs=f"runs on its split {part.split}", commands=commands))
    if not parts:
        commands = tuple(data.command(SuitePart(suite=2, split=s)) for s in (transfer.SEEN, transfer.UNSEEN))
        needs = "a model's runs on both splits of suite 2"
        parts.append(MissingPart(title="Drop from seen to unseen", needs=needs, commands=commands))
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


def _study_parts(data: PaperData, predictor: correlation.Predictor, title: str, name: str) -> list[Part]:
    """Return figure and table of a metric against success."""
    study = correlation.study_correlation(data.episodes, predictor)
    figure = correlation.draw_correlation(data.episodes, study, data.seed) if data.episodes else None
    some = any(study.correlate(part)[0].mean is not None for part in (None, *(p.part for p in study.points)))
    parts: list[Part] = [] if figure is None else [replace(figure, name=name, title=title)]
    if some:
        return [*parts, correlation.tabulate_correlation(study, data.seed)]
    part = next(iter(sorted(e.part for e in data.episodes)), SuitePart(suite=0, split="test"))
    needs = f"{correlation.MIN_POINTS} models or runs on the same tasks that differ in the metric and in success"
    label = "Figure and rank correlation" if figure is None else "Rank correlation"
    return [*parts, MissingPart(title=f"{label}, {title}", needs=needs, commands=(data.command(part),))]


def _sparc_parts(data: PaperData) -> list[Part]:
    return _study_parts(data, correlation.SPARC, "Figure 6: SPARC and success", "figure6_sparc_success")


def _manipulability_parts(data: PaperData) -> list[Part]:
    figure = kinematics.draw_manipulability(data.episodes) if data.episodes else None
    title = "Figure 7: manipulability cost by suite and model"
    command = data.command(SuitePart(suite=0, split="test"))
    violins: Part = (
        MissingPart(title=title, needs="two episodes with a cost", commands=(command,))
        if figure is None
        else replace(figure, name="figure7_manipulability", title=title)
    )
    against = "Manipulability cost and success"
    return [violins, *_study_parts(data, correlation.MANIPULABILITY, against, "manipulability_success")]


def _scaling_parts(data: PaperData) -> list[Part]:
    difficulties, part = scaling.task_difficulties(), SuitePart(suite=scaling.SUITE, split="test")
    studies = scaling.study_scaling(data.folders, data.episodes, difficulties, data.seed)
    parts: list[Part] = [scaling.tabulate_scaling(studies)] if studies else []
    for number, study in enumerate(studies, 1):
        figure = scaling.draw_scaling(study, "scaling_curves" if len(studies) == 1 else f"scaling_{number}_curves")
        parts += [figure] if figure else []
        like = next((f for f in data.folders if scaling.budget_of(f) and study.model in f.models), None)
        done = {(budget.data, budget.steps) for budget in study.budgets}
        commands = [_scaling_command(data, part, like, *budget) for budget in _GRID if budget not in done]
        if commands:
            title = f"Scaling of {study.model}" + (", other trainings of the paper" if figure else "")
            needs = "runs of checkpoints trained on N demonstrations a task for N steps, tagged with both"
            parts.append(MissingPart(title=title, needs=needs, commands=tuple(commands)))
    for path in scaling.untagged(data.folders):
        needs = "the tags data=N and steps=N of its training: run it again with both"
        like = next(f for f in data.folders if f.path == path)
        command = run_command(part, like, data.folders, tags={**like.tags, "data": "N", "steps": "N"})
        parts.append(MissingPart(title=f"{like.name} in the scaling table", needs=needs, commands=(command,)))
    if not parts:
        needs = "runs on suite 3 of one model after several trainings, tagged with both"
        commands = [_scaling_command(data, part, None, *budget) for budget in _GRID]
        parts.append(MissingPart(title="Scaling table and curves", needs=needs, commands=tuple(commands)))
    return parts


def _scaling_command(data: PaperData, part: SuitePart, like: RunFolder | None, count: int, steps: int) -> str:
    return run_command(part, like, data.folders, tags={"data": count, "steps": steps})
