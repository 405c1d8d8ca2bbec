"""All plots of one track: faults, joint angles and rates against their limits, manipulability, clearance, gripper."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from kinebench_drake.geometry import Array
from kinebench_drake.report import plot
from kinebench_drake.report.limits import JointLimits, joint_limits, limit_ratios
from kinebench_drake.report.timeline import draw_timeline, fault_lanes
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import segments

NEAR = 0.1
"""Margin below which a joint is near its limit, as a share of half its range."""
_LEFT, _RIGHT, _LANE, _TALL, _BOTTOM = 44.0, plot.WIDTH - 44.0, 25.0, 21.0, 20.0
_BEYOND = 1.15
"""Half ranges from the centre up to which a joint's line is drawn."""
_TITLES = {
    "velocity": "Joint speed / limit:",
    "acceleration": "Joint acceleration / limit:",
    "jerk": "Joint jerk / limit (lower bound):",
    "torque": "Joint torque / limit:",
}
_MIN_ERROR_M, _MIN_ERROR_RAD = 1e-5, 1e-4
"""Errors of inverse kinematics below which no plot is drawn."""
Bands = Mapping[str, Sequence[plot.FrameSpan]]


def draw_curves(row: SampleRow, file: TrackFile) -> list[Markup]:
    """Draw all plots that the track's file has data for; old files and videos without verdict have fewer."""
    t_s = file.track.t_s
    lanes = fault_lanes(row, file)
    bands = {
        css: plot.merge_spans((span for lane in lanes if lane.css == css for span in lane.spans), 1)
        for css in ("violation", "anomaly")
    }
    faults = [draw_timeline(lanes, len(t_s), t_s)] if lanes else []
    return [*faults, *_joint_plots(row, file, bands), *_path_plots(file, bands), *_gripper_plots(file, bands)]


def _joint_plots(row: SampleRow, file: TrackFile, bands: Bands) -> Iterator[Markup]:
    limits, t_s = joint_limits(row), file.track.t_s
    labels = _short_names(limits.joints)
    ranges = draw_joint_ranges(t_s, file.q, limits, labels)
    if ranges is not None:
        yield ranges
    for name, ratio in limit_ratios(file, limits).items():
        if np.isfinite(ratio).any():
            curves = [plot.Curve(label=label, values=ratio[:, j], css=f"c{j}") for j, label in enumerate(labels)]
            high = max(1.1, 1.05 * float(np.nanmax(ratio)))
            yield plot.draw_plot(_TITLES[name], t_s, curves, bands, limits=(0.0, high), lines=(1.0,))


def _short_names(joints: Sequence[str]) -> list[str]:
    """Return the joints' numbers if their names are otherwise equal, else the names."""
    stems = {joint.rstrip("0123456789") for joint in joints}
    if len(stems) > 1 or not all(joint[-1:].isdigit() for joint in joints):
        return list(joints)
    return [joint.removeprefix(min(stems)) for joint in joints]


def _path_plots(file: TrackFile, bands: Bands) -> Iterator[Markup]:
    """Draw the quantities with one number per frame."""
    for title, parts, scale in (
        ("Manipulability", (("full", "manipulability"), ("weighted by joint limits", "manipulability_weighted")), 1.0),
        ("Joint-limit margin, minimum", (("margin", "joint_margin"),), 1.0),
        ("Clearance [mm]", (("self-collision", "self_distance_m"), ("table", "table_distance_m")), 1e3),
    ):
        available = [(label, file.curves[name]) for label, name in parts if name in file.curves]
        curves = [
            plot.Curve(label=label, values=scale * values, css=f"c{k}")
            for k, (label, values) in enumerate(available)
            if np.isfinite(values).any()
        ]
        if curves:
            yield plot.draw_plot(title, file.track.t_s, curves, bands, lines=(0.0,))
    for title, name, scale, least in (
        ("IK position error [mm]", "ik_position_error_m", 1e3, _MIN_ERROR_M),
        ("IK rotation error [°]", "ik_rotation_error_rad", 180.0 / np.pi, _MIN_ERROR_RAD),
    ):
        error = file.curves.get(name)
        if error is not None and (np.nan_to_num(error) > least).any():
            curve = plot.Curve(label="error", values=scale * error, css="c0")
            yield plot.draw_plot(title, file.track.t_s, [curve], bands, lines=(0.0,))


def _gripper_plots(file: TrackFile, bands: Bands) -> Iterator[Markup]:
    track = file.track
    axes = [plot.Curve(label=a, values=track.X_BG[:, k, 3], css=f"c{k}") for k, a in enumerate("xyz")]
    yield plot.draw_plot("TCP position in the base frame [m]", track.t_s, axes, bands)
    if (track.confidence[track.tracked] < 1.0).any() or not track.tracked.all():
        confidence = plot.Curve(label="confidence", values=track.confidence, css="c0")
        yield plot.draw_plot("Confidence of the pose", track.t_s, [confidence], bands, limits=(0.0, 1.0))
    if np.isfinite(track.finger_width_m).any():
        gap = plot.Curve(label="gap", values=track.finger_width_m * 1000.0, css="c0")
        yield plot.draw_plot("Gap between the finger pads [mm]", track.t_s, [gap], bands, limits=(0.0, 85.0))


def draw_joint_ranges(t_s: Array, q: Array, limits: JointLimits, names: Sequence[str]) -> Markup | None:
    """Draw joint angles within their ranges as a `<figure>`; None if the limits or all angles are unknown.

    A joint's line runs between the edges of its lane, its lower and upper limit; the number on the right is its minimum
    margin: distance to the limit over half the range, negative outside.

    Args:
        t_s: (T,) time [s].
        q: (T, 7) joint angles [rad]; NaN where unknown.
        limits: the joints' ranges.
        names: short names of the joints.
    """
    if limits.position is None or not np.isfinite(q).any():
        return None
    lower, upper = limits.position
    place = (q - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    x = plot.Axis(float(t_s[0]), float(t_s[-1]), _LEFT, _RIGHT)
    degrees = np.stack(limits.position) * 180.0 / np.pi
    lanes = [
        {
            "name": name,
            "range": f"{limits.joints[j]}: {degrees[0, j]:.1f}° to {degrees[1, j]:.1f}°",
            **_draw_lane(x, t_s, place[:, j], 1.0 + j * _LANE),
        }
        for j, name in enumerate(names)
    ]
    height = _LANE * len(names) + _BOTTOM
    size = {"height": height, "left": _LEFT, "right": _RIGHT, "tall": _TALL}
    return plot.render_plot("joint_ranges", **size, ticks=x.ticks(), lanes=lanes, near=NEAR)


def _draw_lane(x: plot.Axis, t_s: Array, place: Array, top: float) -> dict[str, object]:
    """Return shades, line and minimum margin of one joint; `place` is -1 at its lower limit and 1 at its upper one."""
    finite = np.isfinite(place)
    if not finite.any():
        return {"top": top, "shades": [], "pieces": [], "margin": None}
    margin = 1.0 - np.abs(np.where(finite, place, 0.0))
    at = np.array([x(t) for t in t_s])
    half = 0.5 * (at[-1] - at[0]) / max(len(at) - 1, 1)
    shades = []
    for css, mask in (("near", (margin < NEAR) & (margin >= 0.0)), ("past", margin < 0.0)):
        for run in segments(mask & finite):
            reach, times = at[run], t_s[run]
            left, right = max(reach[0] - half, at[0]), min(reach[-1] + half, at[-1])
            text = f"margin {margin[run].min():.3f}, {times[0]:.2f} to {times[-1]:.2f} s"
            shades.append((css, left, max(right - left, 1.5), text))
    middle, scale = top + 0.5 * _TALL, 0.5 * _TALL
    pieces = [
        [(across, middle - value * scale) for across, value in piece]
        for piece in plot.finite_pieces(at, np.clip(place, -_BEYOND, _BEYOND))
    ]
    return {"top": top, "shades": shades, "pieces": pieces, "margin": float(margin[finite].min())}
