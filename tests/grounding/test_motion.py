import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from kinebench_drake.grounding.motion import camera_motion_px


def scene(shift_px: float, robot_px: int) -> NDArray[np.uint8]:
    """A textured background moved by `shift_px` with a textured box, the robot, moved by `robot_px`."""
    rng = np.random.default_rng(0)
    texture = cv2.resize(rng.integers(0, 255, (40, 40, 3), dtype=np.uint8), (260, 260), interpolation=cv2.INTER_CUBIC)
    M = np.array([[1.0, 0.0, shift_px - 30], [0.0, 1.0, -30.0]])
    image = np.asarray(cv2.warpAffine(texture, M, (192, 192)), dtype=np.uint8)
    box = cv2.resize(rng.integers(0, 255, (14, 14, 3), dtype=np.uint8), (80, 80), interpolation=cv2.INTER_NEAREST)
    image[60:140, 40 + robot_px : 120 + robot_px] = box
    return image


ROBOT = np.zeros((192, 192), dtype=bool)
ROBOT[55:145, 35:125] = True


def test_a_fixed_camera_does_not_move_whatever_the_robot_does() -> None:
    frames = np.stack([scene(0.0, 4 * i) for i in range(8)])
    motion = camera_motion_px(frames, ROBOT)
    assert motion is not None
    assert motion < 0.1


@pytest.mark.parametrize("step_px", [0.5, 1.5])
def test_a_moving_camera_is_measured(step_px: float) -> None:
    frames = np.stack([scene(step_px * i, 0) for i in range(6)])
    assert camera_motion_px(frames, ROBOT) == pytest.approx(5 * step_px, abs=0.3)


def test_a_background_without_features_tells_nothing() -> None:
    frames = np.full((4, 192, 192, 3), 90, np.uint8)
    assert camera_motion_px(frames, ROBOT) is None
