"""Fits of the arm, on views rendered from the CAD models of all its parts."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import (
    Array,
    invert,
    make_pose,
    pose_difference,
    rotation_exp,
    rotation_z,
    transform_points,
)
from kinebench_drake.grounding.registration.arm_fit import ArmFit, ArmFitter, ArmView
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.chain_fit import ChainFitter
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.fit import HandFit, fit
from kinebench_drake.grounding.registration.image import GradientImage
from kinebench_drake.grounding.registration.solver import Correspondences
from kinebench_drake.grounding.tracking.flange_tracker import FlangeTracker
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, Crop, GripperView
from kinebench_drake.models.panda.cad import PartCaster, link_meshes, open_fingers, part_meshes
from kinebench_drake.models.panda.description import ARM, OPENING_SIGN, GripperKind, RobotPart
from kinebench_drake.models.robotiq.cad import robotiq_mesh

CAMERA = benchmark_camera()
FINGER_M = 0.025


@pytest.fixture(scope="module")
def model() -> ArmModel:
    return ArmModel()


def posture(seed: int) -> Array:
    """A posture with the gripper in the middle of the image, pointing down."""
    rng = np.random.default_rng(seed)
    return np.array([0.0, 0.1, 0.0, -2.2, 0.0, 2.3, np.pi / 4]) + rng.normal(0, 0.12, 7)


def view(model: ArmModel, q: Array, crop: Crop, *, noise_m: float, depth_factor: float, seed: int) -> GripperView:
    """Dense estimates with coordinate noise `noise_m` and depth off by a common factor."""
    rng = np.random.default_rng(seed)
    X_VP = invert(crop.X_CV) @ invert(CAMERA.X_BC) @ model.poses(q[None])[0]
    n = crop.size // 2
    part = np.zeros((n, n), np.uint8)
    depth = np.full((n, n), np.inf)
    coordinates = np.zeros((n, n, 3))
    for value, mesh in {**part_meshes(), **link_meshes()}.items():
        points = trimesh.sample.sample_surface(mesh, 6000, seed=seed)[0]
        opened = points + np.array([0.0, OPENING_SIGN.get(value, 0.0) * FINGER_M, 0.0])
        p_V = transform_points(X_VP[value], opened)
        u, v = np.floor(p_V[:, :2] / p_V[:, 2:] * crop.focal / 2 + n / 2).astype(int).T
        for i in np.flatnonzero((p_V[:, 2] > 0.1) & (u >= 0) & (u < n) & (v >= 0) & (v < n)):
            if p_V[i, 2] < depth[v[i], u[i]]:
                depth[v[i], u[i]] = p_V[i, 2]
                part[v[i], u[i]] = value
                coordinates[v[i], u[i]] = points[i]
    return GripperView(
        crop=crop,
        stride=2,
        in_image=np.ones((n, n), dtype=bool),
        part=part,
        depth_m=np.where(np.isfinite(depth), depth, 1.0) * depth_factor,
        depth_sigma=np.full((n, n), 0.01),
        depth_factor_sigma=0.012,
        coordinates_P=coordinates + rng.normal(0, noise_m, coordinates.shape),
        coordinates_sigma_m=np.full((n, n), max(noise_m, 1e-3)),
    )


def hand_alone(close: GripperView, crop: Crop) -> GripperView:
    """A view without the arm, attributed to another crop."""
    part = np.where(close.part >= RobotPart.LINK0, 0, close.part).astype(np.uint8)
    return replace(close, crop=crop, part=part)


@pytest.fixture(scope="module", params=range(3))
def scene(request: pytest.FixtureRequest, model: ArmModel) -> tuple[Array, GripperView, GripperView]:
    """True pose of the hand in the camera frame, close and wide view with depth 3 % too large."""
    return views(model, posture(request.param), request.param)


def views(model: ArmModel, q: Array, seed: int) -> tuple[Array, GripperView, GripperView]:
    """Pose of the hand, close and wide view of a posture, depth 3 % too large."""
    X_CH = invert(CAMERA.X_BC) @ model.poses(q[None])[0, RobotPart.HAND]
    crops = Crop.of_gripper(X_CH, 1.3, CLOSE_SIZE), Crop.of_frame(CAMERA)
    close, wide = (view(model, q, crop, noise_m=0.003, depth_factor=1.03, seed=seed) for crop in crops)
    return X_CH, close, wide


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


def drawn(model: ArmModel, q: Array, gripper: trimesh.Trimesh | None = None, stains: float = 0.0) -> NDArray[np.uint8]:
    """An image of the robot in one grey, before a darker one; with another gripper, or stains of that contrast."""
    X_CP = open_fingers(invert(CAMERA.X_BC) @ model.poses(q[None])[0], FINGER_M)
    meshes = part_meshes() if gripper is None else {RobotPart.HAND: gripper}
    hit = PartCaster({**meshes, **link_meshes()}).cast(X_CP, CAMERA.rays().reshape(-1, 3))
    # A grey of its own for each part: contours between parts count as well.
    grey = np.where(hit.part > 0, 120.0 + 12.0 * hit.part, 50.0)
    shown = hit.part > 0
    p_C = (CAMERA.rays().reshape(-1, 3) * hit.distance[:, None])[shown]
    p_P = transform_points(invert(X_CP)[hit.part[shown]], p_C[:, None])[:, 0]
    grey[shown] += stains * np.sin(p_P @ np.random.default_rng(0).normal(0.0, 150.0, (3, 6))).mean(axis=1)
    return np.repeat(grey.clip(0, 255).astype(np.uint8).reshape(CAMERA.height, CAMERA.width, 1), 3, axis=2)


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
    gripper = trimesh.creation.box([0.07, 0.09, 0.10]).apply_translation([0.0, 0.0, 0.05])
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


@pytest.mark.parametrize(
    ("mount", "kind"),
    [
        (0.0, GripperKind.NONE),
        (np.pi / 4, GripperKind.ROBOTIQ_2F85),
        pytest.param(np.pi / 4, GripperKind.NONE, marks=pytest.mark.exhaustive),
        pytest.param(0.0, GripperKind.ROBOTIQ_2F85, marks=pytest.mark.exhaustive),
    ],
)
def test_contours_correct_the_flange_turn_of_a_robot_with_another_gripper(
    model: ArmModel, mount: float, kind: GripperKind
) -> None:
    q = posture(1) + 0.015 * np.arange(2)[:, None] * np.array([1.0, -1.0, 0.0, 1.0, 0.0, 1.0, 1.0])
    gripper = robotiq_mesh(0.35).apply_transform(make_pose(rotation_z(mount), [0.0, 0.0, 0.004]))
    frames = np.stack([drawn(model, each, gripper) for each in q])
    X_CH = invert(CAMERA.X_BC) @ model.poses(q)[:, RobotPart.HAND]
    poses = FlangeTracker(TurnedEstimator(model, q, np.deg2rad(12.0)), kind).track(frames, CAMERA).poses
    distance, angle = pose_difference(np.stack([pose.X_CH for pose in poses if pose is not None]), X_CH)
    assert distance.max() < 0.006
    assert np.rad2deg(angle).max() < 3.0
