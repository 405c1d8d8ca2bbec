"""Motion extraction (section 4.2 of the paper): records of the studies' files, and table and figures of them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from kinebench_drake.errors import UsageError
from kinebench_drake.io.figure import FAINT, new_figure, plain, shorten
from kinebench_drake.report.figures import COLOURS, ReportFigure, make_figure
from kinebench_drake.report.table import Table, Value, make_table
from kinebench_drake.results.aggregate import Estimate

BASELINE = "baseline.json"
"""File of `python -m training baseline evaluate` in its output folder."""
ROBUSTNESS, DEPTH = "robustness", "depth-ablation"
"""Studies that are drawn."""
LEARNED = "learned"
"""Group of the conditions in which the learned baseline was measured."""
_EXPECTED = (
    f"expected a file of `python -m training baseline evaluate` ({BASELINE}), or of `python -m benchmarks perturb`, "
    "`depth-ablation` or `evaluate` with --json"
)
_ERRORS = {
    **{"position_median": "position_median_mm", "position_p95": "position_p95_mm"},
    **{"rotation_median": "rotation_median_deg", "rotation_p95": "rotation_p95_deg"},
}
"""Columns of the table by name of the errors in the baseline's file."""
_FLOORS = {"position": 0.05, "rotation": 0.02}
"""Least values of logarithmic axes [mm, degrees]."""
_METHODS = {"grounding": COLOURS[0], "baseline": COLOURS[1]}
_EXTRACTOR = {"grounding": "grounding", "baseline": "learned inverse dynamics"}
_TRACKED = "tracked_when_seen"


class Interval(BaseModel):
    """Figure with the ends of its interval; None where there is none."""

    value: float | None
    low: float | None
    high: float | None


class Distribution(BaseModel):
    """Percentiles of the errors of one condition."""

    group: str = ""
    frames: int
    percentiles: tuple[float, ...]
    position_mm: tuple[float, ...] | None
    rotation_deg: tuple[float, ...] | None


class DepthMap(BaseModel):
    """Mean relative depth error over one plane of panda_hand."""

    axes: str
    bounds_mm: tuple[float, float, float, float]
    mean: list[list[float | None]]


class DepthError(BaseModel):
    """Relative error of the estimated depth on the gripper."""

    median: float | None = None
    p95: float | None = None
    maps: dict[str, DepthMap] = {}


class Study(BaseModel):
    """Errors of the grounding on the same videos under several conditions."""

    study: str
    title: str
    videos: list[str]
    conditions: dict[str, dict[str, Interval]]
    distributions: dict[str, Distribution]
    relative_depth_error: DepthError = DepthError()

    @property
    def has_baseline(self) -> bool:
        """True if the learned baseline was measured, too."""
        return any(d.group == LEARNED for d in self.distributions.values())


class PipelineErrors(BaseModel):
    """Errors of one pipeline."""

    pipeline: str
    intervals: dict[str, Interval]
    videos: dict[str, Any]


class BaselineGroup(BaseModel):
    """Errors of the grounding and of the learned baseline on the same videos of one task, or of several."""

    group: str
    trained: bool
    pooled: bool
    videos: int
    tracked_fraction: float
    errors: dict[str, dict[str, tuple[float, float, float]]]
    video_medians: dict[str, dict[str, list[float | None]]]


class Measurements(BaseModel):
    """All files of `perception` that a report was given."""

    names: list[str] = []
    """Names of the files."""
    baseline: list[BaselineGroup] = []
    studies: dict[str, Study] = {}
    evaluations: list[PipelineErrors] = []


def is_measurement(path: Path) -> bool:
    """Return whether a path names a --json file of a study, or the output folder of the learned baseline's."""
    return path.suffix == ".json" or (path / BASELINE).is_file()


def read_measurements(paths: Sequence[Path]) -> Measurements:
    """Read files of `perception`.

    Raises:
        UsageError: a file is no such file, or there are two of one kind.
    """
    files = Measurements()
    for path in paths:
        file = path / BASELINE if path.is_dir() else path
        files.names.append(path.name)
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            if isinstance(content, list):
                _require_first(file, BASELINE, not files.baseline)
                files.baseline = [BaselineGroup.model_validate(group) for group in content]
            elif isinstance(content, dict) and "distributions" in content:
                study = Study.model_validate(content)
                _require_first(file, study.study, study.study not in files.studies)
                files.studies[study.study] = study
            else:
                files.evaluations.append(PipelineErrors.model_validate(content))
        except (OSError, ValueError, ValidationError):
            raise UsageError(f"{path}: cannot be read; {_EXPECTED} of this version") from None
    return files


def _require_first(file: Path, kind: str, first: bool) -> None:
    if not first:
        raise UsageError(f"{file}: is a second file of {kind}, whose videos would be drawn twice; name one")


def tabulate_extraction(files: Measurements) -> Table | None:
    """Build the table of errors by source of depth and method; None without a measurement."""
    rows: list[dict[str, Value]] = []
    if (depth := files.studies.get(DEPTH)) is not None:
        for name, label in (("true depth", "true"), ("our estimate", "estimated")):
            if name in depth.conditions:
                source = {"method": f"grounding, {label} depth", "source": DEPTH}
                rows.append({**source, **_study_cells(depth.conditions[name], depth.videos)})
    for evaluation in files.evaluations:
        source = {"method": f"grounding, {evaluation.pipeline}", "source": "evaluate"}
        rows.append({**source, **_study_cells(evaluation.intervals, [*evaluation.videos])})
    for group in (g for g in files.baseline if g.pooled):
        for method, label in _EXTRACTOR.items():
            errors, tracked = group.errors[method], group.tracked_fraction if method == "grounding" else 1.0
            rows.append(
                {
                    **{"method": label, "source": f"baseline evaluate, {group.group}", "videos": group.videos},
                    "tracked": _estimate(tracked, None, None, group.videos),
                    **{column: _estimate(*errors[name], group.videos) for name, column in _ERRORS.items()},
                }
            )
    return make_table("extraction", rows) if rows else None


def _study_cells(figures: Mapping[str, Interval], videos: Sequence[str]) -> dict[str, Value]:
    names = {"tracked": _TRACKED, **{column: column for column in _ERRORS.values()}}
    intervals = {column: figures[name] for column, name in names.items()}
    cells = {column: _estimate(f.value, f.low, f.high, len(videos)) for column, f in intervals.items()}
    return {"videos": len(videos), **cells}


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
    return make_figure("figure4a_trajectories", figure)


def draw_conditions(study: Study, name: str) -> ReportFigure:
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
    return make_figure(name, figure, videos=len(study.videos))


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
    return make_figure("figure5b_depth_error", figure, median=error.median, p95=error.p95)
