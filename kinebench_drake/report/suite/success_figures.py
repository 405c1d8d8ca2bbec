"""Figures of success, of verdicts and of differences."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kinebench_drake.io.figure import FAINT, new_figure, plain
from kinebench_drake.report.suite.comparison import ALL, Compared, difference_of
from kinebench_drake.report.suite.episode import EpisodePart, EpisodeResult, group
from kinebench_drake.report.suite.folders import models_of
from kinebench_drake.report.suite.picture import COLOURS, GOOD, NEUTRAL, ReportFigure, legend, numbers, style
from kinebench_drake.report.suite.tally import NO_VERDICT, VERDICTS, Tally, tally

_NOT_MEASURED = "not measured"
_CROWD = 8
"""More models than that are not to be told apart as lines: they are shown as a map."""

_LONG = 170
"""More differences than that make no figure to look at: tasks are left to the table."""


def success_pictures(episodes: Sequence[EpisodeResult]) -> list[ReportFigure]:
    """Success by task and model, one picture a part."""
    models = models_of(episodes)
    pictures = []
    for part, own in sorted(group(episodes, lambda e: e.part).items()):
        tasks, here = sorted({e.task for e in own}, reverse=True), [m for m in models if any(e.model == m for e in own)]
        if len(here) > _CROWD:
            pictures.append(_map(part, own, tasks, here))
            continue
        figure, axes = new_figure(7.2, 1.3 + len(tasks) * max(0.3, 0.1 + 0.1 * len(here)))
        ax = axes[0, 0]
        number = numbers(models, here)
        for k, model in enumerate(here):
            colour, marker = style(number[model])
            offset = 0.62 * (0.5 - (k + 0.5) / len(here))
            rates = group([e for e in own if e.model == model], lambda e: e.task)
            for task, some in rates.items():
                rate = tally(some).pooled
                _interval(ax, rate.mean, rate.low, rate.high, tasks.index(task) + offset, colour, marker)
            ax.plot([], [], color=colour, marker=marker, markersize=4, linewidth=1.2, label=plain(model))
        ax.set_yticks(range(len(tasks)), [plain(n) for n in tasks], fontsize=8)
        ax.set_ylim(-0.6, len(tasks) - 0.4)
        _percent(ax)
        ax.set_xlabel("success, 95 % Wilson interval", fontsize=9)
        legend(figure, here)
        pictures.append(
            ReportFigure(
                name=f"success_{part.slug}",
                title=f"{part.title}: success by task",
                caption="Share of successes among measured episodes, with 95 % Wilson intervals.",
                figure=figure,
            )
        )
    return pictures


def _map(
    part: EpisodePart, episodes: Sequence[EpisodeResult], tasks: Sequence[str], models: Sequence[str]
) -> ReportFigure:
    """Success by task (rows, from below) and model (columns) as shades with their numbers."""
    rates = {key: tally(own).pooled.mean for key, own in group(episodes, lambda e: (e.task, e.model)).items()}
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
    ax.set_xticks(range(len(models)), [plain(n) for n in models], fontsize=8, rotation=90)
    return ReportFigure(
        name=f"success_{part.slug}",
        title=f"{part.title}: success by task",
        caption="Share of successes among measured episodes [%]; the intervals stand in the table of tasks.",
        figure=figure,
    )


def verdict_picture(episodes: Sequence[EpisodeResult]) -> ReportFigure:
    """What became of all episodes of every model on every part, as stacked bars."""
    groups = sorted(group(episodes, lambda e: (e.part, e.model)).items(), key=lambda item: item[0][0])
    colours = {
        "success": GOOD,
        **dict(zip(VERDICTS, (COLOURS[0], COLOURS[1], COLOURS[4], COLOURS[3]), strict=True)),
        NO_VERDICT: COLOURS[5],
        _NOT_MEASURED: NEUTRAL,
    }
    shares = [_shares(tally(own)) for _, own in groups]
    figure, axes = new_figure(7.2, 1.3 + 0.36 * len(groups))
    ax = axes[0, 0]
    left = [0.0] * len(groups)
    for name, colour in colours.items():
        widths = [share[name] for share in shares]
        if any(widths):
            places = [len(groups) - 1 - k for k in range(len(groups))]
            ax.barh(places, widths, left=left, color=colour, height=0.68, label=name, edgecolor="white", linewidth=0.6)
            left = [a + b for a, b in zip(left, widths, strict=True)]
    names = [f"{part.title} · {model}" for (part, model), _ in reversed(groups)]
    ax.set_yticks(range(len(groups)), [plain(n) for n in names], fontsize=8)
    _percent(ax)
    ax.set_xlabel("share of all episodes", fontsize=9)
    ax.set_ylim(-0.6, len(groups) - 0.4)
    legend(figure, list(colours))
    return ReportFigure(
        name="verdicts",
        title="What became of the episodes",
        caption="Shares of all episodes: successes, failures by verdict (grounding: not read; generation: the video "
        "shows what no robot does; execution: the robot was elsewhere than imagined; task: all of that fine, the goal "
        "not met), and what could not be measured.",
        figure=figure,
    )


def difference_picture(compared: Sequence[Compared]) -> ReportFigure:
    """Differences of success on shared episodes, with Newcombe's intervals."""
    known = [(c, d) for c in compared if (d := difference_of(c.paired)) is not None]
    if len(known) > _LONG:
        known = [(c, d) for c, d in known if c.task == ALL]
    figure, axes = new_figure(7.2, 1.2 + 0.27 * len(known))
    ax = axes[0, 0]
    for k, (c, d) in enumerate(reversed(known)):
        pooled = c.task == ALL
        _interval(ax, d.mean, d.low, d.high, float(k), "#000000" if pooled else COLOURS[0], "D" if pooled else "o")
    ax.axvline(0.0, color=FAINT, linewidth=1.2, zorder=1)
    names = [c.task if c.task != ALL else f"{c.first} − {c.second}, {c.part.title}" for c, _ in reversed(known)]
    ax.set_yticks(range(len(known)), [plain(n) for n in names], fontsize=8)
    for text, (c, _) in zip(ax.get_yticklabels(), reversed(known), strict=True):
        text.set_fontweight("bold" if c.task == ALL else "normal")
    ax.set_ylim(-0.6, len(known) - 0.4)
    _percent(ax, low=-1.0)
    ax.set_xlabel("difference of success on shared episodes", fontsize=9)
    return ReportFigure(
        name="differences",
        title="Differences of success",
        caption="The first model's success less the second's on the episodes that both have measured, all tasks "
        "together (diamonds) and, unless they are too many, one by one, with 95 % intervals by Newcombe's method 10.",
        figure=figure,
    )


def _shares(found: Tally) -> dict[str, float]:
    hits = round((found.pooled.mean or 0.0) * found.measured)
    counts = {"success": hits, **found.verdicts, _NOT_MEASURED: found.unmeasurable + found.errors}
    return {name: count / found.episodes for name, count in counts.items()}


def _interval(
    ax: Any, mean: float | None, low: float | None, high: float | None, y: float, colour: str, marker: str
) -> None:
    if mean is None:
        return
    if low is not None and high is not None:
        ax.plot([low, high], [y, y], color=colour, linewidth=1.2, solid_capstyle="round")
    ax.plot([mean], [y], color=colour, marker=marker, markersize=4)


def _percent(ax: Any, low: float = 0.0) -> None:
    from matplotlib.ticker import PercentFormatter

    ax.set_xlim(low - 0.02, 1.02)
    ax.xaxis.set_major_formatter(PercentFormatter(xmax=1.0, decimals=0))
    ax.tick_params(axis="x", labelsize=8)
