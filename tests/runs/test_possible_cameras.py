"""The verdict on a video with several possible cameras: what all of them agree on."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.geometry import make_pose
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.runs.score import judge_possible
from kinebench_drake.track import GripperTrack
from kinebench_drake.violation import ViolationKind

T = 12
DOWN = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def tools():
    return Resources(RobotOptions())


def track(x_m, z_m=0.3):
    X = np.stack([make_pose(DOWN, [x_m + 0.002 * i, 0.05, z_m]) for i in range(T)])
    return GripperTrack(
        t_s=0.2 * np.arange(T),
        X_CH=X,
        X_BG=X,
        tracked=np.ones(T, bool),
        confidence=np.ones(T),
        finger_width_m=np.full(T, 0.04),
    )


def test_a_motion_that_is_feasible_with_every_camera_is_feasible(tools):
    verdict = judge_possible([track(0.45), track(0.5)], tools, 0.0)
    assert verdict is not None
    assert verdict.feasible
    assert verdict.violations == ()


def test_a_motion_that_is_infeasible_with_every_camera_has_the_kinds_of_violations_that_all_share(tools):
    verdict = judge_possible([track(1.2), track(1.4)], tools, 0.0)
    assert verdict is not None
    assert verdict.feasible is False
    assert {v.kind for v in verdict.violations} == {ViolationKind.UNREACHABLE}


@pytest.mark.parametrize(
    "tracks",
    [
        (track(0.45), track(1.4)),  # feasible with one camera alone
        (track(0.45, z_m=-0.2), track(1.4)),  # below the table, and out of reach
        (track(0.45), replace(track(0.45), tracked=np.arange(T) < 2)),  # too few frames with one of them
    ],
)
def test_a_verdict_that_depends_on_the_camera_is_none(tools, tracks):
    assert judge_possible(tracks, tools, 0.0) is None
