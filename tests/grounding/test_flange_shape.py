"""Contours at the flange, with a gripper whose shape is known and with an unknown one."""

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_z
from kinebench_drake.grounding.registration.arm_fit import LAST_LINKS
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import FlangeShape, links_shape, robotiq_shape
from kinebench_drake.grounding.registration.image import GradientImage
from kinebench_drake.models.panda.description import RobotPart

CAMERA = benchmark_camera()


@pytest.fixture(scope="module")
def scene() -> tuple[FlangeShape, GradientImage, Array]:
    """A gripper, the image of the robot in white before black, and the poses of its parts."""
    shape = robotiq_shape(0.0, 0.0, openings=3)
    X_CP = invert(CAMERA.X_BC) @ ArmModel().poses(np.array([[0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8]]))[0]
    hit = shape.edges[1].caster.cast(X_CP, CAMERA.rays().reshape(-1, 3))
    grey = np.where(hit.part > 0, 220, 30).astype(np.uint8).reshape(CAMERA.height, CAMERA.width, 1)
    return shape, GradientImage(np.repeat(grey, 3, axis=2), CAMERA), X_CP


def turn_gripper(X_CP: Array, turn_rad: float) -> Array:
    """Return poses of the parts with the gripper turned on the flange [rad]."""
    X_CP = X_CP.copy()
    X_CP[RobotPart.HAND] = X_CP[RobotPart.HAND] @ make_pose(rotation_z(turn_rad), np.zeros(3))
    return X_CP


def test_the_true_opening_of_the_gripper_agrees_best_with_the_image(
    scene: tuple[FlangeShape, GradientImage, Array],
) -> None:
    shape, image, X_CP = scene
    assert shape.gripper_agreement(image, X_CP).argmax() == 1
    assert shape.at_likeliest(image, X_CP).edges == (shape.edges[1],)


def test_a_hidden_gripper_contributes_no_agreement(scene: tuple[FlangeShape, GradientImage, Array]) -> None:
    shape, image, X_CP = scene
    behind = X_CP.copy()
    behind[RobotPart.HAND, 2, 3] = -10.0
    links = shape.edges[0].agreement(image, behind, LAST_LINKS)
    assert shape.agreement(image, behind, LAST_LINKS) == pytest.approx(0.5 * links)
    assert shape.agreement(image, X_CP, LAST_LINKS) > 0.6


def test_agreement_is_the_same_after_half_a_turn_of_the_gripper(
    scene: tuple[FlangeShape, GradientImage, Array],
) -> None:
    shape, image, X_CP = scene
    still, half, quarter = (
        shape.gripper_agreement(image, turn_gripper(X_CP, turn)) for turn in (0.0, np.pi, np.pi / 2)
    )
    assert half == pytest.approx(still, abs=0.05)
    assert quarter[1] < 0.8 * still[1]


def test_an_unknown_gripper_occludes_the_same_link_contours_at_any_turn(
    scene: tuple[FlangeShape, GradientImage, Array],
) -> None:
    *_, X_CP = scene
    turned = turn_gripper(X_CP, np.pi / 2)
    removed = X_CP.copy()
    removed[RobotPart.HAND, 2, 3] = -10.0
    (matcher,) = links_shape().edges
    shown = [matcher.project(X, CAMERA, LAST_LINKS, 5000) for X in (X_CP, turned, removed)]
    pixels = [np.empty((0, 2)) if points is None else points.pixel for points in shown]
    np.testing.assert_allclose(pixels[1], pixels[0], atol=1e-6)
    assert len(pixels[0]) < 0.98 * len(pixels[2])
