"""Plots: each value is counted, each fault lies at its frames, joints are drawn within their limits."""

import re
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.report.curves import draw_curves
from kinebench_drake.report.metric import BY_NAME
from kinebench_drake.report.plot import count_values, draw_histogram
from kinebench_drake.report.timeline import draw_strip, draw_timeline, fault_lanes, frame_count
from kinebench_drake.results.aggregate import estimate
from tests.report.pages import EVIL


def counted(values, metric="sparc"):
    numbers = [value for _, value in values]
    return count_values(BY_NAME[metric], values, estimate(numbers, total=len(numbers)))


def test_each_value_is_counted_in_one_bin():
    values = [("feasible" if v < 0.5 else "infeasible", float(v)) for v in np.random.default_rng(0).random(100)]
    h = counted([*values, ("error", None)])
    assert sum(map(sum, h.counts.values())) == 100
    assert sum(h.counts["feasible"]) == sum(verdict == "feasible" for verdict, _ in values)
    middles = 0.5 * (h.edges[1:] + h.edges[:-1])
    assert all(middle < 0.6 for middle, n in zip(middles, h.counts["feasible"], strict=True) if n)
    assert h.outliers == 0


def test_outliers_are_counted_in_the_outermost_bins():
    values = [("feasible", float(v)) for v in np.linspace(0.0, 1.0, 50)] + [
        ("infeasible", 900.0),
        ("infeasible", -80.0),
    ]
    h = counted(values, "slowdown_min")
    assert h.outliers == 2
    assert (h.edges[0], h.edges[-1]) == (0.0, 1.0)
    assert (h.counts["infeasible"][0], h.counts["infeasible"][-1]) == (1, 1)
    assert "2 outliers" in draw_histogram(h, {})


@pytest.mark.parametrize("values", [[], [1.0], [2.0, 2.0, 2.0], [None, 3.0], [0.0, 0.0]])
def test_values_without_spread_have_no_histogram(values):
    assert counted([("feasible", v) for v in values]) is None


def bars(svg, css):
    matches = re.findall(rf'<rect class="bar-{css}" x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', svg)
    return [(float(x), float(x) + float(width)) for x, width in matches]


def test_faults_are_drawn_at_their_frames(judged, file):
    row = judged(
        violations=({"kind": "velocity", "frame_start": 2, "frame_end": 4, "joint": EVIL},),
        metrics={"anomalies": [{"kind": "freeze", "frame_start": 0, "frame_end": 9, "severity": 1.0}]},
    )
    track = file()
    lanes = fault_lanes(row, track)
    assert [(lane.label, lane.css) for lane in lanes] == [
        ("velocity", "violation"),
        ("freeze", "anomaly"),
        ("not tracked", "lost"),
    ]
    svg = draw_timeline(lanes, 10, track.track.t_s)
    ((first, last),) = bars(svg, "anomaly")  # the whole of the axis
    frame = (last - first) / 10
    assert bars(svg, "violation") == [pytest.approx((first + 2 * frame, first + 5 * frame), abs=0.2)]
    assert bars(svg, "lost") == [pytest.approx((first + 7 * frame, first + 8 * frame), abs=0.2)]
    assert "frames 2 to 4 (1.20 to 1.40 s)" in svg
    assert EVIL not in svg
    assert EVIL not in draw_strip(lanes, 10)


def test_faults_beyond_the_frames_are_drawn_inside_the_strip(judged):
    row = judged(violations=({"kind": "jerk", "frame_start": -3, "frame_end": 400, "joint": None},))
    lanes = fault_lanes(row, None)
    assert frame_count(row, None, lanes) == 401
    ((first, last),) = bars(draw_strip(lanes, 10), "violation")
    assert (first, last) == (0.0, 150.0)


def test_adjacent_faults_are_merged_into_one_bar(judged):
    faults = tuple({"kind": "torque", "frame_start": k, "frame_end": k + 1, "joint": f"j{k % 7}"} for k in range(1000))
    lanes = fault_lanes(judged(violations=faults), None)
    assert [(span.start, span.end) for lane in lanes for span in lane.spans] == [(0, 1000)]


def test_faults_closer_than_a_pixel_are_drawn_as_one_bar(judged):
    faults = tuple({"kind": "vanish", "frame_start": k, "frame_end": k, "severity": 1.0} for k in range(0, 20000, 2))
    lanes = fault_lanes(judged(metrics={"anomalies": faults}), None)
    assert len(lanes[0].spans) == 10000
    assert len(bars(draw_timeline(lanes, 20000), "anomaly")) == len(bars(draw_strip(lanes, 20000), "anomaly")) == 1


def test_joints_are_drawn_within_their_own_limits(judged, file):
    q = np.full((10, 7), -0.5)  # the middle of -2 to 1 rad
    q[3, 1] = 1.0
    q[5, 2] = -2.0
    q[6] = np.nan
    [svg] = [plot for plot in draw_curves(judged(), replace(file(), q=q)) if "Joint angle" in plot]
    upper, lower = (float(y) for y in re.findall(r'class="limit" d="M\d+ ([\d.]+)H', svg)[::-1])
    lines = re.findall(r'<polyline class="curve c\d" points="([^"]*)"', svg)
    heights = [[float(point.split(",")[1]) for point in line.split()] for line in lines]
    assert len(lines) == 14  # the frame without angles interrupts each line
    assert (min(map(min, heights)), max(map(max, heights))) == (upper, lower)
    assert heights[0] == [0.5 * (lower + upper)] * 6
