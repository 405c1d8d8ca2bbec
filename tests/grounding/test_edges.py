"""Contours of the robot matched to images, on images drawn by ray casting."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.grounding.registration.arm_model import ArmHandModel, ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.hand_contour import (
    GAPS_M,
    MOUNTS_M,
    HandImage,
    HandShape,
    fit_shape,
    gap_log_likelihoods,
)
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage
from kinebench_drake.grounding.registration.solver import Correspondences, solve
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.cad import PartCaster, franka_hand, link_meshes
from kinebench_drake.models.panda.description import RobotPart

CAMERA = benchmark_camera().resized(320, 320)
FINGER_M = 0.03
POSTURES = [[0.0, 0.1, 0.0, -2.2, 0.0, 2.3, 0.8], [0.5, 0.3, -0.3, -1.9, 0.2, 2.2, 0.2]]


@pytest.fixture(scope="module")
def matcher() -> EdgeMatcher:
    return EdgeMatcher()


@pytest.fixture(scope="module")
def model() -> ArmModel:
    return ArmModel()


def part_poses(model: ArmModel, q: Array, camera: Camera = CAMERA) -> Array:
    return franka_hand().open(invert(camera.X_BC) @ model.poses(np.asarray(q)[None])[0], FINGER_M)


def draw(X_CP: Array, seed: int, gripper: GripperModel | None = None) -> NDArray[np.uint8]:
    """A shaded robot before a plain background, with noise; with `gripper` in place of its hand and fingers."""
    rng = np.random.default_rng(seed)
    rays = CAMERA.rays().reshape(-1, 3)
    hit = PartCaster(gripper or franka_hand(), link_meshes()).cast(X_CP, rays)
    shade = 120.0 + 120.0 * np.abs(hit.normal @ [0.3, -0.8, -0.5])
    grey = np.where(hit.part > 0, shade, 50.0) + rng.normal(0, 4.0, len(rays))
    return np.repeat(np.clip(grey, 0, 255).astype(np.uint8).reshape(CAMERA.height, CAMERA.width, 1), 3, axis=2)


@pytest.mark.parametrize("posture", POSTURES)
def test_matching_contours_moves_a_wrong_posture_towards_the_true_one(
    matcher: EdgeMatcher, model: ArmModel, posture: list[float]
) -> None:
    q = np.array(posture)
    image = GradientImage(draw(part_poses(model, q), 0), CAMERA)
    arm = ArmHandModel(
        model=model,
        X_CB=invert(CAMERA.X_BC)[None],
        q=q[None],
        q_start=q[None],
        finger_m=np.array([FINGER_M]),
        finger_free=np.array([False]),
    )
    X_true = arm.hand()[0][0]
    start = (q + 0.01 * np.array([1, -1, 1, 1, -1, 1, -1]))[None]
    arm = replace(arm, q=start, q_start=start)
    before = pose_difference(arm.hand()[0][0], X_true)
    for reach in (10.0, 6.0, 4.0, 3.0):
        edges = matcher.match(image, part_poses(model, arm.q[0]), reach)
        assert edges is not None
        solution = solve(arm, Correspondences.stack([edges]), np.array([0.1]), iterations=4)
        assert solution.valid.all()
        arm = solution.model
    after = pose_difference(arm.hand()[0][0], X_true)
    assert before[0] > 0.008
    assert after[0] < 0.004
    assert after[1] < np.deg2rad(2.5)


@pytest.mark.parametrize("posture", POSTURES)
def test_the_true_posture_agrees_with_the_image_more_than_a_wrong_one(
    matcher: EdgeMatcher, model: ArmModel, posture: list[float]
) -> None:
    q = np.array(posture)
    image = GradientImage(draw(part_poses(model, q), 1), CAMERA)
    right = matcher.agreement(image, part_poses(model, q))
    assert right > 0.55
    for seed in range(4):
        wrong = q + np.random.default_rng(seed).normal(0, 0.1, 7)
        assert matcher.agreement(image, part_poses(model, wrong)) < right - 0.2


def test_contour_points_lie_on_the_border_of_the_drawn_robot(matcher: EdgeMatcher, model: ArmModel) -> None:
    """Along its normal every point has the surface behind it, and something farther ahead."""
    X_CP = part_poses(model, np.array(POSTURES[0]))
    points = matcher.project(X_CP, CAMERA)
    assert points is not None
    assert len(points.part) > 100
    np.testing.assert_allclose(CAMERA.project(points.p_C), points.pixel, atol=1e-6)
    caster = PartCaster(franka_hand(), link_meshes())
    depths = []
    for sign in (-2.0, 2.0):
        pixel = points.pixel + sign * points.normal
        rays = np.column_stack([(pixel - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy], np.ones(len(pixel))])
        depths.append(caster.cast(X_CP, rays).distance)
    assert (depths[1] > depths[0] + 0.01).mean() > 0.9


def vertical_edge(x: float, count: int = 30, part: RobotPart = RobotPart.HAND) -> EdgePoints:
    """Points of an outline at column `x`, whose outer side is the right one."""
    pixel = np.column_stack([np.full(count, x), np.linspace(60.0, 260.0, count)])
    return EdgePoints(
        part=np.full(count, part, np.uint8),
        p_P=np.zeros((count, 3)),
        p_C=np.zeros((count, 3)),
        pixel=pixel,
        normal=np.tile([1.0, 0.0], (count, 1)),
    )


def stripes(borders: list[int], greys: list[int]) -> NDArray[np.uint8]:
    """Vertical stripes of `greys`, each from its border on."""
    row = np.full(CAMERA.width, greys[0], np.uint8)
    for border, grey in zip(borders, greys[1:], strict=True):
        row[border:] = grey
    return np.tile(row[None, :, None], (CAMERA.height, 1, 3))


def test_an_outline_matches_the_outermost_strong_edge() -> None:
    image = GradientImage(stripes([150, 153], [220, 60, 150]), CAMERA)
    for start in (149.0, 152.0, 154.0):
        offset, _ = image.find_edges(vertical_edge(start), 6.0)
        np.testing.assert_allclose(start + offset, 153.0, atol=0.5)
    weak = GradientImage(stripes([150, 152], [220, 60, 75]), CAMERA)
    offset, _ = weak.find_edges(vertical_edge(151.0), 6.0)
    np.testing.assert_allclose(151.0 + offset, 150.0, atol=0.5)


def test_the_segmentation_rim_selects_the_edge_of_the_hand_alone() -> None:
    image = GradientImage(stripes([150, 158], [220, 100, 190]), CAMERA)
    gripper = np.zeros((CAMERA.height, CAMERA.width), bool)
    gripper[:, 80:157] = True
    with_hand = image.with_hand(gripper, 2.0)
    start = 153.0
    for part, edge in ((RobotPart.HAND, 158.0), (RobotPart.LINK7, 150.0)):
        offset, _ = with_hand.find_edges(vertical_edge(start, part=part), 8.0)
        np.testing.assert_allclose(start + offset, edge, atol=0.5)


def test_an_image_without_edges_gives_no_correspondences(matcher: EdgeMatcher, model: ArmModel) -> None:
    blank = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    assert matcher.match(GradientImage(blank, CAMERA), part_poses(model, np.array(POSTURES[0])), 6.0) is None


def draw_hand_of_size(model: ArmModel, posture: list[float], size: float) -> tuple[GradientImage, Array]:
    """A drawn robot whose hand and fingers are `size` times as large, about the flange; and the poses of its parts."""
    X_CP = part_poses(model, np.array(posture))
    meshes = franka_hand().parts
    scaled = replace(franka_hand(), parts={part: mesh.copy().apply_scale(size) for part, mesh in meshes.items()})
    hand = X_CP[RobotPart.HAND, :3, 3]
    moved = X_CP.copy()
    for part in meshes:
        moved[part, :3, 3] = hand + size * (X_CP[part, :3, 3] - hand)
    return GradientImage(draw(moved, 0, scaled), CAMERA), X_CP


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("size", [0.85, 1.15])
def test_the_contour_of_a_hand_of_another_size_gains_agreement_at_its_size(
    matcher: EdgeMatcher, model: ArmModel, posture: list[float], size: float
) -> None:
    shape = fit_shape(matcher, *draw_hand_of_size(model, posture, size))
    assert shape is not None
    assert shape.log_scale == pytest.approx(np.log(size), abs=0.05)
    assert shape.gain > 0.15


@pytest.mark.parametrize("posture", POSTURES)
def test_the_contour_of_a_hand_of_the_right_size_gains_nothing(
    matcher: EdgeMatcher, model: ArmModel, posture: list[float]
) -> None:
    assert fit_shape(matcher, *draw_hand_of_size(model, posture, 1.0)) == HandShape()


@pytest.mark.parametrize("mount_m", MOUNTS_M)
def test_the_likeliest_gap_is_that_of_the_image_for_either_mount_of_the_fingers(
    matcher: EdgeMatcher, model: ArmModel, mount_m: float
) -> None:
    closed = invert(CAMERA.X_BC) @ model.poses(np.array(POSTURES[:1]))[0]
    hands = {}
    gaps = (0.008, 0.04, 0.07)
    for number, gap in enumerate(gaps):
        shown = franka_hand().open(closed, gap / 2)
        fingers = [RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER]
        shown[fingers, :3, 3] += mount_m * shown[fingers, :3, 2]
        hands[number] = HandImage(image=GradientImage(draw(shown, number), CAMERA), X_CP=closed)
    assert gap_log_likelihoods(matcher, {}) == {}
    likelihoods = gap_log_likelihoods(matcher, hands)
    for number, gap in enumerate(gaps):
        assert abs(GAPS_M[likelihoods[number].argmax()] - gap) <= 0.004
