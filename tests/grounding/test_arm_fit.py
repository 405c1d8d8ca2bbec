"""Fits of the arm, on views rendered from the CAD models of all its parts."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import (
    Array,
    invert,
    make_pose,
    pose_difference,
    rotation_exp,
    rotation_z,
)
from kinebench_drake.grounding.registration.arm_fit import ArmFit, ArmFitter, ArmView
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.fit import HandFit, fit
from kinebench_drake.grounding.registration.image import GradientImage
from kinebench_drake.grounding.registration.solver import Correspondences
from kinebench_drake.grounding.tracking.flange_fit import ChainFitter
from kinebench_drake.grounding.tracking.flange_tracker import FlangeTracker
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, Crop, GripperView
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.description import ARM, RobotPart
from kinebench_drake.models.robotiq.cad import robotiq_2f85
from tests.grounding.robots import CAMERA, FINGER_M, drawn, posture, view, views


@pytest.fixture(scope="module")
def model() -> ArmModel:
    return ArmModel()


def hand_alone(close: GripperView, crop: Crop) -> GripperView:
    """A view without the arm, attributed to another crop."""
    part = np.where(close.part >= RobotPart.LINK0, 0, close.part).astype(np.uint8)
    return replace(close, crop=crop, part=part)


@pytest.fixture(scope="module", params=range(3))
def scene(request: pytest.FixtureRequest, model: ArmModel) -> tuple[Array, GripperView, GripperView]:
    """True pose of the hand in the camera frame, close and wide view with depth 3 % too large."""
    return views(model, posture(request.param), request.param)


def fit_arm(fitter: ArmFitter, hand: HandFit, close: GripperView, wide: GripperView) -> ArmFit | None:
    """Fit the arm behind one hand, without silhouette."""
    return fitter.fit_all([ArmView.of(hand, close, wide)], [None])[0]


def test_the_arm_corrects_the_distance_of_the_hand(
    scene: tuple[Array, GripperView, GripperView], model: ArmModel
) -> None:
    X_CH, close, wide = scene
    hand = fit(close)
    assert hand is not None
    arm = fit_arm(ArmFitter(CAMERA, model, EdgeMatcher()), hand, close, wide)
    assert arm is not None
    assert arm.agrees
    assert arm.consistency_px < 3.0
    assert arm.evidence > 0.5
    assert arm.finger_m == pytest.approx(FINGER_M, abs=1.5e-3)
    distance, angle = pose_difference(arm.X_CH, X_CH)
    assert distance < 0.5 * pose_difference(hand.X_CH, X_CH)[0]
    assert distance < 0.004
    assert np.rad2deg(angle) < 0.7
    np.testing.assert_allclose(CAMERA.X_BC @ arm.X_CH, model.poses(arm.q[None])[0, RobotPart.HAND], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_edges_correct_an_offset_common_to_all_coordinates(model: ArmModel, seed: int) -> None:
    q = posture(seed)
    X_CH, close, wide = views(model, q, seed)
    shift = 0.004 * np.array([1.0, 0.0, 1.0])  # of the coordinates, which noise would not average
    close, wide = (replace(v, coordinates_P=v.coordinates_P + shift) for v in (close, wide))
    hand = fit(close)
    fitter = ArmFitter(CAMERA, model, EdgeMatcher())
    assert hand is not None
    arm = fit_arm(fitter, hand, close, wide)
    assert arm is not None
    before = pose_difference(arm.X_CH, X_CH)[0]
    view = ArmView.of(hand, close, wide)
    sharp = fitter.sharpen_all([arm], [view], [GradientImage(drawn(model, q), CAMERA)])[0]
    assert pose_difference(sharp.X_CH, X_CH)[0] < 0.75 * before
    blank = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    assert fitter.sharpen_all([arm], [view], [GradientImage(blank, CAMERA)])[0] is arm


def test_a_hand_displaced_from_the_arm_does_not_agree_with_it(
    scene: tuple[Array, GripperView, GripperView], model: ArmModel
) -> None:
    _, close, wide = scene
    hand = fit(close)
    assert hand is not None
    moved = Crop.towards([0.12, 0.0, 1.0], CLOSE_SIZE / 2 / close.crop.focal, CLOSE_SIZE)
    away = hand_alone(close, moved)
    elsewhere = fit(away)
    assert elsewhere is not None
    arm = fit_arm(ArmFitter(CAMERA, model, EdgeMatcher()), elsewhere, away, wide)
    assert arm is None or not arm.agrees


def test_the_scale_of_the_arm_fit_shows_an_oversized_hand(
    scene: tuple[Array, GripperView, GripperView], model: ArmModel
) -> None:
    """A hand 8 % too large appears 8 % nearer than the arm implies."""
    X_CH, close, wide = scene
    fitter = ArmFitter(CAMERA, model, EdgeMatcher())
    hand = fit(close)
    assert hand is not None
    usual = fit_arm(fitter, hand, close, wide)
    near = Crop.of_gripper(X_CH, 1.3, CLOSE_SIZE)
    larger = Crop(R_CV=near.R_CV, focal=near.focal / 1.08, size=near.size)
    grown = hand_alone(close, larger)
    large_hand = fit(grown)
    assert large_hand is not None
    large = fit_arm(fitter, large_hand, grown, wide)
    assert usual is not None
    assert large is not None
    assert large.scale / usual.scale == pytest.approx(1.08, abs=0.04)


def test_a_view_without_links_has_no_arm_fit(scene: tuple[Array, GripperView, GripperView], model: ArmModel) -> None:
    _, close, wide = scene
    hand = fit(close)
    assert hand is not None
    close, wide = (
        replace(v, part=np.where(v.part >= RobotPart.LINK0, 0, v.part).astype(np.uint8)) for v in (close, wide)
    )
    assert fit_arm(ArmFitter(CAMERA, model, EdgeMatcher()), hand, close, wide) is None


def link_cells(*views: GripperView) -> Correspondences:
    """The cells of the links alone, as with a gripper that is not Franka's."""
    return Correspondences.join([Correspondences.of_view(v, np.isin(v.part, ARM)) for v in views])


@pytest.mark.parametrize("seed", range(3))
def test_the_links_determine_the_flange_only_if_link_7_is_visible(model: ArmModel, seed: int) -> None:
    X_CH, close, wide = views(model, posture(seed), seed)
    solution = ChainFitter(model).fit(link_cells(close, wide))
    assert solution is not None
    distance, angle = pose_difference(solution.model.X_CH[0], X_CH)
    assert distance < 0.025
    assert np.rad2deg(angle) < 3.0
    hidden = link_cells(close, wide)
    assert ChainFitter(model).fit(hidden.take(hidden.part != RobotPart.LINK7)) is None


def test_turning_joint_7_moves_no_link_before_it(model: ArmModel) -> None:
    q = posture(1)
    fitter = ChainFitter(model)
    X_BP = model.poses(q[None])[0]
    chain = fitter.at(X_BP[RobotPart.HAND], q)
    angles = np.array([q[6], q[6] + 0.5, -1.0])
    X_CP = fitter.turned(chain, angles).place().X_CP
    for angle, X in zip(angles, X_CP, strict=True):
        np.testing.assert_allclose(X, model.poses(np.array([[*q[:6], angle]]))[0], atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_base_and_link_edges_refine_the_flange_pose(model: ArmModel, seed: int) -> None:
    q = posture(seed)
    X_CH, close, wide = views(model, q, seed)
    start = X_CH @ make_pose(rotation_exp([0.03, 0.0, 0.05]), [0.01, 0.0, 0.01])
    image = GradientImage(drawn(model, q), CAMERA)
    arm = ArmFitter(CAMERA, model, EdgeMatcher()).fit_links(start, 0.1, link_cells(close, wide), image)
    assert arm is not None
    assert arm.agrees
    distance, angle = pose_difference(arm.X_CH, X_CH)
    assert distance < 0.005
    assert np.rad2deg(angle) < 1.0


class PartialEstimator:
    """Views of a video whose network sees the robot in some frames alone."""

    def __init__(self, model: ArmModel, q: Array, blind: set[int]) -> None:
        self._model = model
        self._q = q
        self._blind = blind

    def estimate(
        self, frames: NDArray[np.uint8], camera: Camera, crops: Mapping[int, Crop]
    ) -> Iterator[tuple[int, GripperView]]:
        for i, crop in crops.items():
            shown = view(self._model, self._q[i], crop, noise_m=0.003, depth_factor=1.03, seed=i)
            yield i, replace(shown, part=np.zeros_like(shown.part)) if i in self._blind else shown


# Of other seeds the wrist leaves the image.
@pytest.mark.parametrize("seed", [0, 7, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in (1, 2, 6))])
def test_the_flange_is_tracked_through_frames_without_network_detections(model: ArmModel, seed: int) -> None:
    q = posture(seed) + 0.015 * np.arange(4)[:, None] * np.array([1.0, -1.0, 0.0, 1.0, 0.0, 1.0, 1.0])
    blind = {2, 3}
    box = trimesh.creation.box([0.07, 0.09, 0.10]).apply_translation([0.0, 0.0, 0.05])
    gripper = GripperModel(parts={RobotPart.HAND: box}, max_finger_m=0.0)
    frames = np.stack([drawn(model, each, gripper, stains=40.0) for each in q])
    poses = FlangeTracker(PartialEstimator(model, q, blind)).track(frames, CAMERA).poses
    X_CH = invert(CAMERA.X_BC) @ model.poses(q)[:, RobotPart.HAND]
    for i, (pose, X) in enumerate(zip(poses, X_CH, strict=True)):
        assert pose is not None
        distance, angle = pose_difference(pose.X_CH, X)
        R = X[:3, :3].T @ pose.X_CH[:3, :3]
        axis = pose.X_CH[:3, 2]
        turn = np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
        assert abs(turn) < 2.0 * np.sqrt(axis @ pose.covariance[:3, :3] @ axis)
        if i in blind:
            assert distance < 0.02
        else:
            assert distance < 0.003
            assert np.rad2deg(angle) < 1.5


def test_the_fitter_of_a_moving_camera_uses_the_place_of_each_frame(model: ArmModel) -> None:
    places = np.array([[0.0, 0.0, 0.0], [0.05, -0.02, 0.03]])
    fitter = ArmFitter(CAMERA, model, EdgeMatcher(), places)
    q = posture(0)
    image = GradientImage(drawn(model, q), CAMERA)
    assert fitter.at([0]).edge_agreement(q, image) > 2 * fitter.at([1]).edge_agreement(q, image)


def test_batch_fits_of_a_moving_camera_equal_those_of_single_frames(model: ArmModel) -> None:
    """The camera of the second frame is at the place of the first one's, so that both see the same."""
    _, close, wide = views(model, posture(0), 0)
    hand = fit(close)
    image = GradientImage(drawn(model, posture(0)), CAMERA)
    assert hand is not None
    places = np.array([[0.05, -0.02, 0.03], [0.0, 0.0, 0.0], [0.01, 0.0, 0.01]])
    moving = ArmFitter(CAMERA, model, EdgeMatcher(), places)
    numbers = [1, 2]
    count = 2
    shown = [ArmView.of(hand, close, wide)] * count
    arms = moving.at(numbers).fit_all(shown, [None] * count)
    fixed = fit_arm(ArmFitter(CAMERA, model, EdgeMatcher()), hand, close, wide)
    assert fixed is not None
    assert arms[0] is not None
    np.testing.assert_allclose(arms[0].X_CH, fixed.X_CH, atol=1e-8)
    both = [arm for arm in arms if arm is not None]
    sharp = moving.at(numbers).sharpen_all(both, shown, [image] * count)
    for number, arm, one in zip(numbers, arms, sharp, strict=True):
        alone = moving.at([number])
        same = fit_arm(alone, hand, close, wide)
        assert arm is not None
        assert same is not None
        np.testing.assert_allclose(arm.q, same.q, atol=1e-8)
        sharp_alone = alone.sharpen_all([same], shown[:1], [image])[0]
        np.testing.assert_allclose(one.q, sharp_alone.q, atol=1e-8)
    assert pose_difference(both[1].X_CH, both[0].X_CH)[0] > 1e-3


class TurnedEstimator(PartialEstimator):
    """Views whose network takes the last link to be turned, as it may where its looks are new."""

    def __init__(self, model: ArmModel, q: Array, error_rad: float) -> None:
        super().__init__(model, q + error_rad * (np.arange(7) == 6), set())


@pytest.mark.parametrize("mount", [0.0, pytest.param(np.pi / 4, marks=pytest.mark.exhaustive)])
def test_contours_correct_the_flange_turn_of_a_robot_with_another_gripper(model: ArmModel, mount: float) -> None:
    q = posture(1) + 0.015 * np.arange(2)[:, None] * np.array([1.0, -1.0, 0.0, 1.0, 0.0, 1.0, 1.0])
    gripper = replace(robotiq_2f85(), X_MH=make_pose(rotation_z(mount), [0.0, 0.0, 0.004]))
    mounted = ArmModel(gripper)
    frames = np.stack([drawn(mounted, each, gripper) for each in q])
    X_CH = invert(CAMERA.X_BC) @ model.poses(q)[:, RobotPart.HAND]
    poses = FlangeTracker(TurnedEstimator(model, q, np.deg2rad(12.0))).track(frames, CAMERA).poses
    distance, angle = pose_difference(np.stack([pose.X_CH for pose in poses if pose is not None]), X_CH)
    assert distance.max() < 0.006
    assert np.rad2deg(angle).max() < 3.0
