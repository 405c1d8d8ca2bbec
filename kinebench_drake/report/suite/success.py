"""Success of models on suites: counts of episodes, tables and figures."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinebench_drake.io.figure import new_figure, plain, shorten
from kinebench_drake.metrics.executable import FailureVerdict
from kinebench_drake.report.figures import (
    COLOURS,
    NEUTRAL,
    SUCCESS,
    ReportFigure,
    add_legend,
    assign_numbers,
    draw_interval,
    label_shares,
    style,
)
from kinebench_drake.report.suite.episode import (
    EXECUTABLE_COLUMN,
    EpisodeResult,
    SuitePart,
    executable_share,
    group_by,
    group_by_run,
    has_samples,
    list_models,
    mean_over_tasks,
    worst_metric,
)
from kinebench_drake.report.table import Column, Table, Value, plain_columns
from kinebench_drake.results.aggregate import Estimate, estimate, estimate_passes
from kinebench_drake.results.row import Status

FAILURE_CAUSES = tuple(cause.value for cause in FailureVerdict)
"""Causes of failure, in causal order (see docs/formats.md)."""
NO_VERDICT = "no verdict"
"""Failures without a recorded cause."""
_NOT_MEASURED = "not measured"
_MAX_MODELS = 8
"""Models up to which success is drawn as points with intervals; more are drawn as a heat map."""
_PERCENT = "{:.1%}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """Numbers of a group of episodes."""

    episodes: int
    """All episodes."""
    tasks: int
    """Tasks with a measured episode."""
    measured: int
    """Episodes that ended as a success or a failure."""
    unmeasurable: int
    """Episodes with status unmeasurable, or without `success`: neither success nor failure."""
    errors: int
    """Episodes with status error."""
    executable: Estimate | None
    """Share of executable episodes among all, mean over tasks; None if none has a verdict."""
    pooled: Estimate
    """Share of successes among the measured, with Wilson's interval; of several samples, mean over episodes."""
    counted: Estimate
    """Share of successes among all, unmeasured ones counted as failures."""
    success: Estimate
    """Success, mean over tasks with a bootstrap interval."""
    means: tuple[Estimate, ...]
    """Means over tasks of progress 0..1, clips requested, SPARC and scaled manipulability cost 0..1."""
    verdicts: Mapping[str, int]
    """Measured failures by verdict, NO_VERDICT included."""
    passes: Mapping[int, Estimate]
    """pass@k by k, pooled over tasks; empty with one sample an episode."""


def tally(episodes: Sequence[EpisodeResult], seed: int = 0, among: Sequence[EpisodeResult] | None = None) -> Tally:
    """Count a group of episodes; every task has the same weight in the means.

    Args:
        episodes: the group.
        seed: seed of the resampling.
        among: all episodes of the report, whose worst values bound the means; None if they are the group.
    """
    every = among or episodes
    outcomes = [e.success for e in episodes]
    measured = [o for o in outcomes if o is not None]
    runs = [(e.part, e.model, e.row.episode) for e in episodes]
    errors = sum(e.row.status is Status.ERROR for e in episodes)
    failures = Counter(e.verdict or NO_VERDICT for e in episodes if e.success is False)
    verdicts = {name: failures.pop(name, 0) for name in FAILURE_CAUSES}
    return Tally(
        episodes=len(episodes),
        tasks=len({e.task for e in episodes if e.success is not None}),
        measured=len(measured),
        errors=errors,
        unmeasurable=len(episodes) - len(measured) - errors,
        executable=executable_share(episodes, seed, every),
        pooled=estimate(outcomes, total=len(episodes), seed=seed, episodes=runs),
        counted=estimate([o is True for o in outcomes], total=len(episodes), seed=seed, episodes=runs),
        success=mean_over_tasks(episodes, lambda e: e.hit, seed, 0.0),
        means=(
            mean_over_tasks(episodes, lambda e: e.progress, seed, 0.0),
            mean_over_tasks(episodes, lambda e: e.rounds, seed, max((e.rounds or 0.0 for e in every), default=None)),
            mean_over_tasks(episodes, lambda e: e.metric("sparc"), seed, worst_metric("sparc", every)),
            mean_over_tasks(episodes, lambda e: e.cost_scaled, seed, 1.0),
        ),
        verdicts={**verdicts, NO_VERDICT: sum(failures.values())},
        passes=estimate_passes([e.row for e in episodes], seed) if has_samples(episodes) else {},
    )


COST_COLUMN = Column(
    key="manipulability_cost_scaled", label="Manipulability cost, scaled", pattern="{:.2f}", estimated=True,
    meaning="0 at the 10th percentile of all episodes here, 1 at the 90th; lower is better",
)  # fmt: skip
_TALLY = (
    Column(key="progress", label="Progress", pattern=_PERCENT, estimated=True, meaning="share of the steps completed"),
    Column(key="rounds", label="Rounds", pattern="{:.2f}", estimated=True, meaning="clips requested from the model"),
    Column(key="sparc", label="SPARC", pattern="{:.2f}", estimated=True, meaning="nearer 0 is smoother"),
    COST_COLUMN,
    Column(key="measured", label="Measured", meaning="episodes that ended as a success or as a failure"),
    Column(key="episodes", label="Episodes"),
    Column(key="unmeasurable", label="Unmeasurable", meaning="neither success nor failure"),
    Column(key="errors", label="Errors", meaning="neither success nor failure"),
    Column(
        key="success_all", label="Success, unmeasured as failures", pattern=_PERCENT, estimated=True,
        meaning="share of all episodes, with Wilson's interval",
    ),
    *(Column(key=f"failed_{name}", label=f"Failed: {name}") for name in FAILURE_CAUSES),
    Column(key="failed_no_verdict", label=f"Failed: {NO_VERDICT}"),
)  # fmt: skip


def _pass_columns(episodes: Sequence[EpisodeResult]) -> tuple[list[Column], Callable[[Tally], list[Value]]]:
    """Return the column of pass@k for the most samples of an episode, and its cell; none of single samples."""
    most = 1 + max((e.row.sample_index for e in episodes), default=0)
    if most == 1:
        return [], lambda t: []
    meaning = f"share of episodes in which one of {most} samples succeeds; every episode counts the same"
    column = Column(key=f"pass_at_{most}", label=f"pass@{most}", pattern=_PERCENT, estimated=True, meaning=meaning)
    return [column], lambda t: [t.passes.get(most)]


def sample_note(episodes: Sequence[EpisodeResult]) -> str:
    """Return how several samples of an episode enter a table; empty of single samples."""
    if not has_samples(episodes):
        return ""
    return (
        " Of episodes with several samples the counts are of samples. In means and shares each episode counts the "
        "same; intervals are over episodes (of shares Wilson's where all samples of each episode agree)."
    )


def _tally_cells(t: Tally) -> list[Value]:
    return [*t.means, t.measured, t.episodes, t.unmeasurable, t.errors, t.counted, *t.verdicts.values()]


def tabulate_suites(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """Build the table of task-balanced success of every model (rows) on every part (columns).

    The best models of each part are bold, see `best_models`.
    """
    parts, models = sorted({e.part for e in episodes}), list_models(episodes)
    tallies = {key: tally(own, seed, episodes) for key, own in group_by(episodes, lambda e: (e.model, e.part)).items()}
    executable = {m: executable_share(own, seed, episodes) for m, own in group_by(episodes, lambda e: e.model).items()}
    rows = [
        tuple[Value, ...]([m, executable[m], *(t.success if (t := tallies.get((m, p))) else None for p in parts)])
        for m in models
    ]
    return Table(
        name="suites",
        title="Closed-loop success by suite",
        note="Executable: share of all its episodes whose generated videos a robot can execute as a whole. "
        "Otherwise mean over tasks of the share of successes among measured episodes; 95 % bootstrap intervals over "
        "episodes within tasks. A dash: no measured episode."
        + incomplete_note(tallies, episodes)
        + sample_note(episodes),
        columns=(
            Column(key="model", label="Model"),
            EXECUTABLE_COLUMN,
            *(Column(key=p.slug, label=p.title, pattern=_PERCENT, estimated=True) for p in parts),
        ),
        rows=tuple(rows),
        bold=frozenset((models.index(m), k + 2) for k, part in enumerate(parts) for m in best_models(tallies, part)),
    )


def best_models(tallies: Mapping[tuple[str, SuitePart], Tally], part: SuitePart) -> set[str]:
    """Return the models of the greatest success, unmeasured episodes counted as failures, if not all have the same.

    Only models that did the most tasks of the part are candidates.
    """
    own = {model: t for (model, at), t in tallies.items() if at == part and t.success.mean is not None}
    most = max((t.tasks for t in own.values()), default=0)
    bounds = {model: t.success.bound for model, t in own.items() if t.tasks == most}
    best = max((b for b in bounds.values() if b is not None), default=None)
    return {model for model, b in bounds.items() if b == best} if len({*bounds.values()}) > 1 else set()


def incomplete_note(tallies: Mapping[tuple[str, SuitePart], Tally], episodes: Sequence[EpisodeResult]) -> str:
    """Name the means over fewer tasks than others of their part, which are not comparable with these."""
    notes = []
    for part, own in sorted(group_by(episodes, lambda e: e.part).items()):
        tasks = len({e.task for e in own})
        notes += [
            f"{model} did {t.tasks} of {tasks} tasks of {part.title}"
            for (model, at), t in tallies.items()
            if at == part and t.tasks < tasks
        ]
    return f" Not over the same tasks: {'; '.join(notes)}." if notes else ""


def tabulate_summary(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """Build the table of all counts, a row per part and model."""
    columns, cells = _pass_columns(episodes)
    return Table(
        name="summary",
        title="Each suite and model in numbers",
        note="Every task counts the same in success, progress, rounds, SPARC and cost (95 % bootstrap intervals over "
        "episodes within tasks); pooled success counts every episode the same (95 % Wilson intervals). Episodes that "
        "could not be measured are no failures: the last rate shows what they would make of it if they were."
        + sample_note(episodes),
        columns=(
            *plain_columns(part="Suite", model="Model", tasks="Tasks"),
            EXECUTABLE_COLUMN,
            Column(key="success", label="Success", pattern=_PERCENT, estimated=True, meaning="mean over tasks"),
            Column(key="success_pooled", label="Success, pooled", pattern=_PERCENT, estimated=True),
            *columns,
            *_TALLY,
        ),
        rows=tuple(
            (part.title, model, t.tasks, t.executable, t.success, t.pooled, *cells(t), *_tally_cells(t))
            for part, model, own in group_by_run(episodes)
            for t in [tally(own, seed, episodes)]
        ),
    )


def tabulate_tasks(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """Build the table of all counts, a row per part, task and model."""
    groups = group_by(episodes, lambda e: (e.part, e.task, e.model)).items()
    columns, cells = _pass_columns(episodes)
    return Table(
        name="tasks",
        title="Each task",
        note="Success with 95 % Wilson intervals, the other means with 95 % bootstrap intervals over episodes."
        + sample_note(episodes),
        columns=(
            *plain_columns(part="Suite", task="Task", model="Model"),
            EXECUTABLE_COLUMN,
            Column(key="success", label="Success", pattern=_PERCENT, estimated=True),
            *columns,
            *_TALLY,
        ),
        rows=tuple(
            (part.title, task, model, t.executable, t.pooled, *cells(t), *_tally_cells(t))
            for (part, task, model), own in sorted(groups, key=lambda item: item[0][:2])
            for t in [tally(own, seed, episodes)]
        ),
        latex=False,
    )


def draw_success(episodes: Sequence[EpisodeResult]) -> list[ReportFigure]:
    """Draw success by task and model, one figure per part."""
    models, figures = list_models(episodes), []
    interval = ("95 % Wilson interval", "95 % interval over episodes")[has_samples(episodes)]
    for part, own in sorted(group_by(episodes, lambda e: e.part).items()):
        tasks, here = sorted({e.task for e in own}, reverse=True), [m for m in models if any(e.model == m for e in own)]
        caption = "Share of successes among measured episodes"
        if len(here) > _MAX_MODELS:
            figure = _draw_map(own, tasks, here)
            caption += " [%]; the table of tasks has the intervals."
        else:
            figure, axes = new_figure(7.2, 1.3 + len(tasks) * max(0.3, 0.1 + 0.1 * len(here)))
            ax = axes[0, 0]
            numbers = assign_numbers(models, here)
            for k, model in enumerate(here):
                colour, marker = style(numbers[model])
                offset = 0.62 * (0.5 - (k + 0.5) / len(here))
                for task, some in group_by([e for e in own if e.model == model], lambda e: e.task).items():
                    draw_interval(ax, tally(some).pooled, tasks.index(task) + offset, colour, marker)
                ax.plot([], [], color=colour, marker=marker, markersize=4, linewidth=1.2, label=plain(shorten(model)))
            label_shares(ax, tasks, f"success, {interval}")
            add_legend(figure, here)
            caption += f", with {interval.replace('interval', 'intervals')}."
        name, title = f"success_{part.slug}", f"{part.title}: success by task"
        figures.append(ReportFigure(name=name, title=title, caption=caption, figure=figure))
    return figures


def _draw_map(episodes: Sequence[EpisodeResult], tasks: Sequence[str], models: Sequence[str]) -> Any:
    """Draw success by task (rows, bottom to top) and model (columns) as a heat map with numbers."""
    rates = {key: tally(own).pooled.mean for key, own in group_by(episodes, lambda e: (e.task, e.model)).items()}
    shades = np.array([[np.nan if (r := rates.get((t, m))) is None else r for m in models] for t in tasks])
    figure, axes = new_figure(2.2 + 0.42 * len(models), 2.6 + 0.26 * len(tasks))
    ax = axes[0, 0]
    ax.grid(False)
    ax.pcolormesh(
        np.arange(len(models) + 1) - 0.5, np.arange(len(tasks) + 1) - 0.5, shades, cmap="Blues", vmin=0, vmax=1.3
    )
    for (row, column), rate in np.ndenumerate(shades):
        if np.isfinite(rate):
            colour = "#fefefe" if rate > 0.7 else "#101010"
            ax.text(column, row, f"{100.0 * rate:.0f}", ha="center", va="center", fontsize=7, color=colour)
    ax.set_yticks(range(len(tasks)), [plain(n) for n in tasks], fontsize=8)
    ax.set_xticks(range(len(models)), [plain(shorten(n)) for n in models], fontsize=8, rotation=90)
    return figure


def draw_verdicts(episodes: Sequence[EpisodeResult]) -> ReportFigure:
    """Draw the outcomes of all episodes of every model on every part as stacked bars."""
    runs = group_by_run(episodes)
    colours = {
        "success": SUCCESS,
        **dict(zip(FAILURE_CAUSES, (COLOURS[4], COLOURS[1], COLOURS[3], COLOURS[5]), strict=True)),
        NO_VERDICT: COLOURS[8],
        _NOT_MEASURED: NEUTRAL,
    }
    counts = [
        {"success": sum(e.success is True for e in own), **t.verdicts, _NOT_MEASURED: t.unmeasurable + t.errors}
        for *_, own in runs
        for t in [tally(own)]
    ]
    figure, axes = new_figure(7.2, 1.3 + 0.36 * len(runs))
    ax = axes[0, 0]
    left = [0.0] * len(runs)
    for name, colour in colours.items():
        widths = [count[name] / len(own) for count, (*_, own) in zip(counts, runs, strict=True)]
        if any(widths):
            places = [len(runs) - 1 - k for k in range(len(runs))]
            ax.barh(places, widths, left=left, color=colour, height=0.68, label=name, edgecolor="white", linewidth=0.6)
            left = [a + b for a, b in zip(left, widths, strict=True)]
    label_shares(ax, [f"{part.title} · {shorten(model)}" for part, model, _ in reversed(runs)], "share of all episodes")
    add_legend(figure, list(colours))
    return ReportFigure(
        name="verdicts",
        title="Outcomes of the episodes",
        caption="Shares of all episodes: successes; failures by verdict (grounding: the gripper was not read; "
        "generation: the video shows what no robot does; execution: the executed gripper deviates from the generated "
        "one; task: none of these, and the goal was not reached); episodes that could not be measured.",
        figure=figure,
    )
