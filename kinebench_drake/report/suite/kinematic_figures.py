"""Figures of kinematics: SPARC against success, manipulability, and of scaling."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kinebench_drake.io.figure import FAINT, new_figure, plain
from kinebench_drake.report.suite.correlation import SparcStudy
from kinebench_drake.report.suite.episode import EpisodeResult, group
from kinebench_drake.report.suite.folders import model_of, models_of
from kinebench_drake.report.suite.picture import COLOURS, ReportFigure, legend, numbers, style
from kinebench_drake.report.suite.scaling import Scaling, TrainingBudget
from kinebench_drake.report.suite.tally import tally
from kinebench_drake.results.aggregate import Estimate


def sparc_picture(episodes: Sequence[EpisodeResult], study: SparcStudy, seed: int = 0) -> ReportFigure | None:
    """SPARC against success, a point a model and task, and beside it the task-balanced means; None without a point."""
    parts = sorted({e.part for e in episodes})
    own_names = {e.model: model_of(e.row) for e in episodes}
    shown = {model: model if len(own_names) <= len(COLOURS) else name for model, name in own_names.items()}
    models = list(dict.fromkeys(shown.values()))
    points = []
    for (part, model, _), own in group(episodes, lambda e: (e.part, e.model, e.task)).items():
        sparc, success = tally(own).sparc.mean, tally(own).pooled.mean
        if sparc is not None and success is not None:
            points.append((part, shown[model], sparc, success))
    if not points:
        return None
    figure, axes = new_figure(9.2, 4.2, 1, 2)
    left, right = axes[0]
    for part, model, sparc, success in points:
        left.scatter(sparc, success, **_look(models.index(model), parts.index(part)), s=20, alpha=0.7)
    left.set_ylim(-0.04, 1.04)
    left.set_ylabel("success of a task", fontsize=9)
    left.set_xlabel("mean SPARC of a task (nearer 0 is smoother)", fontsize=9)
    right.set_xlabel("task-balanced mean SPARC", fontsize=9)
    right.set_ylabel("success, standardised within tasks [sd]", fontsize=9)
    right.axhline(0.0, color=FAINT, linewidth=1.0)
    for point in study.points:
        right.scatter(
            point.sparc, point.success, **_look(models.index(shown[point.model]), parts.index(point.part)), s=42
        )
    rho = study.correlation(None, seed)
    right.set_title(_told(rho.rho, rho.low, rho.high) if study.points else "needs two models on a task", fontsize=9)
    for ax in (left, right):
        ax.tick_params(labelsize=8)
    for model in dict.fromkeys(m for _, m, *_ in points):
        colour = style(models.index(model))[0]
        left.plot([], [], linestyle="", marker="o", color=colour, markersize=5, label=plain(model))
    if len(parts) > 1:
        for k, part in enumerate(parts):
            left.plot([], [], linestyle="", marker=style(k)[1], color=FAINT, markersize=5, label=plain(part.title))
    legend(figure, models)
    return ReportFigure(
        name="sparc_success",
        title="SPARC and success",
        caption="Left: a point is a model on a task. Right: a point is a model on a suite, its success standardised "
        "within tasks, so that hard tasks do not stand for bad models. Rho: Spearman's rank correlation of the right "
        "points with its 95 % bootstrap interval over tasks.",
        figure=figure,
    )


def manipulability_picture(episodes: Sequence[EpisodeResult]) -> ReportFigure | None:
    """Violins of the scaled manipulability cost by part and model; None where nothing was scaled."""
    scaled = [e for e in episodes if e.cost_scaled is not None]
    if not scaled:
        return None
    models, parts = models_of(scaled), sorted({e.part for e in scaled})
    crowded = len(models) > len(COLOURS)
    widths = [len(models_of([e for e in scaled if e.part == p])) for p in parts]
    figure, axes = new_figure(
        max(6.4, 1.6 + (0.4 if crowded else 0.8) * sum(widths)),
        5.8 if crowded else 4.4,
        1,
        len(parts),
        sharey=True,
        gridspec_kw={"width_ratios": widths},
    )
    for ax, part in zip(axes[0], parts, strict=True):
        here = [m for m in models if any(e.part == part and e.model == m for e in scaled)]
        number = numbers(models, here)
        for k, model in enumerate(here):
            costs = [e.cost_scaled for e in scaled if e.part == part and e.model == model and e.cost_scaled is not None]
            colour = style(number[model])[0]
            if len(costs) > 1 and np.ptp(costs) > 0:
                for body in ax.violinplot(costs, [k], widths=0.8, showextrema=False)["bodies"]:
                    body.set(facecolor=colour, edgecolor=colour, alpha=0.35)
            low, middle, high = np.percentile(costs, [25, 50, 75])
            ax.plot([k, k], [low, high], color=colour, linewidth=3.2, solid_capstyle="butt")
            ax.plot([k], [middle], marker="o", color="white", markeredgecolor=colour, markersize=5)
        told = [plain(n) for n in here] if crowded else []
        ax.set_xticks(range(len(told)), told, fontsize=8, rotation=90)
        ax.set_xlim(-0.6, len(here) - 0.4)
        ax.set_title(plain(part.title), fontsize=9)
        ax.tick_params(axis="y", labelsize=8)
    for model in () if crowded else models:
        axes[0, 0].plot([], [], color=style(models.index(model))[0], linewidth=5.0, alpha=0.6, label=plain(model))
    axes[0, 0].set_ylabel("manipulability cost, scaled", fontsize=9)
    if not crowded:
        legend(figure, models)
    return ReportFigure(
        name="manipulability",
        title="Manipulability cost by suite and model",
        caption="Distribution over episodes of the mean manipulability cost (lower is better), on a scale on which 0 "
        "is the 10th and 1 the 90th percentile of all episodes in this report; bars from the first to the third "
        "quartile, dots at the median.",
        figure=figure,
    )


def scaling_picture(study: Scaling, name: str) -> ReportFigure | None:
    """Success against demonstrations and against steps, by difficulty; None unless one of them was varied."""
    trainings = study.trainings
    axes_told: list[tuple[str, Callable[[TrainingBudget], int], Callable[[TrainingBudget], int], str]] = []
    if _varies(trainings, lambda t: t.data, lambda t: t.steps):
        axes_told.append(("demonstrations a task", lambda t: t.data, lambda t: t.steps, "{:,} steps"))
    if _varies(trainings, lambda t: t.steps, lambda t: t.data):
        axes_told.append(("optimisation steps", lambda t: t.steps, lambda t: t.data, "{:,} demonstrations"))
    if not axes_told:
        return None
    figure, axes = new_figure(
        2.5 * len(study.levels) + 1.6, 0.5 + 2.6 * len(axes_told), len(axes_told), len(study.levels), sharey=True
    )
    for row, (label, along, across, pattern) in zip(axes, axes_told, strict=True):
        for ax, level in zip(row, study.levels, strict=True):
            values = sorted({across(t) for t in trainings})
            for k, value in enumerate(values):
                line = sorted((t for t in trainings if across(t) == value and (t, level) in study.success), key=along)
                if line:
                    aside = 1.03 ** (
                        k - 0.5 * (len(values) - 1)
                    )  # lines side by side, where they would hide each other
                    _curve(
                        ax,
                        [along(t) * aside for t in line],
                        [study.success[t, level] for t in line],
                        k,
                        pattern.format(value),
                    )
            ticks = sorted({along(t) for t in trainings})
            ax.set_xscale("log")
            ax.set_xticks(ticks, [f"{tick:,}" for tick in ticks], fontsize=7)
            ax.minorticks_off()
            ax.margins(x=0.12)
            ax.set_ylim(-0.04, 1.04)
            ax.tick_params(axis="y", labelsize=8)
            ax.set_title(level, fontsize=9)
            ax.set_xlabel(label, fontsize=8)
        row[0].set_ylabel("success", fontsize=9)
        row[-1].legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ReportFigure(
        name=name,
        title=f"Scaling of {study.model} by difficulty of the tasks",
        caption="Suite 3: mean success over the tasks of a difficulty, with 95 % bootstrap intervals over episodes "
        "within tasks; above against demonstrations, below against optimisation steps, where both were varied.",
        figure=figure,
    )


def _curve(ax: Any, x: Sequence[float], estimates: Sequence[Estimate], index: int, label: str) -> None:
    colour, marker = style(index)
    known = [(at, e) for at, e in zip(x, estimates, strict=True) if e.mean is not None]
    ax.plot([a for a, _ in known], [e.mean for _, e in known], color=colour, marker=marker, markersize=4, label=label)
    for at, e in known:
        if e.low is not None and e.high is not None:
            ax.plot([at, at], [e.low, e.high], color=colour, linewidth=1.0, alpha=0.7)


def _varies(
    trainings: Sequence[TrainingBudget], along: Callable[[TrainingBudget], int], across: Callable[[TrainingBudget], int]
) -> bool:
    """Whether there are two values of one with the same value of the other."""
    return any(len({along(t) for t in trainings if across(t) == value}) > 1 for value in {across(t) for t in trainings})


def _look(model: int, part: int) -> dict[str, Any]:
    return {"color": style(model)[0], "marker": style(part)[1], "linewidths": 0}


def _told(rho: float | None, low: float | None, high: float | None) -> str:
    if rho is None:
        return "rho needs three models"
    return f"Spearman's rho {rho:.2f}" + ("" if low is None else f" [{low:.2f}, {high:.2f}]")
