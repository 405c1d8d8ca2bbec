"""The plots of one track: when it goes wrong, where it goes, what it asks of the joints, how far it stays from harm."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from kinebench_drake.geometry import Array
from kinebench_drake.report.frames import anomalies_of, joint_limits, limit_ratios
from kinebench_drake.report.joint_ranges import draw_joint_ranges
from kinebench_drake.report.plot import Band, Curve, draw_plot
from kinebench_drake.report.timeline import draw_timeline, lanes_of
from kinebench_drake.row import Json, SampleRow
from kinebench_drake.trackfile import TrackFile

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
