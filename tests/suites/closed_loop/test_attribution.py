"""Verdicts on failures: each planted cause is named, the earlier one first."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import make_pose, rotation_exp
from kinebench_drake.metrics.executable import FailureVerdict
from kinebench_drake.suites.closed_loop.attribution import (
    LOST_FRAMES,
    LOST_SHARE,
    ClipEvidence,
    attribute,
    find_disobedience,
)
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack
from kinebench_drake.track import GripperTrack

FRAMES = 30


def clip() -> ClipEvidence:
    X = make_pose(np.broadcast_to(np.eye(3), (FRAMES, 3, 3)), np.linspace([0.4, 0.0, 0.3], [0.5, 0.1, 0.1], FRAMES))
    gap = np.linspace(0.08, 0.02, FRAMES)
    return ClipEvidence(
        tracked=np.ones(FRAMES, dtype=bool),
        anomalies=(),
        X_BG_generated=X,
        X_BG_executed=X.copy(),
        finger_width_generated_m=gap,
        finger_width_executed_m=gap.copy(),
        gripping=False,
    )


def lost(start: int, end: int) -> ClipEvidence:
    fine = clip()
    tracked = fine.tracked.copy()
    X = fine.X_BG_generated.copy()
    tracked[start : end + 1] = False
    X[start : end + 1] = np.nan
    return replace(fine, tracked=tracked, X_BG_generated=X)


def vanished(of: ClipEvidence, start: int, end: int) -> ClipEvidence:
    anomaly = Anomaly(kind=AnomalyKind.VANISH, frame_start=start, frame_end=end, severity=float(end - start + 1))
    return replace(of, anomalies=(anomaly,))


def astray(metres: float, turn_rad: float, gap_m: float) -> ClipEvidence:
    fine = clip()
    X = fine.X_BG_executed.copy()
    gap = fine.finger_width_executed_m + gap_m * (np.arange(FRAMES) >= 12)
    X[12:15, 1, 3] += metres
    X[12:15, :3, :3] = rotation_exp([0.0, 0.0, turn_rad])
    return replace(fine, X_BG_executed=X, finger_width_executed_m=gap)


def test_a_failure_without_any_other_cause_is_attributed_to_the_task() -> None:
    cause = attribute([clip(), clip()], "not released")
    assert cause.verdict == FailureVerdict.TASK.value
    assert "not released" in cause.text


def test_five_lost_frames_in_a_row_are_attributed_to_grounding() -> None:
    cause = attribute([clip(), lost(10, 14)], "")
    assert (cause.verdict, cause.round, cause.frame_start, cause.frame_end) == (
        FailureVerdict.GROUNDING.value,
        1,
        10,
        14,
    )
    assert attribute([lost(10, 10)], "").verdict == FailureVerdict.TASK.value


def test_the_value_of_lost_poses_exceeds_its_limit() -> None:
    in_a_row = attribute([lost(10, 14)], "")
    assert (in_a_row.value, in_a_row.limit) == (5.0, LOST_FRAMES - 1.0)
    scattered = replace(clip(), tracked=np.arange(FRAMES) % 4 > 0)
    share = attribute([scattered], "")
    assert share.value == pytest.approx(0.25, abs=0.05)
    assert share.limit == LOST_SHARE


@pytest.mark.parametrize(
    ("after_m", "verdict"),
    [(0.041, FailureVerdict.TASK), (0.08, FailureVerdict.GROUNDING), (np.nan, FailureVerdict.GROUNDING)],
)
def test_a_finger_motion_during_lost_frames_is_attributed_to_grounding(after_m: float, verdict: FailureVerdict) -> None:
    gap = np.full(FRAMES, 0.04)
    gap[12:20] = np.nan
    gap[20:] = after_m
    cause = attribute([replace(clip(), finger_width_generated_m=gap, finger_width_executed_m=gap)], "")
    assert cause.verdict == verdict.value
    assert cause.frame_start == (None if verdict is FailureVerdict.TASK else 12)


@pytest.mark.parametrize(
    ("before_m", "gripping", "verdict"),
    [
        (0.01, False, FailureVerdict.TASK),
        (0.01, True, FailureVerdict.GROUNDING),  # a thin handle may be let go
        (0.04, False, FailureVerdict.GROUNDING),  # open fingers may close
    ],
)
def test_closed_fingers_that_hold_nothing_hide_no_move_up_to_the_end(
    before_m: float, gripping: bool, verdict: FailureVerdict
) -> None:
    gap = np.where(np.arange(FRAMES) < 12, before_m, np.nan)
    hidden = replace(clip(), finger_width_generated_m=gap, finger_width_executed_m=gap, gripping=gripping)
    assert attribute([hidden], "").verdict == verdict.value


def test_hidden_fingers_yield_to_causes_in_execution_and_generation() -> None:
    gap = np.where(np.arange(FRAMES) < 12, 0.04, np.nan)
    assert (
        attribute([replace(astray(0.1, 0.0, 0.0), finger_width_generated_m=gap)], "").verdict
        == FailureVerdict.EXECUTION.value
    )
    assert (
        attribute([replace(vanished(clip(), 3, 8), finger_width_generated_m=gap)], "").verdict
        == FailureVerdict.GENERATION.value
    )


def test_a_vanished_gripper_is_attributed_to_generation_and_not_grounding() -> None:
    cause = attribute([vanished(lost(10, 14), 10, 14)], "")
    assert (cause.verdict, cause.frame_start, cause.frame_end) == (FailureVerdict.GENERATION.value, 10, 14)
    assert attribute([vanished(lost(10, 20), 10, 12)], "").verdict == FailureVerdict.GROUNDING.value


def test_infeasible_motion_is_attributed_to_generation() -> None:
    cause = attribute([replace(astray(0.1, 0.0, 0.0), violations=(("velocity", 11, 12),))], "")
    assert (cause.verdict, cause.frame_start) == (FailureVerdict.GENERATION.value, 11)
    after = replace(clip(), violations=(("velocity", FRAMES, FRAMES + 2),))
    assert attribute([after], "").verdict == FailureVerdict.TASK.value


@pytest.mark.parametrize(
    ("metres", "turn_rad", "gap_m", "verdict"),
    [
        (0.05, 0.0, 0.0, FailureVerdict.EXECUTION),
        (0.0, 0.5, 0.0, FailureVerdict.EXECUTION),
        (0.0, 0.0, 0.03, FailureVerdict.EXECUTION),
        (0.02, 0.1, 0.01, FailureVerdict.TASK),
    ],
)
def test_a_deviation_of_the_executed_gripper_is_attributed_to_execution(
    metres: float, turn_rad: float, gap_m: float, verdict: FailureVerdict
) -> None:
    cause = attribute([astray(metres, turn_rad, gap_m)], "")
    assert cause.verdict == verdict.value
    assert cause.frame_start == (None if verdict is FailureVerdict.TASK else 12)


def test_a_clip_that_does_not_follow_its_actions_is_attributed_to_generation() -> None:
    disobedient = replace(clip(), disobedience="3 of 30 frames within 2 cm and 10 degrees")
    cause = attribute([clip(), disobedient], "")
    assert (cause.verdict, cause.round) == (FailureVerdict.GENERATION.value, 1)
    assert cause.text.startswith("the video did not follow its actions: 3 of 30 frames")


@pytest.mark.parametrize(("order", "follows"), [(1, True), (-1, False)])
def test_following_of_actions_is_judged_as_in_finished_clips(order: int, follows: bool) -> None:
    X = clip().X_BG_generated
    t_s = np.arange(FRAMES, dtype=np.float64)
    gap = np.full(FRAMES, 0.08)
    sure = np.ones(FRAMES)
    track = GripperTrack(t_s=t_s, X_CH=X, X_BG=X, tracked=sure > 0, confidence=sure, finger_width_m=gap)
    actions = ActionTrack(t_s=t_s, X_BG=X[::order], finger_width_m=gap, q=np.zeros((FRAMES, 7)))
    assert (find_disobedience(track, actions) is None) == follows
    assert find_disobedience(track, None) is None
