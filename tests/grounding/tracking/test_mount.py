"""How a gripper is mounted, from dense estimates of links and gripper; which way round a symmetric one is."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference, rotation_z
from kinebench_drake.grounding.registration.arm_fit import ArmFitter, ArmView
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.tracking.flange_fit import ChainFitter
from kinebench_drake.grounding.tracking.mount import find_mount
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.gripper import X_HALF_TURN, GripperModel
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.models.robotiq.cad import robotiq_2f85
from tests.grounding.robots import CAMERA, posture, view

POSTURES = np.stack([posture(seed) for seed in range(3)])


def mounted(turn_rad: float, height_m: float) -> GripperModel:
    return replace(robotiq_2f85(), X_MH=make_pose(rotation_z(turn_rad), [0.0, 0.0, height_m]))


class Estimator:
    """Views of an arm in known postures; every other one takes the gripper for one after half a turn."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        for i, crop in crops.items():
            shown = view(self.model, POSTURES[i], crop, noise_m=0.003, depth_factor=1.0, seed=i)
            yield i, shown.half_turned() if i % 2 else shown


@pytest.mark.parametrize(("turn_rad", "height_m"), [(0.0, 0.0), (np.pi / 4, 0.014), (0.75 * np.pi, 0.02)])
def test_the_mount_is_found_up_to_half_a_turn(turn_rad: float, height_m: float) -> None:
    model = ArmModel(mounted(turn_rad, height_m))
    X_CH = invert(CAMERA.X_BC) @ model.poses(POSTURES)[:, RobotPart.HAND]
    crops = {i: Crop.of_gripper(X, 1.3, CLOSE_SIZE) for i, X in enumerate(X_CH)}
    estimator = Estimator(model)
    wide = dict(estimator.estimate(np.empty(0), CAMERA, dict.fromkeys(crops, Crop.of_frame(CAMERA))))
    gripper = find_mount(estimator, np.empty(0), CAMERA, crops, wide, robotiq_2f85(), ChainFitter(ArmModel()))
    distance, angle = pose_difference(gripper.X_MH, model.gripper.X_MH)
    assert min(angle, np.pi - angle) < 1e-6
    assert distance < 0.008


@pytest.mark.parametrize("is_turned", [False, True])
def test_links_tell_which_way_round_a_symmetric_gripper_is(is_turned: bool) -> None:
    model = ArmModel(mounted(np.pi / 4, 0.01))
    X_CH: Array = invert(CAMERA.X_BC) @ model.poses(POSTURES[:1])[0, RobotPart.HAND]
    close, wide = (
        view(model, POSTURES[0], crop, noise_m=0.003, depth_factor=1.0, seed=1)
        for crop in (Crop.of_gripper(X_CH, 1.3, CLOSE_SIZE), Crop.of_frame(CAMERA))
    )
    shown = close.half_turned() if is_turned else close
    hand = fit(shown, robotiq_2f85().max_finger_m)
    assert hand is not None
    expected = X_CH @ X_HALF_TURN if is_turned else X_CH
    assert pose_difference(hand.X_CH, expected)[1] < np.deg2rad(3.0)
    fitter = ArmFitter(CAMERA, model, EdgeMatcher(robotiq_2f85()))
    assert fitter.is_turned(ArmView.of(hand, shown, wide)) == is_turned


def test_half_a_turn_twice_changes_nothing() -> None:
    model = ArmModel(mounted(0.0, 0.0))
    shown = view(model, POSTURES[0], Crop.of_frame(CAMERA), noise_m=0.0, depth_factor=1.0, seed=0)
    np.testing.assert_array_equal(shown.half_turned().half_turned().part, shown.part)
    np.testing.assert_allclose(shown.half_turned().half_turned().coordinates_P, shown.coordinates_P)
