"""All plots of one track: faults, joint angles and rates against their limits, manipulability, clearance, gripper."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from kinebench_drake.geometry import Array
from kinebench_drake.report import plot
from kinebench_drake.report.limit_table import joint_limits, limit_ratios
from kinebench_drake.report.timeline import draw_timeline, fault_lanes
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile

_TITLES = {
    "velocity": "Joint speed / limit:",
    "acceleration": "Joint acceleration / limit:",
    "jerk": "Joint jerk / limit, at least:",
    "torque": "Joint torque / limit:",
}
_MIN_ERROR_M = 1e-5
_MIN_ERROR_RAD = 1e-4
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
    limits = joint_limits(row)
    t_s = file.track.t_s
    labels = _short_names(limits.joints)

    def by_joint(values: Array) -> list[plot.Curve]:
        return [plot.Curve(label=label, values=values[:, j], css=f"c{j}") for j, label in enumerate(labels)]

    if limits.position is not None and np.isfinite(file.q).any():
        lower, upper = limits.position
        place = (2.0 * file.q - lower - upper) / (upper - lower)
        title = "Joint angle, limits ±1:"
        yield plot.draw_plot(title, t_s, by_joint(place), bands, limits=(-1.15, 1.15), lines=(-1.0, 1.0))
    for name, ratio in limit_ratios(file, limits).items():
        if np.isfinite(ratio).any():
            high = max(1.1, 1.05 * float(np.nanmax(ratio)))
            yield plot.draw_plot(_TITLES[name], t_s, by_joint(ratio), bands, limits=(0.0, high), lines=(1.0,))


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
