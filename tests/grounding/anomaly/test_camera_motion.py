import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import rotation_angle, rotation_exp
from kinebench_drake.grounding.anomaly.camera_motion import (
    FeatureTracks,
    find_camera_motion,
    find_cuts,
    measure_camera_motion,
)

CAMERA = benchmark_camera().resized(192, 192)
ROBOT = np.zeros((192, 192), dtype=bool)
ROBOT[55:145, 35:125] = True


def scene(turn, robot_px):
    """A textured background visible by a turned camera, with a textured box, the robot, moved by `robot_px`."""
    rng = np.random.default_rng(0)
    texture = cv2.resize(rng.integers(0, 255, (40, 40, 3), dtype=np.uint8), (260, 260), interpolation=cv2.INTER_CUBIC)
    shift = np.array([[1.0, 0.0, -34.0], [0.0, 1.0, -34.0], [0.0, 0.0, 1.0]])
    turned = CAMERA.K @ rotation_exp(turn).T @ np.linalg.inv(CAMERA.K)
    image = np.asarray(cv2.warpPerspective(texture, turned @ shift, (192, 192)), dtype=np.uint8)
    box = cv2.resize(rng.integers(0, 255, (14, 14, 3), dtype=np.uint8), (80, 80), interpolation=cv2.INTER_NEAREST)
    image[60:140, 40 + robot_px : 120 + robot_px] = box
    return image


def recorded(turns, robot_px=0) -> NDArray[np.uint8]:
    return np.stack([scene(turn, robot_px * i) for i, turn in enumerate(turns)])


def test_a_fixed_camera_has_no_motion_while_the_robot_moves():
    motion = measure_camera_motion(FeatureTracks(recorded(np.zeros((8, 3)), robot_px=4)), ROBOT, CAMERA)
    assert motion.largest_px < 0.1
    assert not motion.moves
    assert (np.eye(4) == motion.X_AC).all()
    assert find_camera_motion(motion).peak < 0.2


@pytest.mark.parametrize("step_px", [0.3, 0.7])
def test_a_turning_camera_is_measured_reported_and_stabilized(step_px):
    turns = np.arange(6)[:, None] * [0.0, step_px / CAMERA.fx, 0.0]
    frames = recorded(turns)
    motion = measure_camera_motion(FeatureTracks(frames), ROBOT, CAMERA)
    assert motion.largest_px == pytest.approx(5 * step_px, rel=0.15, abs=0.1)
    assert rotation_angle(motion.R_AC[5].T @ rotation_exp(turns[5])) < 0.15 / CAMERA.fx
    assert find_camera_motion(motion).anomalies[-1].frame_end == 5
    steady, _ = motion.stabilize(frames, CAMERA)
    inner = np.s_[20:50, 20:172]
    assert np.abs(steady[5][inner].astype(int) - frames[0][inner]).mean() < 3.0
    assert np.abs(frames[5][inner].astype(int) - frames[0][inner]).mean() > 5.0


def test_frames_after_a_large_camera_motion_lose_the_base_frame():
    turns = np.arange(6)[:, None] * [0.0, 1.6 / CAMERA.fx, 0.0]
    motion = measure_camera_motion(FeatureTracks(recorded(turns)), ROBOT, CAMERA)
    assert motion.lost.tolist() == [False] * 3 + [True] * 3  # 8 px of a picture twice as wide


def test_camera_motion_is_unknown_without_image_features():
    motion = measure_camera_motion(FeatureTracks(np.full((4, 192, 192, 3), 90, np.uint8)), ROBOT, CAMERA)
    assert motion.largest_px is None
    assert find_camera_motion(motion).peak == 0.0


def test_camera_motion_is_unknown_after_a_cut_to_another_scene():
    frames = recorded(np.zeros((6, 3)))
    noise = np.random.default_rng(1).integers(0, 255, (20, 20, 3), dtype=np.uint8)
    frames[1:] = cv2.resize(noise, (192, 192), interpolation=cv2.INTER_CUBIC)
    motion = measure_camera_motion(FeatureTracks(frames), ROBOT, CAMERA)
    assert motion.is_unknown
    assert motion.largest_px is None


def test_feature_tracks_do_not_depend_on_robot_masks_of_earlier_calls():
    frames = recorded(np.arange(5)[:, None] * [0.0, 0.5 / CAMERA.fx, 0.0], robot_px=2)
    again = FeatureTracks(frames)
    measure_camera_motion(again, np.zeros_like(ROBOT), CAMERA)
    after, alone = (measure_camera_motion(tracks, ROBOT, CAMERA) for tracks in (again, FeatureTracks(frames)))
    np.testing.assert_array_equal(after.px, alone.px)
    np.testing.assert_array_equal(after.R_AC, alone.R_AC)


def test_a_video_of_one_frame_has_no_camera_motion():
    assert measure_camera_motion(FeatureTracks(recorded(np.zeros((1, 3)))), ROBOT, CAMERA).largest_px == 0.0


def of_other_scene(frames):
    """The frames before another background: turned upside down and inverted."""
    return 255 - frames[:, ::-1]


def test_cuts_between_clips_of_different_scenes_are_found_where_they_are():
    clip = recorded(np.zeros((7, 3)), robot_px=3)
    other = of_other_scene(clip)
    assert find_cuts(clip) == []
    assert find_cuts(np.concatenate([clip, other])) == [7]
    assert find_cuts(np.concatenate([clip, other, clip])) == [7, 14]
    repeated = np.repeat(np.concatenate([clip, other]), 3, axis=0)
    assert find_cuts(repeated) == [21]


def test_a_robot_that_jumps_a_flash_a_glitch_and_a_fast_camera_are_no_cuts():
    clip = recorded(np.zeros((7, 3)))
    jumping = np.concatenate([clip, recorded(np.zeros((7, 3)), robot_px=9)[5:]])
    dark = np.concatenate([clip, clip // 2])
    black = np.concatenate([clip, np.zeros_like(clip)])
    glitch = np.concatenate([clip, of_other_scene(clip[:1]), clip])
    turning = recorded(np.arange(7)[:, None] * [0.0, 0.06, 0.0])
    for frames in (jumping, dark, black, glitch, turning):
        assert find_cuts(frames) == []
