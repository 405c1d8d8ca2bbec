"""Success of models on suites: counts of episodes, tables and figures."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinebench_drake.io.figure import new_figure, shorten
from kinebench_drake.metrics.executable import FailureVerdict
from kinebench_drake.report.figures import (
    COLOURS,
    NEUTRAL,
    VERDICT_COLOURS,
    ReportFigure,
    add_legend,
    assign_numbers,
    draw_intervals,
    label_shares,
    make_figure,
)
from kinebench_drake.report.table import Column, Table, Value, make_table
from kinebench_drake.results.aggregate import Estimate, estimate, estimate_passes, group_by
from kinebench_drake.results.row import Status
from kinebench_drake.suites.report.episode_result import (
    EpisodeResult,
    SuitePart,
    executable_share,
    group_by_run,
    has_samples,
    list_models,
    mean_over_tasks,
    worst_metric,
)

FAILURE_CAUSES = tuple(cause.value for cause in FailureVerdict)
"""Causes of failure, in causal order (see docs/formats.md)."""
UNDECIDED = "undecided"
"""Failures without a recorded cause."""
_NOT_MEASURED = "not measured"


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
    means: Mapping[str, Estimate]
    """Means over tasks of progress 0..1, rounds (clips requested), SPARC and scaled manipulability cost 0..1."""
    verdicts: Mapping[str, int]
    """Measured failures by verdict, UNDECIDED included."""
    passes: Mapping[int, Estimate]
    """pass@k by k, pooled over tasks; empty with one sample an episode."""


def tally(episodes: Sequence[EpisodeResult], among: Sequence[EpisodeResult] | None = None) -> Tally:
    """Count a group of episodes; every task has the same weight in the means.

    Args:
        among: all episodes of the report, whose worst values bound the means; None if they are the group.
    """
    every = among or episodes
    outcomes = [e.success for e in episodes]
    measured = [o for o in outcomes if o is not None]
    runs = [(e.part, e.model, e.row.episode) for e in episodes]
    errors = sum(e.row.status is Status.ERROR for e in episodes)
    failures = Counter(e.verdict or UNDECIDED for e in episodes if e.success is False)
    verdicts = {name: failures.pop(name, 0) for name in FAILURE_CAUSES}
    return Tally(
        episodes=len(episodes),
        tasks=len({e.task for e in episodes if e.success is not None}),
        measured=len(measured),
        errors=errors,
        unmeasurable=len(episodes) - len(measured) - errors,
        executable=executable_share(episodes, every),
        pooled=estimate(outcomes, total=len(episodes), episodes=runs),
        counted=estimate([o is True for o in outcomes], total=len(episodes), episodes=runs),
        success=mean_over_tasks(episodes, lambda e: e.hit, 0.0),
        means={
            "progress": mean_over_tasks(episodes, lambda e: e.progress, 0.0),
            "rounds": mean_over_tasks(
                episodes, lambda e: e.rounds, max((e.rounds or 0.0 for e in every), default=None)
            ),
            "sparc": mean_over_tasks(episodes, lambda e: e.metric("sparc"), worst_metric("sparc", every)),
            "manipulability_cost_scaled": mean_over_tasks(episodes, lambda e: e.cost_scaled, 1.0),
        },
        verdicts={**verdicts, UNDECIDED: sum(failures.values())},
        passes=estimate_passes([e.row for e in episodes]) if has_samples(episodes) else {},
    )


def tabulate_suites(episodes: Sequence[EpisodeResult]) -> Table:
    """Build the table of task-balanced success of every model (rows) on every part (columns).

    The best models of each part are bold, see `best_models`.
    """
    parts = sorted({e.part for e in episodes})
    models = list_models(episodes)
    tallies = tally_runs(episodes)
    executable = {m: executable_share(own, episodes) for m, own in group_by(episodes, lambda e: e.model).items()}
    return make_table(
        "suites",
        ({"model": m} for m in models),
        more=[
            *(
                (
                    Column(key=part.slug, label=part.title, pattern="{:.1%}", estimated=True),
                    [t.success if (t := tallies.get((m, part))) else None for m in models],
                )
                for part in parts
            ),
            (
                Column(key="executable", label="Executable", pattern="{:.1%}", estimated=True),
                [executable[m] for m in models],
            ),
        ],
        note=incomplete_note(tallies, episodes) + sample_note(episodes),
        bold=((models.index(m), part.slug) for part in parts for m in best_models(tallies, part)),
    )


def tally_runs(episodes: Sequence[EpisodeResult]) -> dict[tuple[str, SuitePart], Tally]:
    """Count the episodes of every model on every part."""
    return {key: tally(own, episodes) for key, own in group_by(episodes, lambda e: (e.model, e.part)).items()}


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


def sample_note(episodes: Sequence[EpisodeResult]) -> str:
    """Return how several samples of an episode enter a table; empty of single samples."""
    if not has_samples(episodes):
        return ""
    return (
        " Of episodes with several samples the counts are of samples. In means and shares each episode counts the "
        "same; intervals are over episodes (of shares Wilson's where all samples of each episode agree)."
    )


def tabulate_summary(episodes: Sequence[EpisodeResult]) -> Table:
    """Build the table of all counts, a row per part and model."""
    samples = _most_samples(episodes)
    lines = ((part, model, tally(own, episodes)) for part, model, own in group_by_run(episodes))
    rows = [{"part": part.title, "model": model, "tasks": t.tasks, **_cells(t, samples)} for part, model, t in lines]
    return make_table("summary", rows, note=sample_note(episodes), samples=samples)


def tabulate_tasks(episodes: Sequence[EpisodeResult]) -> Table:
    """Build the table of all counts, a row per part, task and model."""
    samples = _most_samples(episodes)
    groups = group_by(episodes, lambda e: (e.part, e.task, e.model)).items()
    lines = ((key, tally(own, episodes)) for key, own in sorted(groups, key=lambda item: item[0][:2]))
    rows = [
        {"part": part.title, "task": task, "model": model, **_cells(t, samples), "success": t.pooled}
        for (part, task, model), t in lines
    ]
    return make_table("tasks", rows, note=sample_note(episodes), samples=samples)


def _cells(t: Tally, samples: int) -> dict[str, Value]:
    return {
        **{"executable": t.executable, "success": t.success, "success_pooled": t.pooled, "success_all": t.counted},
        **({f"pass_at_{samples}": t.passes.get(samples)} if samples > 1 else {}),
        **t.means,
        **{"measured": t.measured, "episodes": t.episodes, "unmeasurable": t.unmeasurable, "errors": t.errors},
        **{f"failed_{name.replace(' ', '_')}": n for name, n in t.verdicts.items()},
    }


def _most_samples(episodes: Sequence[EpisodeResult]) -> int:
    """Return the greatest number of samples of an episode."""
    return 1 + max((e.row.sample_index for e in episodes), default=0)


def draw_success(episodes: Sequence[EpisodeResult]) -> list[ReportFigure]:
    """Draw success by task and model, one figure per part."""
    models = list_models(episodes)
    figures = []
    interval = "95 % interval over episodes" if has_samples(episodes) else "95 % Wilson interval"
    for part, own in sorted(group_by(episodes, lambda e: e.part).items()):
        tasks = sorted({e.task for e in own}, reverse=True)
        here = [m for m in models if any(e.model == m for e in own)]
        rates = {key: tally(some).pooled for key, some in group_by(own, lambda e: (e.model, e.task)).items()}
        by_model = {m: [(task, rate) for (model, task), rate in rates.items() if model == m] for m in here}
        figure = draw_intervals(tasks, by_model, assign_numbers(models, here), f"success, {interval}")
        figures.append(make_figure("success", figure, part=part, intervals=interval.replace("interval", "intervals")))
    return figures


def draw_verdicts(episodes: Sequence[EpisodeResult]) -> ReportFigure:
    """Draw the outcomes of all episodes of every model on every part as stacked bars."""
    runs = group_by_run(episodes)
    colours = {name: VERDICT_COLOURS[name] for name in ("success", *FAILURE_CAUSES)}
    colours |= {UNDECIDED: COLOURS[8], _NOT_MEASURED: NEUTRAL}
    tallies = [tally(own) for *_, own in runs]
    counts = [
        {**t.verdicts, "success": t.measured - sum(t.verdicts.values()), _NOT_MEASURED: t.unmeasurable + t.errors}
        for t in tallies
    ]
    shares = {name: [n[name] / t.episodes for n, t in zip(counts, tallies, strict=True)] for name in colours}
    figure, axes = new_figure(7.2, 1.3 + 0.36 * len(runs))
    ax = axes[0, 0]
    places = [len(runs) - 1 - k for k in range(len(runs))]
    left = np.zeros(len(runs))
    for name, colour in colours.items():
        if any(shares[name]):
            ax.barh(places, shares[name], 0.68, left, color=colour, edgecolor="white", linewidth=0.6, label=name)
            left += shares[name]
    label_shares(ax, [f"{part.title} · {shorten(model)}" for part, model, _ in reversed(runs)], "share of all episodes")
    add_legend(figure, list(colours))
    return make_figure("verdicts", figure)
