"""Contours at the flange: of a gripper whose fingers move along curves, and behind an unknown one."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_z, transform_points
from kinebench_drake.grounding.registration.arm_fit import LAST_LINKS
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher, unknown_gripper
from kinebench_drake.grounding.registration.image import GradientImage
from kinebench_drake.models.gripper import PARTS
from kinebench_drake.models.panda.description import GRIPPER, OPENING_SIGN, RobotPart
from kinebench_drake.models.robotiq.cad import robotiq_2f85

CAMERA = benchmark_camera()
POSTURE = np.array([[0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8]])
FINGER_M = 0.02


@pytest.fixture(scope="module")
def edges() -> EdgeMatcher:
    return EdgeMatcher(robotiq_2f85())


@pytest.fixture(scope="module")
def closed() -> Array:
    """The poses (PARTS, 4, 4) of the parts of an arm with that gripper, turned by an eighth on an adapter."""
    mounted = replace(robotiq_2f85(), X_MH=make_pose(rotation_z(np.pi / 4), [0.0, 0.0, 0.01]))
    return np.asarray(invert(CAMERA.X_BC) @ ArmModel(mounted).poses(POSTURE)[0])


@pytest.fixture(scope="module")
def image(edges: EdgeMatcher, closed: Array) -> GradientImage:
    """The robot in white before black, its gripper half open."""
    hit = edges.caster.cast(edges.gripper.open(closed, FINGER_M), CAMERA.rays().reshape(-1, 3))
    grey = np.where(hit.part > 0, 220, 30).astype(np.uint8).reshape(CAMERA.height, CAMERA.width, 1)
    return GradientImage(np.repeat(grey, 3, axis=2), CAMERA)


def test_the_contour_at_the_true_opening_agrees_best_with_the_image(
    edges: EdgeMatcher, closed: Array, image: GradientImage
) -> None:
    travels = np.array([0.0, 0.01, FINGER_M, 0.03, 0.04])
    agreement = [edges.agreement(image, edges.gripper.open(closed, travel), GRIPPER) for travel in travels]
    assert travels[np.argmax(agreement)] == FINGER_M
    assert max(agreement) > 2 * sorted(agreement)[-2]


def test_matched_points_of_every_body_lie_where_a_fit_of_hand_and_travel_puts_them(
    edges: EdgeMatcher, closed: Array
) -> None:
    points = edges.project(edges.gripper.open(closed, FINGER_M), CAMERA, GRIPPER)
    assert points is not None
    assert set(np.unique(points.part)) == set(GRIPPER)
    travel = np.array([OPENING_SIGN[RobotPart(part)] for part in points.part]) * FINGER_M
    p_H = points.p_P + travel[:, None] * np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(transform_points(closed[RobotPart.HAND], p_H), points.p_C, atol=1e-9)


def test_the_rigid_hand_has_no_contours_of_what_moves_with_the_fingers(edges: EdgeMatcher, closed: Array) -> None:
    assert edges.gripper.bodies_of([RobotPart.HAND]) == (RobotPart.HAND,)
    assert max(edges.gripper.bodies_of(GRIPPER)) >= PARTS
    rigid, whole = (edges.project(closed, CAMERA, parts) for parts in ((RobotPart.HAND,), GRIPPER))
    assert rigid is not None
    assert whole is not None
    assert (whole.part == RobotPart.HAND).sum() > len(rigid.part)


def test_an_unknown_gripper_occludes_the_same_link_contours_at_any_turn() -> None:
    X_CP = invert(CAMERA.X_BC) @ ArmModel().poses(POSTURE)[0]
    turned = X_CP.copy()
    turned[RobotPart.HAND] = turned[RobotPart.HAND] @ make_pose(rotation_z(np.pi / 2), np.zeros(3))
    removed = X_CP.copy()
    removed[RobotPart.HAND, 2, 3] = -10.0
    matcher = EdgeMatcher(unknown_gripper())
    shown = [matcher.project(X, CAMERA, LAST_LINKS, 5000) for X in (X_CP, turned, removed)]
    pixels = [np.empty((0, 2)) if points is None else points.pixel for points in shown]
    np.testing.assert_allclose(pixels[1], pixels[0], atol=1e-6)
    assert len(pixels[0]) < 0.98 * len(pixels[2])
