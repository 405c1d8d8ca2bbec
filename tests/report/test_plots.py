"""Plots: each fault lies at its frames, curves break where values are missing."""

import re
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.report.curves import draw_curves
from kinebench_drake.report.timeline import fault_lanes
from tests.report.conftest import LIMITS
from tests.report.pages import EVIL, Page


def test_faults_cover_their_frames(judged, file):
    violations = (
        {"kind": "velocity", "frame_start": 2, "frame_end": 4, "joint": "j1"},
        {"kind": "velocity", "frame_start": 4, "frame_end": 5, "joint": "j2"},
        {"kind": "jerk", "frame_start": -3, "frame_end": 400, "joint": None},
    )
    freeze = {"kind": "freeze", "frame_start": 0, "frame_end": 9, "severity": 1.0}
    track = file().track
    confidence = track.confidence.copy()
    confidence[0] = 0.4
    row = judged(violations=violations, metrics={"anomalies": [freeze]})
    lanes = fault_lanes(row, replace(track, confidence=confidence))
    frames = {(lane.label, lane.category): np.flatnonzero(lane.frames).tolist() for lane in lanes}
    assert frames == {
        ("velocity", "violation"): [2, 3, 4, 5],
        ("jerk", "violation"): list(range(10)),
        ("freeze", "anomaly"): list(range(10)),
        ("not tracked", "lost"): [7],
        ("doubtful", "doubtful"): [0],
    }


def texts(figure):
    return re.findall(r"<text[^>]*>([^<]*)</text>", figure)


def test_figures_name_faults_quantities_and_units(judged, file):
    row = judged(violations=({"kind": "velocity", "frame_start": 2, "frame_end": 4, "joint": None},))
    joints, motion = draw_curves(row, file())
    assert {"Faults", "Joint angle, limits at ±1", "Joint speed / limit", "time [s]"} <= {*texts(joints)}
    assert {"Clearance [mm]", "TCP position in the base frame [m]", "time [s]"} <= {*texts(motion)}
    assert "".join(texts(joints)).count("1234567") == 1


def test_drawings_are_safe_parts_of_a_page(judged, file):
    names = [f"{EVIL} of joint {k}." for k in range(7)]
    for figure in draw_curves(judged(details={"limits": {**LIMITS, "joints": names}}), file()):
        assert Page(figure).open == []
        assert EVIL not in figure
        assert not re.search(r"https?://", figure)


def test_the_same_track_gives_the_same_drawing_and_ids_of_its_own(judged, file):
    one = draw_curves(judged(), file())
    assert draw_curves(judged(), file()) == one
    other = draw_curves(replace(judged(), id="b"), file())
    ids = [id for figure in (*one, *other) for id in set(Page(figure).ids)]
    assert len(set(ids)) == len(ids) > 0


def paths(figure, colour):
    """Points of the lines of a colour, by line."""
    drawn = re.findall(rf'<path d="([^"]*)"[^>]*style="fill: none;[^"]*stroke: {colour}', figure)
    return [np.array(re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", d), dtype=float) for d in drawn]


def test_joints_are_drawn_within_their_own_limits(judged, file):
    q = np.full((10, 7), -0.5)  # the middle of -2 to 1 rad
    q[3, 1] = 1.0
    q[5, 2] = -2.0
    figure, _ = draw_curves(judged(), replace(file(velocity=np.full((10, 7), np.nan)), q=q))
    lower, upper = (line[0, 1] for line in paths(figure, r"var\(--bad\)")[:2])
    second = paths(figure, "#d06a2a")[0]
    third = paths(figure, "#2a9d7f")[0]
    assert second[:, 1].min() == pytest.approx(upper, abs=0.2)
    assert third[:, 1].max() == pytest.approx(lower, abs=0.2)
    assert second[0, 1] == pytest.approx(0.5 * (lower + upper), abs=0.2)


def test_curves_break_where_values_are_missing_and_show_lone_values(judged, file):
    margin = np.array([0.0, 0.5, 0.1, np.nan, 0.4, 0.9, np.nan, 0.7, np.nan, np.nan])
    _, whole = draw_curves(judged(), file(joint_margin=np.linspace(0.0, 1.0, 10) ** 2))
    _, broken = draw_curves(judged(), file(joint_margin=margin))
    assert broken.count("<use") == whole.count("<use") + 1  # the value of frame 7
    line = re.findall(r'd="([^"]*)"[^>]*style="fill: none; stroke: #2f7fc1', broken)[0]
    assert line.count("M") == 3


@pytest.mark.parametrize("values", [np.zeros(10), np.full(10, 1e9), np.linspace(0, 1e-12, 10), np.full(10, np.inf)])
def test_drawings_of_constant_or_missing_values_contain_no_nan_or_inf(judged, file, values):
    for figure in draw_curves(judged(), file(joint_margin=values)):
        assert not re.search(r"\b(nan|inf)\b", figure)
