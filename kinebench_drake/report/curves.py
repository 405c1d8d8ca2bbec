"""Plots of one track over time: faults, joints against their limits, clearance, motion of the gripper."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import FAINT, LABEL_PT, TICK_PT, new_figure, plain
from kinebench_drake.metrics.following import TUBE_M, TUBE_RAD
from kinebench_drake.report.figures import BAD, COLOURS, DOUBT, NEUTRAL, inline_figure
from kinebench_drake.report.limit_table import joint_limits, limit_ratios
from kinebench_drake.report.timeline import ANOMALY, DOUBTFUL, LOST, VIOLATION, FaultLane, fault_lanes
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import segments

_RATE_TITLES = {
    "velocity": "Joint speed / limit",
    "acceleration": "Joint acceleration / limit",
    "jerk": "Joint jerk / limit, at least",
    "torque": "Joint torque / limit",
}
_MIN_ERROR_M = 1e-5
_MIN_ERROR_RAD = 1e-4
"""Errors of inverse kinematics below which no plot is drawn."""
_FAULT_COLOURS = {VIOLATION: BAD, ANOMALY: DOUBT, LOST: NEUTRAL, DOUBTFUL: COLOURS[3]}
_SHADE = 0.18
"""Opacity of the bands at frames with a violation or an anomaly."""
_WIDTH_IN = 5.6
_PANEL_IN = 0.82
_LANE_IN = 0.17
_GAP_IN = 0.34
"""Width of a figure; heights of a panel of curves, of the bar of one fault, and of the space for a title [inches]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Curves over time with a common vertical axis."""

    title: str
    curves: Mapping[str, Array]
    """(T,) values by label; NaN interrupts the line."""
    limits: tuple[float, float] | None = None
    """Range of the vertical axis; None fits the values."""
    lines: Sequence[float] = ()
    """Values that are marked."""


def draw_curves(row: SampleRow, file: TrackFile) -> list[Markup]:
    """Draw all plots that the track's file has data for; old files and videos without verdict have fewer."""
    lanes = fault_lanes(row, file.track)
    joints = list(_joint_panels(row, file))
    motion = [*_deviation_panels(file), *_path_panels(file), *_gripper_panels(file)]
    figures = []
    if joints or lanes:
        figures.append(_draw_panels(f"{row.id} joints", file.track.t_s, lanes, joints, bars=True))
    figures.append(_draw_panels(f"{row.id} motion", file.track.t_s, lanes, motion))
    return figures


def _joint_panels(row: SampleRow, file: TrackFile) -> Iterator[Panel]:
    limits = joint_limits(row)
    labels = _short_names(limits.joints)
    if limits.position is not None and np.isfinite(file.q).any():
        lower, upper = limits.position
        place = (2.0 * file.q - lower - upper) / (upper - lower)
        curves = dict(zip(labels, place.T, strict=True))
        yield Panel(title="Joint angle, limits at ±1", curves=curves, limits=(-1.15, 1.15), lines=(-1.0, 1.0))
    for name, ratio in limit_ratios(file, limits).items():
        if np.isfinite(ratio).any():
            top = max(1.1, 1.05 * float(np.nanmax(ratio)))
            curves = dict(zip(labels, ratio.T, strict=True))
            yield Panel(title=_RATE_TITLES[name], curves=curves, limits=(0.0, top), lines=(1.0,))


def _short_names(joints: Sequence[str]) -> list[str]:
    """Return the joints' numbers if their names are otherwise equal, else the names."""
    stems = {joint.rstrip("0123456789") for joint in joints}
    if len(stems) > 1 or not all(joint[-1:].isdigit() for joint in joints):
        return list(joints)
    return [joint.removeprefix(min(stems)) for joint in joints]


def _path_panels(file: TrackFile) -> Iterator[Panel]:
    """List the panels of quantities with one number per frame."""
    for title, names, scale, least in (
        ("Manipulability", {"full": "manipulability"}, 1.0, 0.0),
        ("Joint-limit margin, minimum", {"margin": "joint_margin"}, 1.0, 0.0),
        ("Clearance [mm]", {"self-collision": "self_distance_m", "table": "table_distance_m"}, 1e3, 0.0),
        ("IK position error [mm]", {"error": "ik_position_error_m"}, 1e3, _MIN_ERROR_M),
        ("IK rotation error [°]", {"error": "ik_rotation_error_rad"}, 180.0 / np.pi, _MIN_ERROR_RAD),
    ):
        own = {label: file.curves[name] for label, name in names.items() if name in file.curves}
        curves = {label: scale * values for label, values in own.items() if (np.abs(values) >= least).any()}
        if curves:
            yield Panel(title=title, curves=curves, lines=(0.0,))


def _deviation_panels(file: TrackFile) -> Iterator[Panel]:
    """List the panels of deviations from actions or a real clip; those of the tube are marked."""
    for title, names, scale, bound in (
        ("Deviation [mm]", {"TCP": "deviation_m", "gap": "deviation_finger_m"}, 1e3, 1e3 * TUBE_M),
        ("Deviation [°]", {"rotation": "deviation_rad"}, 180.0 / np.pi, 180.0 / np.pi * TUBE_RAD),
        ("Deviation [px]", {"TCP in the image": "deviation_px"}, 1.0, 0.0),
    ):
        curves = {label: scale * file.curves[name] for label, name in names.items() if name in file.curves}
        if any(np.isfinite(values).any() for values in curves.values()):
            yield Panel(title=title, curves=curves, lines=(bound,))


def _gripper_panels(file: TrackFile) -> Iterator[Panel]:
    track = file.track
    place = dict(zip("xyz", track.X_BG[:, :3, 3].T, strict=True))
    yield Panel(title="TCP position in the base frame [m]", curves=place)
    if (track.confidence[track.tracked] < 1.0).any() or not track.tracked.all():
        yield Panel(title="Confidence of the pose", curves={"confidence": track.confidence}, limits=(0.0, 1.05))
    if np.isfinite(track.finger_width_m).any():
        gap = {"gap": track.finger_width_m * 1000.0}
        yield Panel(title="Gap between the finger pads [mm]", curves=gap, limits=(0.0, 85.0))


def _draw_panels(
    name: str, t_s: Array, lanes: Sequence[FaultLane], panels: Sequence[Panel], *, bars: bool = False
) -> Markup:
    """Draw panels below each other over a common time axis, faults shaded.

    Args:
        bars: begin with a panel of the faults, a bar for each.
    """
    heights = [_LANE_IN * len(lanes)] if bars and lanes else []
    heights += [_PANEL_IN] * len(panels)
    height = sum(heights) + _GAP_IN * len(heights) + 0.35
    figure, axes = new_figure(_WIDTH_IN, height, len(heights), arranged=False, sharex=True, height_ratios=heights)
    average = sum(heights) / len(heights)
    figure.subplots_adjust(
        left=0.17, right=0.985, top=1.0 - 0.26 / height, bottom=0.42 / height, hspace=_GAP_IN / average
    )
    places = list(axes[:, 0])
    for ax in places[:-1]:
        ax.xaxis.set_visible(False)
    if bars and lanes:
        _draw_bars(places.pop(0), t_s, lanes)
    labels: list[str] = []
    for ax, panel in zip(places, panels, strict=True):
        _draw_panel(ax, t_s, lanes, panel)
        if len(panel.curves) > 1 and labels != list(panel.curves):
            _add_legend(ax)
        labels = list(panel.curves)
    half = _half_frame(t_s)
    axes[-1, 0].set_xlim(t_s[0] - half, t_s[-1] + half)
    axes[-1, 0].set_xlabel("time [s]")
    return inline_figure(figure, name, name)


def _draw_panel(ax: Any, t_s: Array, lanes: Sequence[FaultLane], panel: Panel) -> None:
    for category in (VIOLATION, ANOMALY):
        frames = np.any([lane.frames for lane in lanes if lane.category == category], axis=0)
        if frames.any():
            options = {"color": _FAULT_COLOURS[category], "alpha": _SHADE, "transform": ax.get_xaxis_transform()}
            _draw_spans(ax, t_s, frames, (0.0, 1.0), **options)
    for line in panel.lines:
        ax.axhline(line, color=BAD, linewidth=0.9, linestyle=(0, (4, 3)))
    for (label, values), colour in zip(panel.curves.items(), COLOURS, strict=False):
        finite = np.isfinite(values)
        alone = [run.start for run in segments(finite) if run.stop - run.start == 1]
        ax.plot(t_s, values, color=colour, linewidth=1.2, label=plain(label))
        if alone:  # no line leads to these
            ax.plot(t_s[alone], values[alone], ".", color=colour, markersize=3)
    ax.set_ylim(panel.limits)
    ax.locator_params(axis="y", nbins=3)
    _set_title(ax, panel.title)


def _add_legend(ax: Any) -> None:
    """Name the curves in the line of the title."""
    ax.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=10, fontsize=TICK_PT, frameon=False,
        handlelength=0.9, handletextpad=0.3, columnspacing=0.8, borderpad=0.0, borderaxespad=0.2,
    )  # fmt: skip


def _draw_bars(ax: Any, t_s: Array, lanes: Sequence[FaultLane]) -> None:
    for k, lane in enumerate(lanes):
        _draw_spans(ax, t_s, lane.frames, (k - 0.32, 0.64), color=_FAULT_COLOURS[lane.category])
    ax.set_yticks(range(len(lanes)), [plain(lane.label) for lane in lanes])
    ax.set_ylim(len(lanes) - 0.5, -0.5)
    ax.spines["left"].set_visible(False)
    _set_title(ax, "Faults")


def _draw_spans(ax: Any, t_s: Array, frames: NDArray[np.bool_], extent: tuple[float, float], **options: Any) -> None:
    """Draw a rectangle over each run of frames, from half a frame before to half a frame after it."""
    half = _half_frame(t_s)
    spans = [(t_s[run.start] - half, t_s[run.stop - 1] - t_s[run.start] + 2.0 * half) for run in segments(frames)]
    ax.broken_barh(spans, extent, linewidth=0.6, **options)


def _half_frame(t_s: Array) -> float:
    """Return half the mean time between frames [s]."""
    return 0.5 * float((t_s[-1] - t_s[0]) or 1.0) / max(len(t_s) - 1, 1)


def _set_title(ax: Any, title: str) -> None:
    ax.set_title(title, loc="left", fontsize=LABEL_PT, y=1.0, pad=4)  # y: else the place is sought, which takes long
    ax.tick_params(length=0)
    ax.spines[["left", "bottom"]].set_color(FAINT)
