"""Cameras fitted to the contours of the robot, on images drawn by ray casting."""

import numpy as np
import pytest

from kinebench_drake.calibration.bundle import Scene
from kinebench_drake.calibration.contours import ContourImages
from kinebench_drake.calibration.estimate import CameraEstimator, Candidate
from kinebench_drake.calibration.fit import Lens, solve_pnp
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import invert, pose_difference
from kinebench_drake.models.panda.cad import PartCaster, link_meshes, open_fingers, part_meshes
from tests.calibration.robot import postures, project_robot

CAMERA = benchmark_camera().resized(320, 320)
FINGER_M = 0.03


@pytest.fixture(scope="module")
def estimator():
    return CameraEstimator(None)  # the networks are not asked


@pytest.fixture(scope="module")
def film(model):
    """Postures and images of a shaded robot before a plain background, with noise."""
    q = postures(3)
    rng = np.random.default_rng(0)
    caster = PartCaster({**part_meshes(), **link_meshes()})
    rays = CAMERA.rays().reshape(-1, 3)
    frames = []
    for X_BP in model.poses(q):
        hit = caster.cast(open_fingers(invert(CAMERA.X_BC) @ X_BP, FINGER_M), rays)
        shade = 120.0 + 120.0 * np.abs(hit.normal @ [0.3, -0.8, -0.5])
        grey = np.where(hit.part > 0, shade, 50.0) + rng.normal(0, 4.0, len(rays))
        frames.append(np.repeat(np.clip(grey, 0, 255).astype(np.uint8).reshape(320, 320, 1), 3, axis=2))
    return q, np.stack(frames)


def start(q, model, step):
    lens = Lens(camera=CAMERA, X_CB=invert(CAMERA.X_BC)).displace(np.array(step))
    scene = Scene(lens=lens, q=q, finger_m=np.full(len(q), FINGER_M))
    cells = project_robot(CAMERA, q, model, finger_m=FINGER_M)
    return Candidate(scene=scene, rows=np.arange(len(q)), cells=cells, cost=0.0)


def test_contours_give_the_camera_at_known_joint_angles(estimator, model, film):
    q, frames = film
    wrong = start(q, model, [0.01, -0.01, 0.01, 0.01, -0.01, 0.02, 0.0])
    estimate = estimator.refine(frames, CAMERA, wrong, focal_free=False)
    distance, angle = pose_difference(estimate.camera.X_BC, CAMERA.X_BC)
    assert distance < 8e-3
    assert angle < np.deg2rad(0.3)
    assert distance < 3 * estimate.position_sigma_m
    assert estimate.agreement > 0.6
    assert estimate.camera.fx == CAMERA.fx


def test_agreement_tells_a_wrong_camera_from_the_right_one(estimator, model, film):
    q, frames = film
    images = ContourImages(frames, CAMERA, model, estimator._matcher)
    right = images.agreement(start(q, model, np.zeros(7)).scene)
    wrong = images.agreement(start(q, model, [0.0, 0.1, 0.0, 0.05, 0.0, 0.0, 0.0]).scene)
    assert right.shape == (3,)
    assert right.min() > 0.6
    assert wrong.max() < right.min() - 0.2


def test_points_without_a_pose_give_none():
    rng = np.random.default_rng(0)
    p, uv = rng.normal(size=(12, 3)), rng.uniform(0, 320, (12, 2))
    assert solve_pnp(p, uv, CAMERA, rounds=20, error_px=1e-6) is None
