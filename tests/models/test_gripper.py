"""Grippers as data: known dimensions, symmetry, and the paths of fingers and knuckles."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from kinebench_drake.geometry import invert, transform_points
from kinebench_drake.models.gripper import PARTS, GripperModel
from kinebench_drake.models.panda.cad import MAX_FINGER_M, franka_hand
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.models.robotiq.cad import robotiq_2f85

GRIPPERS = pytest.mark.parametrize("gripper", [franka_hand(), robotiq_2f85()], ids=["franka", "robotiq"])
CLOSED = np.tile(np.eye(4), (PARTS, 1, 1))


def bodies(gripper: GripperModel, finger_m: float) -> dict[int, trimesh.Trimesh]:
    """The meshes of the bodies in the frame of the gripper."""
    X_HB = gripper.open(CLOSED, finger_m)
    return {body: mesh.copy().apply_transform(X_HB[body]) for body, mesh in gripper.meshes.items()}


def whole(gripper: GripperModel, finger_m: float) -> NDArray[np.float64]:
    return np.concatenate([np.asarray(mesh.vertices) for mesh in bodies(gripper, finger_m).values()])


def pad_gap_m(finger_m: float) -> float:
    """The gap between the pads of the Robotiq, which are the last pieces of its fingertips."""
    tips = bodies(robotiq_2f85(), finger_m)
    return float(
        tips[RobotPart.LEFT_FINGER].vertices[-8:, 1].min() - tips[RobotPart.RIGHT_FINGER].vertices[-8:, 1].max()
    )


def test_the_stroke_of_the_robotiq_is_that_of_its_data_sheet() -> None:
    assert 2 * robotiq_2f85().max_finger_m == pytest.approx(0.085, abs=0.002)
    assert 2 * franka_hand().max_finger_m == 2 * MAX_FINGER_M


@pytest.mark.parametrize("finger_m", [0.0, 0.01, 0.03, 0.043])
def test_the_gap_between_the_pads_is_twice_the_travel(finger_m: float) -> None:
    assert pad_gap_m(finger_m) == pytest.approx(2 * finger_m, abs=1e-6)


@pytest.mark.parametrize("finger_m", [0.0, 0.02, 0.04])
@GRIPPERS
def test_the_fingers_are_symmetric_under_half_a_turn(gripper: GripperModel, finger_m: float) -> None:
    points = whole(gripper, finger_m)
    fingers = points[points[:, 2] > 0.1]
    turned = fingers * [-1.0, -1.0, 1.0]
    distance = np.array([np.linalg.norm(fingers - point, axis=1).min() for point in turned[::10]])
    assert distance.max() < 1e-3


def test_knuckles_stay_attached_to_the_fingers_that_they_carry() -> None:
    """The distance between the meshes of a finger and of its outer knuckle hardly depends on the opening."""
    gripper = robotiq_2f85()
    for finger, knuckle in ((RobotPart.LEFT_FINGER, PARTS), (RobotPart.RIGHT_FINGER, PARTS + 2)):
        gaps = []
        for finger_m in (0.0, 0.02, 0.04):
            shown = bodies(gripper, finger_m)
            a = np.asarray(shown[finger].vertices)[::5]
            b = np.asarray(shown[knuckle].vertices)[::5]
            gaps.append(np.linalg.norm(a[:, None] - b, axis=2).min())
        assert max(gaps) < 0.004


@GRIPPERS
def test_bodies_move_with_the_frame_that_they_are_in(gripper: GripperModel) -> None:
    X_VH = trimesh.transformations.euler_matrix(0.3, -0.5, 1.0)
    X_VH[:3, 3] = [0.1, -0.2, 0.7]
    np.testing.assert_allclose(gripper.open(X_VH @ CLOSED, 0.02), X_VH @ gripper.open(CLOSED, 0.02), atol=1e-12)
    several = gripper.open(np.stack([CLOSED, X_VH @ CLOSED]), np.array([0.0, 0.02]))
    np.testing.assert_allclose(several[1], gripper.open(X_VH @ CLOSED, 0.02), atol=1e-12)
    np.testing.assert_allclose(several[0], gripper.complete(CLOSED), atol=1e-12)


def test_points_in_parts_move_along_y_with_the_fingers_alone() -> None:
    """What a fit shifts along y by the travel is where the point is."""
    gripper = robotiq_2f85()
    X_CB = trimesh.transformations.euler_matrix(0.2, 0.4, -0.3) @ gripper.open(CLOSED, 0.03)
    body = np.array([RobotPart.HAND, RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER, PARTS, PARTS + 3])
    p_B = np.random.default_rng(0).normal(0.0, 0.05, (len(body), 3))
    p_C = transform_points(X_CB[body], p_B[:, None])[:, 0]
    shifted = gripper.in_parts(body, p_B, p_C, X_CB) + np.array(
        [[0, 0, 0], [0, 0.03, 0], [0, -0.03, 0], [0] * 3, [0] * 3]
    )
    np.testing.assert_allclose(transform_points(invert(X_CB[RobotPart.HAND]), p_C), shifted, atol=1e-12)
