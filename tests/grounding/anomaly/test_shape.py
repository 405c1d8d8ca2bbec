"""Deformation, scale and second grippers on views made from the CAD model."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import invert, make_pose, rotation_exp, transform_points
from kinebench_drake.grounding.anomaly.presence import find_duplicates, second_gripper
from kinebench_drake.grounding.anomaly.shape import find_deformations, find_scale_drift, shape_misfit
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.robot import RobotPart

CAMERA = benchmark_camera()


@pytest.fixture(scope="module")
def cad():
    return GripperCad()


def hand_pose(seed):
    rng = np.random.default_rng(seed)
    R = rotation_exp(rng.normal(0, 0.2, 3)) @ np.diag([1.0, -1.0, -1.0]) @ rotation_exp([np.pi / 2, 0, 0])
    return make_pose(R, [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.6, 0.8)])


def view_of(cad, X_CH, crop, noise_m=0.004, seed=0):
    """What a network with noisy coordinates would say of a gripper with open fingers."""
    rng = np.random.default_rng(seed)
    X_VH, rays = invert(crop.X_CV) @ X_CH, crop.rays(2)
    surface = cad.cast(X_VH, rays.reshape(-1, 3), 0.03)
    part = surface.part.reshape(rays.shape[:2])
    z = np.where(np.isfinite(surface.distance), surface.distance, 1.0).reshape(part.shape)
    p_H = transform_points(invert(X_VH), (rays * z[..., None]).reshape(-1, 3)).reshape(rays.shape)
    p_H[..., 1] -= 0.03 * ((part == RobotPart.LEFT_FINGER).astype(float) - (part == RobotPart.RIGHT_FINGER))
    return GripperView(
        crop=crop,
        stride=2,
        in_image=np.ones(part.shape, dtype=bool),
        part=part,
        depth_m=z,
        depth_sigma=np.full(part.shape, 0.01),
        depth_factor_sigma=0.012,
        coordinates_P=p_H + rng.normal(0, noise_m, p_H.shape),
        coordinates_sigma_m=np.full(part.shape, noise_m),
    )


def misfit_of(view):
    fitted = fit(view)
    assert fitted is not None
    return shape_misfit(view, fitted.X_CH, fitted.finger_m)


def test_noise_is_no_deformation_but_a_stretch_is(cad):
    for seed in range(4):
        X_CH = hand_pose(seed)
        view = view_of(cad, X_CH, Crop.of_gripper(X_CH, 1.3, 128), seed=seed)
        stretched = replace(view, coordinates_P=view.coordinates_P / [1.0, 1.0, 1.25])
        assert misfit_of(view) < 0.03 < 0.06 < misfit_of(stretched)


def test_a_gripper_that_is_hardly_seen_says_nothing_of_its_shape(cad):
    X_CH = hand_pose(0)
    view = view_of(cad, X_CH, Crop.of_gripper(X_CH, 1.3, 128))
    hidden = replace(view, part=np.where(np.arange(64) < 54, 0, view.part).astype(np.uint8))
    assert np.isnan(shape_misfit(hidden, X_CH, 0.03))


def test_a_lasting_misfit_is_named_and_a_passing_one_is_not():
    misfit, residual = np.full(49, 0.01), np.full(49, 0.5)
    misfit[12], residual[12] = 0.3, 2.0
    misfit[30:42], residual[30:42] = 0.15, 1.0
    (found,) = find_deformations(misfit, residual).anomalies
    assert (found.frame_start, found.frame_end, found.severity) == (30, 41, 0.15)


def test_a_misfit_that_the_cells_do_not_disagree_by_is_none():
    """As where the gripper is seen from its narrow side; and cells that disagree by nothing in common are noise."""
    n = np.ones(49)
    assert find_deformations(0.2 * n, 0.55 * n).anomalies == ()
    assert find_deformations(0.01 * n, np.r_[0.5 * n[:30], 1.5 * n[30:]]).anomalies == ()


def test_a_gripper_deformed_from_first_to_last_frame_is_found():
    (found,) = find_deformations(np.full(49, 0.04), np.full(49, 1.0)).anomalies
    assert (found.frame_start, found.frame_end) == (0, 48)


@pytest.mark.parametrize("size", [0.05, -0.05, 0.15])
def test_a_wrong_size_is_named_whether_at_once_or_growing(size):
    noise = np.random.default_rng(0).normal(0, 0.02, 49)
    assert find_scale_drift(1.0 + noise).anomalies == ()
    for drift in (np.full(49, size), np.linspace(0.0, size, 49)):
        found = find_scale_drift(1.0 + drift + noise / 3)
        assert found.peak >= 1.0
        assert found.anomalies[-1].frame_end == 48
    assert find_scale_drift(np.full(49, np.nan)).peak == 0.0


def test_a_second_gripper_counts_and_the_first_does_not(cad):
    for seed in range(3):
        X_CH = hand_pose(seed)
        first = view_of(cad, X_CH, Crop.of_frame(CAMERA))
        beside = X_CH.copy()
        beside[0, 3] -= np.sign(X_CH[0, 3]) * 0.25
        second = view_of(cad, beside, Crop.of_frame(CAMERA))
        both = replace(first, part=np.where(first.part > 0, first.part, second.part))
        assert second_gripper(first, X_CH, CAMERA) == 0.0
        assert second_gripper(both, X_CH, CAMERA) > 0.3
        assert second_gripper(replace(first, part=np.zeros_like(first.part)), X_CH, CAMERA) == 0.0


def test_a_second_gripper_must_stay_to_be_named():
    other = np.zeros(49)
    other[5:7] = 0.9
    assert find_duplicates(other).anomalies == ()
    other[20:30] = 0.5
    (found,) = find_duplicates(other).anomalies
    assert (found.frame_start, found.frame_end, found.severity) == (20, 29, 0.5)
