from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.closed_loop.gap import GAP_METRICS, average_gaps, measure_gap
from kinebench_drake.suites.rollout import RolloutVideo

FRAMES = 6
SIDE = 32
POSES = make_pose(np.eye(3), np.linspace([0.4, 0.0, 0.2], [0.6, 0.0, 0.2], FRAMES))


def executed(rgb: Any) -> RolloutVideo:
    robot = np.zeros((FRAMES, SIDE, SIDE), dtype=bool)
    robot[:, :8] = True
    return cast(RolloutVideo, SimpleNamespace(rgb=rgb, robot=robot, X_BG=POSES))


@pytest.fixture
def rgb() -> Any:
    return np.random.default_rng(0).integers(0, 255, (FRAMES, SIDE, SIDE, 3)).astype(np.uint8)


def poses_off_by(distance_m: Array) -> Array:
    off = POSES.copy()
    off[:, 2, 3] += distance_m
    return off


def test_an_execution_equal_to_the_video_has_no_gap(rgb: Any) -> None:
    film = executed(rgb)
    metrics, reasons = average_gaps([measure_gap(film.robot, POSES, film)])
    assert metrics["gap_robot_iou"] == 1.0
    assert metrics["gap_gripper_m"] == 0.0
    assert reasons == {}


def test_the_gripper_gap_is_null_when_generated_frames_are_lost(rgb: Any) -> None:
    film = executed(rgb)
    error = np.array([0.0, 0.001, 0.001, 0.4, 0.4, 0.001])
    whole, _ = average_gaps([measure_gap(film.robot, poses_off_by(error), film)])
    assert whole["gap_gripper_m"] == pytest.approx(error[1:].mean())
    poses = poses_off_by(error)
    poses[3:5] = np.nan
    metrics, reasons = average_gaps([measure_gap(film.robot, poses, film)])
    assert metrics["gap_gripper_m"] is None
    assert metrics["gap_gripper_rad"] is None
    assert reasons["gap_gripper_m"] == "the generated gripper is lost in 2 of 5 executed frames"
    assert metrics["gap_robot_iou"] == 1.0


def test_the_first_frame_of_a_clip_does_not_count(rgb: Any) -> None:
    film = executed(rgb)
    poses = poses_off_by(np.full(FRAMES, 0.01))
    poses[0] = np.nan
    gap = measure_gap(film.robot, poses, film)
    assert average_gaps([gap, gap])[0]["gap_gripper_m"] == pytest.approx(0.01)


def test_without_an_execution_every_metric_has_its_reason() -> None:
    metrics, reasons = average_gaps([])
    assert set(metrics.values()) == {None}
    assert reasons == dict.fromkeys(GAP_METRICS, "nothing was executed")
