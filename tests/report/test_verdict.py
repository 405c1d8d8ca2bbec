"""Verdict and trust of a row in words."""

import pytest

from kinebench_drake.report.verdict import VERDICT_LABELS, describe_trust, describe_verdict, name_verdict, verdict_of
from kinebench_drake.results.row import Status
from tests.report.pages import row
from tests.rows import make_cause

VELOCITY = {
    **{"kind": "velocity", "joint": "panda_joint4", "frame_start": 3, "frame_end": 9},
    **{"value": 2.6, "limit": 2.175, "unit": "rad/s"},
}


def video(executable, *reasons, anomalies=(), **fields):
    """A judged video; anomalies are kind, first and last frame."""
    marks = [{"kind": kind, "frame_start": start, "frame_end": end, "severity": 1.0} for kind, start, end in anomalies]
    values = {"feasible": True, "executable": executable, "executable_reasons": reasons, **fields}
    return row("a", metrics={"anomalies": marks}, **values)


def trajectory(executable, *reasons, **fields):
    values = {"feasible": executable, "executable": executable, "executable_reasons": reasons, **fields}
    return row("a", metrics={"sparc": -2.0}, **values)


def test_a_video_without_faults_is_executable():
    assert describe_verdict(video(True)) == "executable"


def test_a_visual_anomaly_is_named_with_its_frames():
    faulty = video(
        False, "vanish: 10 frames", "lost: 10 frames", anomalies=[("vanish", 4, 13), ("camera_motion", 0, 9)]
    )
    assert describe_verdict(faulty) == "not executable: vanish, frames 4 to 13"


def test_of_many_stretches_of_an_anomaly_the_first_are_listed():
    freezes = [("freeze", 10 * k, 10 * k + (k > 0)) for k in range(5)]
    faulty = video(False, "freeze: 9 frames", anomalies=freezes)
    spans = "frame 0, frames 10 to 11, frames 20 to 21, 2 more"
    assert describe_verdict(faulty) == f"not executable: freeze, {spans}"


def test_an_infeasible_video_is_not_executable_by_the_limit_it_breaks():
    broken = {"feasible": False, "violations": (VELOCITY, VELOCITY)}
    faulty = video(False, "infeasible", "finger_opening: 1 frame", anomalies=[("finger_opening", 2, 2)], **broken)
    assert describe_verdict(faulty) == (
        "not executable: velocity of panda_joint4, 2.6 rad/s (limit 2.175), frames 3 to 9 and 1 violation more; "
        "finger opening, frame 2"
    )


@pytest.mark.parametrize(
    ("reasons", "text"),
    [
        (["undecided"], "undecided: the base frame is unknown"),
        (["lost: 12 frames"], "undecided: no pose in 12 frames"),
        (["open: teleport", "lost: 1 frame"], "undecided: teleport is open; no pose in 1 frame"),
        (["open: finger_opening"], "undecided: finger opening is open"),
        (["unchecked: torque, jerk"], "feasible as far as checked: limits of torque, jerk are not checked"),
        (["novel: 3 things"], "undecided: novel, 3 things"),
    ],
)
def test_what_leaves_a_verdict_open_is_in_words(reasons, text):
    nulls = {"feasible": "the base frame is unknown"}
    assert describe_verdict(video(None, *reasons, null_reasons=nulls)) == text


def test_a_trajectory_is_feasible_or_infeasible_by_a_limit():
    assert describe_verdict(trajectory(True)) == "feasible"
    broken = trajectory(False, "infeasible", violations=(VELOCITY,))
    assert describe_verdict(broken) == "infeasible: velocity of panda_joint4, 2.6 rad/s (limit 2.175), frames 3 to 9"


def test_a_track_that_is_not_judged_has_its_tracked_frames():
    track = row("a", metrics={"anomalies": [], "tracked_fraction": 47 / 49}, extra={"frames": 49})
    assert describe_verdict(track) == "tracked 47 of 49 frames"
    assert verdict_of(track) == "tracked"


@pytest.mark.parametrize("status", [Status.UNMEASURABLE, Status.ERROR])
def test_a_sample_without_results_has_its_reason(status):
    assert describe_verdict(row("a", status, reason="too short")) == f"{status.value}: too short"


def episode(success, executable=True, *reasons, cause=None, **fields):
    outcome = {"success": success, "verdict": cause, "cause": make_cause(cause) if cause else None}
    return video(executable, *reasons, extra=outcome, **fields)


def test_an_episode_has_its_outcome_with_the_cause_of_a_failure():
    assert describe_verdict(episode(True)) == "success"
    assert describe_verdict(episode(False, cause="task")) == "failed: task, never on target"


def test_a_success_that_no_robot_can_repeat_says_so():
    jump = {"anomalies": [("teleport", 46, 46)]}
    assert describe_verdict(episode(True, False, "teleport: 1 frame", **jump)) == (
        "success, not executable: teleport, frame 46"
    )
    assert describe_verdict(episode(True, None, "lost: 3 frames")) == (
        "success, executable undecided: no pose in 3 frames"
    )


def test_the_name_of_a_verdict_is_its_beginning_in_words():
    for sample in (video(True), video(False, "vanish: 2 frames"), trajectory(True), episode(True)):
        assert verdict_of(sample) in VERDICT_LABELS
        assert describe_verdict(sample).startswith(name_verdict(sample))


def test_trust_has_its_reason_only_where_it_is_not_solid():
    trusts = [
        {"level": level, "reason": "because", "line": f"{level}: because (facts)"} for level in ("solid", "check")
    ]
    assert [describe_trust(row("a", extra={"trust": trust})) for trust in trusts] == ["solid", "check, because"]
    assert describe_trust(row("a")) == ""
