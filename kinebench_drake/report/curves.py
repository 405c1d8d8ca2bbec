"""The plots of one track: when it goes wrong, where it goes, what it asks of the joints, how far it stays from harm."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup, escape

from kinebench_drake.geometry import Array
from kinebench_drake.report.frames import JointLimits, anomalies_of, joint_limits, limit_ratios
from kinebench_drake.report.plot import Band, Curve, draw_plot, pieces, ticks
from kinebench_drake.report.timeline import draw_timeline, lanes_of
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import segments
from kinebench_drake.types import Json

NEAR = 0.1
"""Margin below which a joint is near its limit, as a share of half its range."""
_WIDTH, _LEFT, _RIGHT, _LANE, _TALL, _BOTTOM = 430.0, 44.0, 44.0, 25.0, 21.0, 20.0
_BEYOND = 1.15
"""Half ranges from the middle up to which a joint's line is drawn."""


def draw_joint_ranges(t_s: Array, q: Array, limits: JointLimits, names: Sequence[str]) -> Markup | None:
    """The picture as a `<figure>`; None if the limits or all angles are unknown.

    A joint's line runs between the lower edge of its lane, its lower limit, and the upper one; on the right stands
    its least margin: distance to the limit over half the range, negative outside.

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
    height = _LANE * len(names) + _BOTTOM
    span = float(t_s[-1] - t_s[0]) or 1.0
    x = _LEFT + (t_s - t_s[0]) / span * (_WIDTH - _LEFT - _RIGHT)
    parts = [f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" aria-label="Joints within their ranges">']
    for time in ticks(float(t_s[0]), float(t_s[-1])):
        at = _LEFT + (time - float(t_s[0])) / span * (_WIDTH - _LEFT - _RIGHT)
        parts.append(f'<text class="tick time" x="{at:.1f}" y="{height - 5:.1f}">{time:.4g}</text>')
    for j, name in enumerate(names):
        top = 1.0 + j * _LANE
        parts.append(
            f'<rect class="rail" x="{_LEFT:.0f}" y="{top:.1f}" width="{_WIDTH - _LEFT - _RIGHT:.0f}" '
            f'height="{_TALL:.0f}"><title>{escape(_told(limits, j))}</title></rect>'
            f'<text class="tick" x="{_LEFT - 6:.0f}" y="{top + 14.5:.1f}">{escape(name)}</text>'
        )
        parts += _lane(x, t_s, place[:, j], top)
    parts.append("</svg>")
    key = '<span class="lamp near">near a limit</span><span class="lamp violation">beyond it</span>'
    caption = f"<figcaption>Joints within their ranges; right: least margin{key}</figcaption>"
    return Markup(f'<figure class="ranges">{caption}{"".join(parts)}</figure>')


def _lane(x: Array, t_s: Array, place: Array, top: float) -> Iterator[str]:
    """Shades, line and least margin of one joint; `place` is -1 at its lower limit and 1 at its upper one."""
    known = np.isfinite(place)
    if not known.any():
        return
    margin = 1.0 - np.abs(np.where(known, place, 0.0))
    half = 0.5 * (x[-1] - x[0]) / max(len(x) - 1, 1)
    for css, mask in (("near", (margin < NEAR) & (margin >= 0.0)), ("past", margin < 0.0)):
        for run in segments(mask & known):
            reach, times = x[run], t_s[run]
            left, right = max(reach[0] - half, x[0]), min(reach[-1] + half, x[-1])
            words = f"margin {margin[run].min():.3f}, {times[0]:.2f} to {times[-1]:.2f} s"
            yield (
                f'<rect class="shade-{css}" x="{left:.1f}" y="{top:.1f}" width="{max(right - left, 1.5):.1f}" '
                f'height="{_TALL:.0f}"><title>{words}</title></rect>'
            )
    middle, scale = top + 0.5 * _TALL, 0.5 * _TALL
    for piece in pieces(x, np.clip(place, -_BEYOND, _BEYOND)):
        points = [f"{at:.1f},{middle - value * scale:.1f}" for at, value in piece]
        if len(points) == 1:
            at_x, at_y = points[0].split(",")
            yield f'<circle class="dot c0" cx="{at_x}" cy="{at_y}" r="1.5"/>'
        else:
            yield f'<polyline class="curve c0" points="{" ".join(points)}"/>'
    least = float(margin[known].min())
    css = " past" if least < 0.0 else " near" if least < NEAR else ""
    yield f'<text class="tick margin{css}" x="{_WIDTH - _RIGHT + 6:.0f}" y="{top + 14.5:.1f}">{least:.2f}</text>'


def _told(limits: JointLimits, j: int) -> str:
    if limits.position is None:
        return limits.joints[j]
    low, high = (float(end[j]) * 180.0 / np.pi for end in limits.position)
    return f"{limits.joints[j]}: {low:.1f}° to {high:.1f}°"


_RATES = {
    "velocity": "Joint speed / limit",
    "acceleration": "Joint acceleration / limit",
    "jerk": "Joint jerk / limit, at least",
    "torque": "Joint torque / limit",
}
_VISIBLE_M, _VISIBLE_RAD = 1e-5, 1e-4
"""Errors of inverse kinematics below which there is nothing to see."""


def draw_curves(row: SampleRow, file: TrackFile) -> list[Markup]:
    """All plots that the track's file has something for; old files and videos that were not judged have fewer."""
    t_s = file.track.t_s
    bands = _bands(row.violations, "violation") + _bands(anomalies_of(row), "anomaly")
    lanes = lanes_of(row, file)
    faults = [draw_timeline(lanes, len(t_s), t_s)] if lanes else []
    return [*faults, *_joints(row, file, t_s, bands), *_condition(file, t_s, bands), *_gripper(file, t_s, bands)]


def _bands(marks: Sequence[Mapping[str, Json]], css: str) -> list[Band]:
    """Ranges of frames that faults cover, those that overlap as one."""
    found = [
        (start, end, str(mark.get("kind")).replace("_", " "))
        for mark in marks
        if isinstance(start := mark.get("frame_start"), int) and isinstance(end := mark.get("frame_end"), int)
    ]
    bands: list[Band] = []
    for start, end, kind in sorted(found):
        if bands and start <= bands[-1].end + 1:
            last = bands.pop()
            start, end = last.start, max(end, last.end)
            kind = last.label if kind in last.label else f"{last.label}, {kind}"
        bands.append(Band(label=kind, start=start, end=end, css=css))
    return bands


def _joints(row: SampleRow, file: TrackFile, t_s: Array, bands: Sequence[Band]) -> Iterator[Markup]:
    limits = joint_limits(row)
    labels = _short(limits.joints)

    def seven(values: Array) -> list[Curve]:
        return [Curve(label=label, values=values[:, j], css=f"c{j}") for j, label in enumerate(labels)]

    ranges = draw_joint_ranges(t_s, file.q, limits, labels)
    if ranges is not None:
        yield ranges
    for name, ratio in limit_ratios(file, limits).items():
        if np.isfinite(ratio).any():
            high = max(1.1, 1.05 * float(np.nanmax(ratio)))
            yield draw_plot(f"{_RATES[name]}:", t_s, seven(ratio), bands, limits=(0.0, high), lines=(1.0,))


def _short(joints: Sequence[str]) -> list[str]:
    """The joints' numbers if that is all they differ by, else their names."""
    if not all(joint[-1:].isdigit() for joint in joints):
        return list(joints)
    stems = [joint.rstrip("0123456789") for joint in joints]
    return [joint.removeprefix(stems[0]) for joint in joints] if len(set(stems)) == 1 else list(joints)


def _condition(file: TrackFile, t_s: Array, bands: Sequence[Band]) -> Iterator[Markup]:
    """Plots of what is found along the path, one number a frame."""
    for title, parts, scale, lines in (
        (
            "Manipulability",
            (("full", "manipulability"), ("weighed by joint limits", "manipulability_weighted")),
            1.0,
            (0.0,),
        ),
        ("Joint-limit margin, least", (("margin", "joint_margin"),), 1.0, (0.0,)),
        ("Clearance [mm]", (("to itself", "self_distance_m"), ("to the table", "table_distance_m")), 1e3, (0.0,)),
    ):
        known = [(label, file.curves[name]) for label, name in parts if name in file.curves]
        curves = [
            Curve(label=label, values=scale * values, css=f"c{k}")
            for k, (label, values) in enumerate(known)
            if np.isfinite(values).any()
        ]
        if curves:
            yield draw_plot(title, t_s, curves, bands, lines=lines)
    for title, name, scale, visible in (
        ("Distance left to the wanted pose [mm]", "ik_position_error_m", 1e3, _VISIBLE_M),
        ("Angle left to the wanted pose [°]", "ik_rotation_error_rad", 180.0 / np.pi, _VISIBLE_RAD),
    ):
        error = file.curves.get(name)
        if error is not None and (np.nan_to_num(error) > visible).any():
            yield draw_plot(title, t_s, [Curve(label="error", values=scale * error, css="c0")], bands, lines=(0.0,))


def _gripper(file: TrackFile, t_s: Array, bands: Sequence[Band]) -> Iterator[Markup]:
    track = file.track
    axes = [Curve(label=a, values=track.X_BG[:, k, 3], css=f"c{k}") for k, a in enumerate("xyz")]
    yield draw_plot("TCP position in the base frame [m]", t_s, axes, bands)
    if (track.confidence[track.tracked] < 1.0).any() or not track.tracked.all():
        sure = Curve(label="confidence", values=track.confidence, css="c0")
        yield draw_plot("Confidence of the pose", t_s, [sure], bands, limits=(0.0, 1.0))
    if np.isfinite(track.finger_width_m).any():
        gap = Curve(label="gap", values=track.finger_width_m * 1000.0, css="c0")
        yield draw_plot("Gap between the finger pads [mm]", t_s, [gap], bands, limits=(0.0, 85.0))
