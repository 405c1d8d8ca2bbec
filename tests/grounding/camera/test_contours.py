"""Cameras fitted to the contours of the robot, on images drawn by ray casting."""

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import invert, pose_difference
from kinebench_drake.grounding.camera import check as contradiction
from kinebench_drake.grounding.camera import estimate as estimate_module
from kinebench_drake.grounding.camera import lens
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, Prior
from kinebench_drake.grounding.camera.candidate import DIFFERENT_TURN_RAD, BaseTurn, CameraCandidate
from kinebench_drake.grounding.camera.check import CLEARLY, CameraChecker
from kinebench_drake.grounding.camera.detections import ArmDetections
from kinebench_drake.grounding.camera.estimate import JOINT_SIGMA_RAD, CameraEstimator, usual_camera
from kinebench_drake.grounding.camera.lens import Lens, solve_pnp, with_focal
from kinebench_drake.models.panda.cad import PartCaster, franka_hand, link_meshes
from kinebench_drake.models.panda.description import RobotPart, hand_from_tcp
from kinebench_drake.track import GripperTrack
from tests.grounding.camera.robot import postures, project_robot

CAMERA = benchmark_camera().resized(320, 320)
FINGER_M = 0.03
EDGES_M = 3e-3  # of the camera, by the edges of these images alone


@pytest.fixture(scope="module")
def estimator():
    return CameraEstimator(None)  # the networks are not asked


@pytest.fixture(scope="module")
def film(model):
    """Postures and images of a shaded robot before a plain background, with noise."""
    q = postures(3)
    rng = np.random.default_rng(0)
    caster = PartCaster(franka_hand(), link_meshes())
    rays = CAMERA.rays().reshape(-1, 3)
    frames = []
    for X_BP in model.poses(q):
        hit = caster.cast(franka_hand().open(invert(CAMERA.X_BC) @ X_BP, FINGER_M), rays)
        shade = 120.0 + 120.0 * np.abs(hit.normal @ [0.3, -0.8, -0.5])
        grey = np.where(hit.part > 0, shade, 50.0) + rng.normal(0, 4.0, len(rays))
        frames.append(np.repeat(np.clip(grey, 0, 255).astype(np.uint8).reshape(320, 320, 1), 3, axis=2))
    return q, np.stack(frames)


def start(q, model, step):
    lens = Lens.of_camera(CAMERA).displace(np.array([*step, 0.0, 0.0]))
    scene = ArmScene(lens=lens, q=q, finger_m=np.full(len(q), FINGER_M))
    cells = project_robot(CAMERA, q, model, finger_m=FINGER_M)
    return CameraCandidate(scene=scene, rows=np.arange(len(q)), cells=cells, costs=np.zeros(len(q)), cost=0.0)


@pytest.mark.parametrize("joint_sigma_rad", [JOINT_SIGMA_RAD, 0.1 * JOINT_SIGMA_RAD])
def test_the_camera_from_contours_is_as_precise_as_the_joint_angles(
    estimator, model, film, monkeypatch, joint_sigma_rad
):
    """If all joints may be off, so may the camera's turn about the robot: by their error times its distance."""
    monkeypatch.setattr(estimate_module, "JOINT_SIGMA_RAD", joint_sigma_rad)
    q, frames = film
    wrong = start(q, model, [0.01, -0.01, 0.01, 0.01, -0.01, 0.02, 0.0])
    estimate = estimator.refine(frames, CAMERA, wrong, focal_free=False)
    distance, angle = pose_difference(estimate.camera.X_BC, CAMERA.X_BC)
    lever_m = joint_sigma_rad * np.linalg.norm(CAMERA.X_BC[:3, 3])
    assert distance < max(lever_m, EDGES_M)
    assert angle < np.deg2rad(0.35)
    assert distance < 2 * estimate.position_sigma_m < 3 * max(lever_m, EDGES_M)
    assert estimate.agreement > 0.6
    assert estimate.camera.fx == CAMERA.fx


def test_a_wrong_camera_agrees_less_with_the_contours_than_the_true_one(estimator, model, film):
    q, frames = film
    images = estimator.fitter.images(frames, CAMERA)
    right = images.agreement(start(q, model, np.zeros(7)).scene)
    wrong = images.agreement(start(q, model, [0.0, 0.1, 0.0, 0.05, 0.0, 0.0, 0.0]).scene)
    assert right.shape == (3,)
    assert right.min() > 0.6
    assert wrong.max() < right.min() - 0.2


@pytest.mark.parametrize("turn_deg", [-50.0, 30.0])
def test_the_contours_of_the_base_determine_its_turn_about_joint_1(estimator, model, film, turn_deg):
    q, frames = film
    images = estimator.fitter.images(frames, CAMERA)
    right = start(q, model, np.zeros(7)).scene
    wrong = right.turned(np.deg2rad(turn_deg))
    X_CP = right.lens.X_CB @ model.poses(right.q)
    same = wrong.lens.X_CB @ model.poses(wrong.q)
    arm = [part for part in RobotPart if part > RobotPart.LINK0 or part == RobotPart.HAND]
    assert np.allclose(X_CP[:, arm], same[:, arm])
    turns = images.find_turns(wrong)
    assert np.rad2deg(turns[0].angle_rad) == pytest.approx(-turn_deg, abs=2.0)
    assert turns[0].share > turns[1].share + 0.2
    angles = np.sort([turn.angle_rad for turn in turns])
    assert np.diff(angles).min() > DIFFERENT_TURN_RAD
    assert [turn.share for turn in turns] == sorted((turn.share for turn in turns), reverse=True)


def test_the_choice_between_similar_base_turns_follows_the_agreement_of_their_fits(estimator, model, film):
    q, frames = film
    images = estimator.fitter.images(frames, CAMERA)
    right = start(q, model, np.zeros(7))
    wrong = BaseTurn(angle_rad=1.2, share=0.5)
    better = BaseTurn(angle_rad=0.0, share=0.45)
    prior = Prior(lens=right.scene.lens, log_focal_sigma=0.0)

    def fit(*turns):
        return estimator.fit_turn(right, turns, images, prior, len(frames))[0]

    both = fit(wrong, better, BaseTurn(angle_rad=-1.0, share=0.2))
    assert np.allclose(both.scene.lens.X_CB, right.scene.lens.X_CB, atol=0.02)
    assert both.base_agreement > both.base_runner_up + 0.2
    assert both.base_runner_up >= 0.2 + both.base_agreement - better.share  # the third has the gain of the best
    alone = fit(wrong)
    assert not np.allclose(alone.scene.lens.X_CB, right.scene.lens.X_CB, atol=0.1)
    assert (alone.base_agreement, alone.base_runner_up) == (0.5, 0.0)
    poor = fit(BaseTurn(angle_rad=1.2, share=0.3), BaseTurn(angle_rad=0.0, share=0.29))  # too little for a base frame
    assert (poor.base_agreement, poor.base_runner_up) == (0.3, 0.29)
    near = fit(better, BaseTurn(angle_rad=np.deg2rad(21.0), share=0.45))  # leads to the same turn
    assert near.base_runner_up == 0.0


def test_cameras_that_differ_by_a_base_turn_see_the_same_arm_and_displaced_ones_do_not(model, film):
    scene = start(film[0], model, np.zeros(7)).scene
    assert scene.lens.sees_same_arm(scene.turned(1.0).lens, 1.0)
    for step in ([0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0]):
        moved = start(film[0], model, step).scene.lens
        assert not scene.lens.sees_same_arm(moved, 1.0)
        assert scene.lens.sees_same_arm(moved, 4.0)


def test_camera_and_focal_length_are_estimated_from_cells_and_contours_without_a_start(estimator, model, film):
    q, frames = film
    cells = project_robot(CAMERA, q, model, finger_m=FINGER_M, noise_px=1.0)
    robot = ArmDetections(
        rows=np.arange(len(q)), cells=cells, finger_m=np.full(len(q), FINGER_M), robot=np.zeros((320, 320), dtype=bool)
    )
    estimate = estimator.solve(robot, frames, usual_camera(320, 320), focal_free=True)
    distance, angle = pose_difference(estimate.camera.X_BC, CAMERA.X_BC)
    assert distance < 2 * estimate.position_sigma_m
    assert distance < 0.06
    assert angle < np.deg2rad(3.0)
    assert estimate.camera.fx == pytest.approx(CAMERA.fx, rel=0.05)
    assert estimate.base_agreement > estimate.base_runner_up + 0.1


def test_pnp_of_random_points_gives_no_pose(monkeypatch):
    monkeypatch.setattr(lens, "_CONSENSUS_PX", 1e-6)
    rng = np.random.default_rng(0)
    p = rng.normal(size=(12, 3))
    uv = rng.uniform(0, 320, (12, 2))
    assert solve_pnp(p, uv, CAMERA) is None


def test_a_camera_with_a_wrong_focal_length_is_contradicted(estimator, model, film, monkeypatch):
    q, frames = film
    cells = project_robot(CAMERA, q, model, finger_m=FINGER_M)
    robot = ArmDetections(
        rows=np.arange(len(q)), cells=cells, finger_m=np.full(len(q), FINGER_M), robot=np.zeros((320, 320), dtype=bool)
    )
    monkeypatch.setattr(contradiction, "find_robot", lambda *_, **__: robot)
    checker = CameraChecker(None, estimator.fitter)
    assert checker.find_contradiction(frames, CAMERA) is None
    X_CG = invert(CAMERA.X_BC) @ model.poses(q)[:, RobotPart.HAND] @ hand_from_tcp()
    distance_m = float(np.median(np.linalg.norm(X_CG[:, :3, 3], axis=1)))  # it grows with the focal length
    for zoom in (0.7, 1.4):
        found = checker.find_contradiction(frames, with_focal(CAMERA, zoom * CAMERA.fx))
        assert found.focal_ratio == pytest.approx(zoom, rel=0.05)
        assert found.better > found.agreement + CLEARLY

        assert found.gripper_m == pytest.approx(abs(zoom - 1.0) * distance_m, rel=0.15)


def track_of(X_BG, tracked):
    """A track of these poses, all frames of which are tracked or none."""
    n = len(X_BG)
    return GripperTrack(
        t_s=np.arange(n) / 5,
        X_CH=X_BG,
        X_BG=X_BG,
        tracked=np.full(n, tracked),
        confidence=np.ones(n),
        finger_width_m=np.full(n, np.nan),
    )


def test_a_camera_puts_the_hand_in_reach_if_any_tracked_frame_does(estimator, model):
    checker = CameraChecker(None, estimator.fitter)
    X_BG = model.poses(postures(4))[:, RobotPart.HAND] @ hand_from_tcp()
    shifted = X_BG.copy()
    shifted[:, 0, 3] -= 1.5
    for poses, tracked, reached in (
        (X_BG, True, True),
        (shifted, True, False),
        (np.concatenate([shifted, X_BG]), True, True),
        (shifted, False, True),
    ):
        assert checker.reaches(track_of(poses, tracked)) is reached
