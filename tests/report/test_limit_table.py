"""Peaks of a track against its limits: violations first, then the nearest approaches to the others."""

import numpy as np
import pytest

from kinebench_drake.report.limit_table import describe_violation, find_checks, find_peaks
from tests.rows import make_violation

VIOLATION = {
    "kind": "velocity",
    "frame_start": 3,
    "frame_end": 5,
    "joint": "arm_joint3",
    "value": 3.0,
    "limit": 2.0,
}


def by_kind(peaks):
    return {peak.kind: peak for peak in peaks}


def test_violations_come_first_with_time_and_ratio(judged, file):
    first, *rest = find_peaks(judged(violations=(VIOLATION,)), file())
    assert (first.kind, first.broken, first.joint, first.value, first.limit) == (
        "velocity",
        True,
        "arm_joint3",
        3.0,
        2.0,
    )
    assert first.ratio == pytest.approx(1.5)
    assert first.when == "1.30 to 1.50 s (frames 3 to 5)"
    assert first.offset_s == pytest.approx(0.3)
    assert not {"velocity"} & {peak.kind for peak in rest}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "velocity of arm_joint3, 3 rad/s (limit 2), frames 3 to 5"),
        (
            {"kind": "joint_limit", "value": 3.2, "limit": 3.1},
            "joint limit of arm_joint3, 183.3 ° (limit 177.6), frames",
        ),
        ({"kind": "discontinuity", "joint": None, "value": 0.2, "limit": 0.1, "unit": "m"}, "200 mm (limit 100)"),
        ({"kind": "discontinuity", "joint": None, "value": 0.2, "limit": 0.1, "unit": "rad"}, "11.46 ° (limit 5.73)"),
    ],
)
def test_a_violation_is_described_in_the_unit_for_readers(changes, text):
    assert text in describe_violation(make_violation(**{**VIOLATION, **changes}))


def test_without_a_track_violations_are_stated_by_frames(judged):
    (peak,) = find_peaks(judged(violations=(VIOLATION,)), None)
    assert peak.when == "frames 3 to 5"
    assert peak.offset_s is None


def test_the_nearest_approach_to_each_limit_is_taken_from_the_curves(judged, file):
    peaks = by_kind(find_peaks(judged(), file()))
    assert not any(peak.broken for peak in peaks.values())
    speed = peaks["velocity"]
    angle = peaks["joint_limit"]
    table = peaks["table_collision"]
    assert (speed.joint, speed.when, speed.value) == ("arm_joint3", "1.40 s", 1.9)
    assert speed.ratio == pytest.approx(0.95)
    assert (angle.joint, angle.when, angle.unit) == ("arm_joint6", "1.20 s", "°")
    assert angle.value == pytest.approx(np.degrees(-1.7))
    assert angle.limit == pytest.approx(np.degrees(-2.0))
    assert angle.ratio == pytest.approx(0.8)
    assert table.value == pytest.approx(12.0)
    assert table.unit == "mm"
    assert table.when == "1.90 s"


def test_approaches_are_sorted_by_ratio_with_distances_last(judged, file):
    kinds = [peak.kind for peak in find_peaks(judged(), file())]
    assert kinds == ["velocity", "joint_limit", "table_collision"]


def test_details_of_a_row_take_precedence_over_curves(judged, file):
    row = judged()
    details = {**row.details, "checks": {"velocity": {"ratio_max": 0.5, "joint": "arm_joint1", "t_worst_s": 1.8}}}
    peak = by_kind(find_peaks(judged(details=details), file()))["velocity"]
    assert (peak.joint, peak.value, peak.ratio, peak.when) == ("arm_joint1", 1.0, 0.5, "1.80 s")


def test_details_that_name_an_unknown_joint_are_ignored(judged, file):
    row = judged()
    details = {**row.details, "checks": {"velocity": {"ratio_max": 0.5, "joint": "elbow", "t_worst_s": 1.8}}}
    assert by_kind(find_peaks(judged(details=details), file()))["velocity"].joint == "arm_joint3"


def test_joints_without_a_limit_have_no_ratio(judged, file):
    torque = np.zeros((10, 7))
    torque[6, 1] = 40.0
    torque[6, 5] = 1e6
    peak = by_kind(find_peaks(judged(), file(torque=torque)))["torque"]
    assert (peak.joint, peak.ratio) == ("arm_joint2", 0.5)


def test_rows_without_details_have_only_distances(judged, file):
    assert [m.kind for m in find_peaks(judged(details={}), file())] == ["table_collision"]


def test_checks_without_a_ratio_are_left_out(judged):
    checks = {"jerk": {"ratio_max": 0.3}, "velocity": {"ratio_max": None}}
    assert {kind: check.ratio_max for kind, check in find_checks(judged(details={"checks": checks})).items()} == {
        "jerk": 0.3
    }
