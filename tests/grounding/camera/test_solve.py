from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import make_pose, pose_difference, rotation_exp
from kinebench_drake.grounding.camera.calibrate import describe, solve
from kinebench_drake.grounding.camera.calibration_result import (
    CalibrationBasis,
    CalibrationMethod,
    CameraCalibration,
    require_determined,
    warnings_of,
)
from kinebench_drake.grounding.camera.detections import ArmDetections
from kinebench_drake.grounding.camera.lens import Lens, with_focal
from kinebench_drake.grounding.camera.states import RobotStates
from kinebench_drake.models.panda.description import RobotPart
from tests.grounding.camera.robot import VISIBLE, postures, project_robot


def states_of(q, model):
    return RobotStates(q=q, X_BH=model.poses(q)[:, RobotPart.HAND], finger_m=np.full(len(q), 0.01), source="joints.csv")


def view_of(cells, q):
    robot = np.zeros((2, 2), dtype=bool)
    return ArmDetections(rows=np.arange(len(q)), cells=cells, finger_m=np.full(len(q), 0.01), q=q, robot=robot)


def described(solved, *, focal_free=True):
    basis = CalibrationBasis(method=CalibrationMethod.JOINTS, source="joints.csv", focal_free=focal_free)
    return describe(solved, basis)


def calibrated(
    camera, model, *, q=None, stated=None, noise_px=0.5, guess=None, focal_free=True, parts=VISIBLE
) -> CameraCalibration:
    q = postures(6) if q is None else q
    cells = project_robot(camera, q, model, noise_px=noise_px, parts=parts)
    states = states_of(q if stated is None else stated, model)
    solved = solve(view_of(cells, q), states, guess or camera, model, focal_free=focal_free)
    return described(solved, focal_free=focal_free)


def off(camera, found):
    distance, angle = pose_difference(camera.X_BC, found.X_BC)
    return float(distance), float(angle), abs(found.fx / camera.fx - 1.0)


@pytest.mark.parametrize("fov_deg", [40.0, 60.0, 80.0])
def test_exact_cells_determine_camera_pose_and_focal_length(camera, model, fov_deg):
    true = with_focal(camera, camera.width / 2 / np.tan(np.deg2rad(fov_deg) / 2))
    found = calibrated(true, model, noise_px=0.0, guess=camera)
    assert max(off(true, found.camera)) < 1e-5
    assert found.residual_px < 1e-3


def test_a_fixed_focal_length_is_kept_and_has_no_uncertainty(camera, model):
    found = calibrated(camera, model, focal_free=False)
    assert (found.camera.fx, found.focal_sigma) == (camera.fx, 0.0)
    assert off(camera, found.camera)[0] < 0.01


def test_calibration_errors_lie_within_four_of_their_sigmas(camera, model):
    found = calibrated(camera, model, noise_px=1.0)
    distance, angle, zoom = off(camera, found.camera)
    assert distance < 4 * found.position_sigma_m < 0.1
    assert angle < 4 * found.rotation_sigma_rad < 0.05
    assert zoom < 4 * found.focal_sigma < 0.1


def test_different_postures_lower_the_uncertainty_and_repeated_ones_do_not(camera, model):
    few, many = (calibrated(camera, model, q=postures(n)) for n in (3, 12))
    assert many.position_sigma_m < 0.7 * few.position_sigma_m
    one = postures(1)
    once, again = (calibrated(camera, model, q=np.repeat(one, n, axis=0)) for n in (2, 8))
    assert again.position_sigma_m == pytest.approx(once.position_sigma_m, rel=0.1)
    assert "the hand moves by 0 mm only" in " ".join(warnings_of(again))


def test_a_distant_robot_does_not_determine_the_focal_length_and_the_error_says_why(camera, model):
    back = make_pose(np.eye(3), [0.0, 0.0, -12.0])
    tele = with_focal(replace(camera, X_BC=camera.X_BC @ back), 12 * camera.fx)
    found = calibrated(tele, model, guess=tele)
    with pytest.raises(UnmeasurableError, match=r"focal length is not determined.*nearly the same depth.*focal_px"):
        require_determined(found)
    require_determined(calibrated(camera, model))


def test_a_frame_with_a_flipped_gripper_is_corrected(camera, model):
    q = postures(5)
    wrong = project_robot(camera, q, model).flip(np.arange(5) == 2)
    found = described(solve(view_of(wrong, q), states_of(q, model), camera, model, focal_free=True))
    assert max(off(camera, found.camera)) < 1e-5


def test_joint_angles_of_another_motion_are_refused(camera, model):
    with pytest.raises(UnmeasurableError, match=r"contradicts the images|agree with joints.csv"):
        require_determined(calibrated(camera, model, stated=postures(6, seed=5, reach=0.6)))


def test_gripper_poses_calibrate_the_camera_without_joint_angles(camera, model):
    q = postures(6)
    states = replace(states_of(q, model), q=np.full((6, 7), np.nan))
    solved = solve(view_of(project_robot(camera, q, model), q), states, camera, model, focal_free=True)
    assert set(np.unique(solved.cells.part)) == {
        RobotPart.HAND,
        RobotPart.LEFT_FINGER,
        RobotPart.RIGHT_FINGER,
        RobotPart.LINK0,
    }
    assert max(off(camera, solved.bundle.scene.lens.to_camera())) < 1e-5


def test_one_frame_with_joint_angles_determines_the_turn_about_joint_1(camera, model):
    q = postures(6)
    guess = replace(camera, X_BC=make_pose(rotation_exp([0.0, 0.0, 0.08]), [0.02, 0.0, -0.02]) @ camera.X_BC)
    states = states_of(q, model)
    first = np.arange(6)[:, None] == 0
    states = replace(states, q=np.where(first, q, np.nan), X_BH=np.where(first[..., None], states.X_BH, np.nan))
    parts = tuple(part for part in VISIBLE if part is not RobotPart.LINK0)
    estimate = view_of(project_robot(camera, q, model, parts=parts), q + 0.02)
    solved = solve(estimate, states, guess, model, focal_free=False)
    assert off(camera, solved.bundle.scene.lens.to_camera())[0] < 2e-3


def test_lens_derivatives_are_finite_differences_of_the_projection(camera):
    lens = Lens.of_camera(camera)
    p_B = np.random.default_rng(0).uniform([0.1, -0.3, 0.0], [0.7, 0.3, 0.6], (20, 3))

    def pixels(step, move):
        return lens.displace(step).project(p_B + move)[0]

    by_lens, by_C = lens.derivatives(p_B)
    by_B = by_C @ lens.X_CB[:3, :3]
    h = 1e-6
    for k, e in enumerate(h * np.eye(9)):
        slope = (pixels(e, 0) - pixels(-e, 0)) / (2 * h)
        assert np.allclose(by_lens[..., k], slope, rtol=1e-5, atol=1e-3)
    for k, e in enumerate(h * np.eye(3)):
        slope = (pixels(np.zeros(9), e) - pixels(np.zeros(9), -e)) / (2 * h)
        assert np.allclose(by_B[..., k], slope, rtol=1e-5, atol=1e-3)
