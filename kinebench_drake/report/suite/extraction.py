"""Figures and tables of motion extraction (section 4.2 of the paper) from files of `perception`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kinebench_drake.io.figure import FAINT, new_figure, plain, shorten
from kinebench_drake.report.figures import COLOURS, ReportFigure
from kinebench_drake.report.suite.measurement import (
    DEPTH,
    LEARNED,
    BaselineGroup,
    DepthError,
    Interval,
    Measurements,
    Study,
)
from kinebench_drake.report.table import Column, Table, Value, plain_columns
from kinebench_drake.results.aggregate import Estimate

_FIGURES = ("position_median", "position_p95", "rotation_median", "rotation_p95")
_FLOORS = {"position": 0.05, "rotation": 0.02}
"""Least values of logarithmic axes [mm, degrees]."""
_METHODS = {"grounding": COLOURS[0], "baseline": COLOURS[1]}
_EXTRACTOR = {"grounding": "grounding", "baseline": "learned inverse dynamics"}
_TRACKED = "tracked_when_seen"


def tabulate_extraction(files: Measurements) -> Table | None:
    """Build the table of errors by source of depth and method; None without a measurement."""
    rows: list[tuple[Value, ...]] = []
    for name in ("true depth", "our estimate"):
        depth = files.studies.get(DEPTH)
        if depth is not None and name in depth.conditions:
            label = f"grounding, {'true' if name == 'true depth' else 'estimated'} depth"
            rows.append(_row(label, DEPTH, depth.conditions[name], depth.videos))
    for evaluation in files.evaluations:
        label, source = f"grounding, {evaluation.pipeline}", "evaluate"
        rows.append(_row(label, source, evaluation.intervals, [*evaluation.videos]))
    for group in (g for g in files.baseline if g.pooled):
        source = f"baseline evaluate, {group.group}"
        for method, label in _EXTRACTOR.items():
            tracked = group.tracked_fraction if method == "grounding" else 1.0
            cells = [_estimate(*group.errors[method][name], group.videos) for name in _FIGURES]
            rows.append((label, source, group.videos, _estimate(tracked, None, None, group.videos), *cells))
    if not rows:
        return None
    return Table(
        name="extraction",
        title="Errors of motion extraction by source of depth and method",
        note="Median and 95th percentile over frames, of the grounding over tracked frames, with 95 % bootstrap "
        "intervals over videos; a lost frame has no error. Of baseline evaluate: TCP in the base frame, tracked of all "
        "frames; of the others: hand in the camera frame, tracked of the frames that show at least 30 % of the "
        "gripper. Rows of different sources may be of different videos.",
        columns=(
            *plain_columns(method="Method", source="Measured by", videos="Videos"),
            Column(key="tracked", label="Tracked", pattern="{:.1%}", estimated=True),
            Column(key="position_median_mm", label="Position, median [mm]", pattern="{:.2f}", estimated=True),
            Column(key="position_p95_mm", label="Position, 95 % [mm]", pattern="{:.2f}", estimated=True),
            Column(key="rotation_median_deg", label="Rotation, median [degrees]", pattern="{:.2f}", estimated=True),
            Column(key="rotation_p95_deg", label="Rotation, 95 % [degrees]", pattern="{:.2f}", estimated=True),
        ),
        rows=tuple(rows),
    )


def _row(label: str, source: str, figures: Mapping[str, Interval], videos: Sequence[str]) -> tuple[Value, ...]:
    names = (_TRACKED, "position_median_mm", "position_p95_mm", "rotation_median_deg", "rotation_p95_deg")
    cells = (_estimate(f.value, f.low, f.high, len(videos)) for f in (figures[name] for name in names))
    return (label, source, len(videos), *cells)


def _estimate(value: float | None, low: float | None, high: float | None, n: int) -> Estimate:
    numbers = [None if v is None or not np.isfinite(v) else float(v) for v in (value, low, high)]
    return Estimate(mean=numbers[0], low=numbers[1], high=numbers[2], n=n, total=n)


def draw_trajectories(groups: Sequence[BaselineGroup]) -> ReportFigure | None:
    """Draw each video's median error on unseen tasks, of both methods; None without such videos."""
    tasks = [g for g in groups if not g.trained and not g.pooled]
    if not tasks:
        return None
    figure, axes = new_figure(2.6 + 0.9 * len(tasks), 6.4, 2, 1, sharex=True)
    for ax, quantity, unit in zip(axes[:, 0], _FLOORS, ("mm", "degrees"), strict=True):
        for shift, (method, colour) in zip((0.16, -0.16), _METHODS.items(), strict=True):
            for k, group in enumerate(tasks):
                errors = [v for v in group.video_medians[method][quantity] if v is not None]
                spread = np.linspace(-0.09, 0.09, len(errors)) if len(errors) > 1 else np.zeros(len(errors))
                points = np.maximum(errors, _FLOORS[quantity])
                ax.plot(k + shift + spread, points, "o", color=colour, markersize=4, alpha=0.7)
                median = max(group.errors[method][f"{quantity}_median"][0], _FLOORS[quantity])
                if np.isfinite(median):
                    ax.plot([k + shift - 0.13, k + shift + 0.13], [median, median], color=colour, linewidth=2.0)
            ax.plot([], [], "o-", color=colour, markersize=4, label=_EXTRACTOR[method])
        _logarithmic(ax)
        ax.set_ylabel(f"{quantity} error [{unit}]", fontsize=9)
        ax.grid(False, axis="x")
    names = [f"{plain(g.group)}\ntracked {g.tracked_fraction:.1%}" for g in tasks]
    axes[1, 0].set_xticks(range(len(tasks)), names, fontsize=8, rotation=35, ha="right", rotation_mode="anchor")
    axes[0, 0].set_xlim(-0.5, len(tasks) - 0.5)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, fontsize=8, frameon=False)
    return ReportFigure(
        name="figure4a_trajectories",
        title="Figure 4a: errors on tasks that the learned baseline was not trained on",
        caption="Dots: median error over the frames of one video; bars: median over all frames of the task. The "
        "grounding's errors are those of its tracked frames, whose share stands below the task; the baseline has a "
        "pose in every frame.",
        figure=figure,
    )


def draw_conditions(study: Study, name: str, title: str, caption: str) -> ReportFigure:
    """Draw the distribution of both errors, and the share of tracked frames, for each condition of a study."""
    names = [n for n, d in study.distributions.items() if n in study.conditions]
    groups = list(dict.fromkeys(study.distributions[n].group for n in names))
    shades = {group: COLOURS[k % len(COLOURS)] for k, group in enumerate(groups)}
    if study.has_baseline:
        shades = {group: _METHODS["baseline" if group == LEARNED else "grounding"] for group in groups}
    colours = [shades[study.distributions[n].group] for n in names]
    figure, axes = new_figure(max(6.4, 0.4 * len(names) + 2.4), 8.4, 3, 1, sharex=True)
    quantities = (("position", "position_mm", "mm"), ("rotation", "rotation_deg", "degrees"))
    for ax, (quantity, key, unit) in zip(axes[:2, 0], quantities, strict=True):
        for k, (label, colour) in enumerate(zip(names, colours, strict=True)):
            values = getattr(study.distributions[label], key)
            if values is not None:
                box = dict(
                    zip(("whislo", "q1", "med", "q3", "whishi"), np.maximum(values, _FLOORS[quantity]), strict=True)
                )
                drawn = ax.bxp(
                    [box], [k], widths=0.65, showfliers=False, patch_artist=True, medianprops={"color": "#20262c"}
                )
                drawn["boxes"][0].set(facecolor=colour, alpha=0.55, edgecolor=colour)
        _logarithmic(ax)
        ax.set_ylabel(f"{quantity} error [{unit}]", fontsize=9)
        ax.grid(False, axis="x")
    ax = axes[2, 0]
    for k, (label, colour) in enumerate(zip(names, colours, strict=True)):
        share = study.conditions[label][_TRACKED]
        if share.value is not None:
            ax.bar([k], [share.value], width=0.65, color=colour, alpha=0.6)
        if share.low is not None and share.high is not None:
            ax.plot([k, k], [share.low, share.high], color="#20262c", linewidth=1.2)
    ax.set_ylim(0, 1.04)
    ax.set_ylabel("tracked", fontsize=9)
    ax.grid(False, axis="x")
    ax.set_xlim(-0.7, len(names) - 0.3)
    if study.has_baseline:
        for method, colour in _METHODS.items():
            axes[0, 0].plot([], [], color=colour, linewidth=6.0, alpha=0.55, label=_EXTRACTOR[method])
        figure.legend(loc="outside upper center", ncols=2, fontsize=8, frameon=False)
    labels = [plain(shorten(n, 30)) for n in names]
    ax.set_xticks(range(len(names)), labels, fontsize=8, rotation=60, ha="right", rotation_mode="anchor")
    return ReportFigure(
        name=name,
        title=title,
        caption=f"{caption} {len(study.videos)} videos. Boxes: quartiles, whiskers: 5 % and 95 % of tracked frames; "
        "below: share of the frames that show at least 30 % of the gripper and are tracked, with 95 % intervals over "
        "videos.",
        figure=figure,
    )


def _logarithmic(ax: Any) -> None:
    from matplotlib.ticker import LogLocator

    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    ax.tick_params(labelsize=8)


def draw_depth_maps(error: DepthError) -> ReportFigure | None:
    """Draw the mean relative depth error over the gripper, from two sides; None if it was not measured."""
    maps = {side: np.array(m.mean, dtype=np.float64) for side, m in error.maps.items()}
    finite = [values[np.isfinite(values)] for values in maps.values()]
    if not finite or not sum(map(len, finite)) or error.median is None:
        return None
    top = max(100.0 * float(np.percentile(np.concatenate(finite), 98)), 0.1)
    figure, axes = new_figure(3.9 * len(maps) + 0.6, 3.9, 1, len(maps))
    for ax, (side, values) in zip(axes[0], maps.items(), strict=True):
        across, up = error.maps[side].axes[0], error.maps[side].axes[1]
        image = ax.imshow(
            100.0 * values, origin="lower", extent=error.maps[side].bounds_mm, cmap="magma_r", vmin=0, vmax=top
        )
        ax.set_title(f"the hand from its {side}", fontsize=9)
        ax.set_xlabel(f"{across} of panda_hand [mm]", fontsize=8)
        ax.set_ylabel(f"{up} of panda_hand [mm]", fontsize=8)
        ax.invert_yaxis()
        ax.grid(False)
        ax.tick_params(labelsize=8)
        ax.axhline(0.0, color=FAINT, linewidth=0.8)
    figure.colorbar(image, ax=list(axes[0]), label="mean |relative error| [%]", shrink=0.85)
    return ReportFigure(
        name="figure5b_depth_error",
        title="Figure 5b: error of the estimated depth over the gripper",
        caption=f"Mean absolute error of the network's depth, relative to the true depth. Over all cells: median "
        f"{error.median:.2%}, 95th percentile {error.p95:.2%}.",
        figure=figure,
    )
