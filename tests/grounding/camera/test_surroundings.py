from dataclasses import replace

import cv2
import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import invert, make_pose, pose_difference, rotation_exp, rotation_z
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, adjust
from kinebench_drake.grounding.camera.lens import Lens
from kinebench_drake.grounding.camera.surroundings import Lines, Surroundings, find_lines, find_surroundings
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.models.panda.description import ARM, GRIPPER
from tests.grounding.camera.robot import postures, project_robot
from tests.grounding.camera.test_bundle_adjustment import LOOSE, observe, prior

CAMERA = benchmark_camera()
TRUE = Lens(intrinsics=CAMERA, X_CB=invert(CAMERA.X_BC))
SIGMA_RAD = np.deg2rad(1.5)


def tiles(turn_rad=0.0):
    """Return the lines of a tiled table, turned about the vertical, as the camera sees them."""
    ends = []
    for offset in np.arange(-0.4, 0.41, 0.1):
        ends += [
            [[0.2, offset, 0.0], [0.9, offset, 0.0]],
            [[0.55 + 0.7 * offset, -0.4, 0.0], [0.55 + 0.7 * offset, 0.4, 0.0]],
        ]
    p_B = (np.array(ends) - [0.55, 0.0, 0.0]) @ rotation_z(turn_rad).T + [0.55, 0.0, 0.0]
    return Lines(ends_px=TRUE.project(p_B.reshape(-1, 3))[0].reshape(-1, 2, 2))


def displaced(degrees, axis, zoom=1.0):
    X = make_pose(rotation_exp(np.deg2rad(degrees) * np.array(axis)), np.zeros(3))
    camera = replace(CAMERA, fx=CAMERA.fx * zoom, fy=CAMERA.fy * zoom)
    return Lens(intrinsics=camera, X_CB=TRUE.X_CB @ X)


def test_lines_along_the_base_axes_meet_at_their_vanishing_points():
    lines = tiles()
    offsets = np.abs(lines.offsets(TRUE, np.eye(3)[:2])).min(axis=1)
    assert offsets.max() < 1e-6
    assert lines.angles(TRUE, np.eye(3)[:2]).max() > 0.3


@pytest.mark.parametrize("turn_deg", [-3.0, 2.0])
def test_lines_determine_the_base_turn_that_an_arm_without_its_base_leaves_open(turn_deg):
    model = ArmModel()
    q = postures(6)
    lens = displaced(turn_deg, (0.0, 0.0, 1.0), zoom=1.03)
    surroundings = find_surroundings(tiles(), lens, SIGMA_RAD)
    assert len(surroundings.lines) == len(tiles())
    start = ArmScene(lens=lens, q=q - np.deg2rad(turn_deg) * np.eye(7)[0], finger_m=np.full(6, 0.01))
    observations = observe(project_robot(CAMERA, q, model, parts=(*GRIPPER, *ARM[1:])), 0.5)
    aligned = prior(surroundings=surroundings)
    fitted = adjust(observations, start, aligned, model, q=q, q_sigma=LOOSE, iterations=60).scene
    _, angle = pose_difference(fitted.lens.X_CB, TRUE.X_CB)
    assert angle < np.deg2rad(0.05)
    assert fitted.lens.intrinsics.fx == pytest.approx(CAMERA.fx, rel=2e-3)


def test_lines_oblique_to_the_base_axes_give_no_surroundings():
    assert find_surroundings(tiles(np.deg2rad(20.0)), TRUE, SIGMA_RAD) is None
    assert find_surroundings(tiles(np.deg2rad(45.0)), TRUE, np.deg2rad(30.0)) is None


def test_random_lines_give_no_surroundings():
    rng = np.random.default_rng(0)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        ends = rng.uniform(0, CAMERA.width, (60, 2, 2))
        assert find_surroundings(Lines(ends_px=ends), TRUE, SIGMA_RAD) is None


def test_the_gradient_is_the_finite_difference_of_the_cost():
    lens = displaced(1.0, (0.3, 0.2, 0.9), zoom=1.02)
    term = Surroundings(lines=tiles(), axis=np.arange(len(tiles())) % 2)
    _, H, g = term.linearize(lens)
    assert np.linalg.eigvalsh(H).min() > -1e-6 * np.linalg.eigvalsh(H).max()
    for k in (0, 1, 2, 6):
        step = 1e-4 * np.eye(9)[k]
        above = term.linearize(lens.displace(step))[0]
        below = term.linearize(lens.displace(-step))[0]
        assert (above - below) / 2e-4 == pytest.approx(2 * g[k], rel=0.02, abs=0.02 * np.abs(g).max())


def test_many_lines_leave_the_base_turn_uncertain_by_at_least_a_fifth_of_a_degree():
    _, H, _ = Surroundings(lines=tiles(), axis=np.arange(len(tiles())) % 2).linearize(TRUE)
    axis_C = TRUE.X_CB[:3, 2]
    free = [0, 1, 2, 6]
    covariance = np.linalg.inv(H[np.ix_(free, free)])[:3, :3]
    assert float(axis_C @ covariance @ axis_C) ** 0.5 >= np.deg2rad(0.2)


def test_lines_are_detected_outside_the_robot_only():
    frame = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    for a, b in tiles().ends_px:
        cv2.line(
            frame, *[tuple(int(v) for v in np.round(end - 0.5)) for end in (a, b)], (220, 220, 220), 2, cv2.LINE_AA
        )
    model = ArmModel()
    matcher = EdgeMatcher()
    X_CP = TRUE.X_CB @ model.poses(np.array([[0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8]]))
    lines = find_lines(np.stack([frame] * 3), CAMERA, X_CP, matcher)
    assert len(lines) >= 8
    assert lines.angles(TRUE, np.eye(3)[:2]).min(axis=1).max() < np.deg2rad(3.0)
    # A robot that covers the whole image covers the lines.
    X_near = X_CP.copy()
    X_near[..., :3, 3] *= 0.15
    assert len(find_lines(np.stack([frame] * 3), CAMERA, X_near, matcher)) < len(lines)
    assert len(find_lines(np.full_like(frame, 90)[None], CAMERA, X_CP, matcher)) == 0
