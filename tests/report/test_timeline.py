"""The state of each frame."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.report.limit_table import joint_limits, limit_ratios
from kinebench_drake.report.timeline import FrameState, covered_frames, frame_states
from kinebench_drake.track import IkStatus
from tests.rows import make_violation

OK = FrameState.OK
DOUBT = FrameState.DOUBT
BROKEN = FrameState.BROKEN
UNTRACKED = FrameState.UNTRACKED


def test_tracked_frames_without_a_fault_are_ok(judged, file):
    assert frame_states(judged(), file()) == (OK,) * 7 + (UNTRACKED,) + (OK,) * 2


def test_a_violation_outranks_other_frame_states(judged, file):
    violation = {"kind": "discontinuity", "frame_start": 6, "frame_end": 7, "joint": None, "value": 1.0, "limit": 0.1}
    assert frame_states(judged(violations=(violation,)), file())[5:9] == (OK, BROKEN, BROKEN, OK)


def test_poses_not_reached_without_a_violation_are_in_doubt(judged, file):
    track = file()
    status = list(track.status)
    status[1] = IkStatus.UNREACHABLE
    status[2] = IkStatus.JOINT_LIMIT
    violation = {"kind": "unreachable", "frame_start": 1, "frame_end": 1, "joint": None, "value": 0.1, "limit": 1e-6}
    states = frame_states(judged(violations=(violation,)), replace(track, status=tuple(status)))
    assert states[:4] == (OK, BROKEN, DOUBT, OK)


@pytest.mark.parametrize("name", ["joint_margin", "self_distance_m", "table_distance_m", "velocity"])
def test_frames_past_a_limit_without_a_violation_are_in_doubt(judged, file, name):
    values = np.full((10, 7), 2.1) if name == "velocity" else np.full(10, -0.001)
    values[1:] = 0.0
    assert frame_states(judged(), file(**{name: values}))[:2] == (DOUBT, OK)


def test_anomalies_and_low_confidence_are_in_doubt(judged, file):
    track = file()
    confidence = track.track.confidence.copy()
    confidence[0] = 0.4
    vanish = {"kind": "vanish", "frame_start": 6, "frame_end": 7, "severity": 1.0}
    states = frame_states(
        judged(metrics={"anomalies": [vanish]}), replace(track, track=replace(track.track, confidence=confidence))
    )
    assert (states[0], states[1], states[6], states[7]) == (DOUBT, OK, DOUBT, UNTRACKED)


def test_missing_limits_of_a_row_are_skipped_and_malformed_ones_are_refused(judged, file):
    limits = joint_limits(judged())
    assert limits.joints[0] == "arm_joint1"
    assert set(limits.rates) == {"velocity", "jerk", "torque"}
    assert np.isinf(limits.rates["torque"][4:]).all()
    assert limits.position[0].tolist() == [-2.0] * 7
    assert set(limit_ratios(file(), limits)) == {"velocity"}
    limits = joint_limits(judged(details={}))
    assert limits.position is None
    assert not limits.rates
    assert len(limits.joints) == 7
    with pytest.raises(InputError, match="limits is"):
        joint_limits(judged(details={"limits": {"velocity": ["x"] * 7}}))


def test_frame_ranges_are_clipped_to_the_track():
    marks = [make_violation(frame_start=start, frame_end=end) for start, end in ((-3, 1), (4, 99))]
    assert covered_frames(marks, 6).tolist() == [True, True, False, False, True, True]
