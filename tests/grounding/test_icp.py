"""Registration of depth to the CAD surface, and its weight beside the fit."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.grounding.registration.icp import IcpRefiner, IcpRegistration, fuse, surface_cells
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.panda.cad import GripperCad
from tests.grounding.conftest import hand_pose, perfect_view

SIGMA = np.array([0.02] * 3 + [0.002] * 3)
"""Standard deviations of a fit [rad, m]."""
STATED = np.diag(SIGMA**2) / 3.5
"""Covariance (6, 6) that a fit states."""


def start(X_CH: Array, seed: int) -> Array:
    """A pose that is off by about `SIGMA`."""
    error = np.random.default_rng(seed).normal(0, SIGMA)
    return make_pose(rotation_exp(error[:3]) @ X_CH[:3, :3], X_CH[:3, 3] + error[3:])


def registered(X_CH: Array, covariance: Array) -> IcpRegistration:
    return IcpRegistration(X_CH=X_CH, fitness=1.0, rmse_m=0.0, covariance=covariance)


def with_smooth_error(view: GripperView, size: float, seed: int) -> GripperView:
    """The view with a relative depth error that varies smoothly over the gripper."""
    nodes = np.random.default_rng(seed).normal(0, 1, (7, 7))
    field = np.asarray(cv2.resize(nodes, view.part.shape[::-1], interpolation=cv2.INTER_CUBIC))
    return replace(view, depth_m=view.depth_m * (1 + size * field / field[view.gripper].std()))


@pytest.mark.parametrize("seed", range(5))
def test_exact_depth_determines_the_pose(cad: GripperCad, seed: int) -> None:
    X_CH = hand_pose(seed)
    view = replace(perfect_view(cad, X_CH), depth_factor_sigma=1e-4)
    fused = IcpRefiner(cad).refine(view, start(X_CH, seed), STATED, 0.02)
    assert fused is not None
    distance, angle = pose_difference(fused.X_CH, X_CH)
    assert distance < 0.001
    assert np.rad2deg(angle) < 0.5
    assert fused.weight > 0.8
    assert fused.registration.fitness > 0.8
    assert fused.registration.rmse_m < 0.0005


def test_depth_with_large_smooth_errors_leaves_the_fit_unchanged(cad: GripperCad) -> None:
    X_CH = hand_pose(0)
    view = with_smooth_error(perfect_view(cad, X_CH), 0.03, 0)
    X = start(X_CH, 0)
    fused = IcpRefiner(cad).refine(view, X, STATED, 0.02)
    assert fused is not None
    assert fused.weight == 0.0
    np.testing.assert_array_equal(fused.X_CH, X)
    np.testing.assert_array_equal(fused.covariance, STATED)


@pytest.mark.parametrize("size", [0.0, 0.003, 0.01, 0.03])
def test_the_fused_pose_is_no_worse_than_the_fit_at_any_depth_error(cad: GripperCad, size: float) -> None:
    errors = []
    for seed in range(12):
        X_CH = hand_pose(seed)
        X = start(X_CH, seed)
        fused = IcpRefiner(cad).refine(with_smooth_error(perfect_view(cad, X_CH), size, seed), X, STATED, 0.02)
        assert fused is not None
        errors.append([*pose_difference(X, X_CH), *pose_difference(fused.X_CH, X_CH)])
    fit_m, fit_rad, fused_m, fused_rad = np.mean(errors, axis=0)
    assert fused_m <= 1.02 * fit_m
    assert fused_rad <= 1.02 * fit_rad
    if size == 0.0:
        assert fused_m < 0.5 * fit_m
        assert fused_rad < 0.1 * fit_rad


def test_a_registration_that_contradicts_the_fit_has_no_weight() -> None:
    X_CH = hand_pose(0)
    tilted = make_pose(rotation_exp([0.15, 0.0, 0.0]) @ X_CH[:3, :3], X_CH[:3, 3])
    fused = fuse(X_CH, STATED, registered(tilted, 1e-8 * np.eye(6)))
    assert fused.weight == 0.0


def test_a_common_factor_of_the_depth_does_not_displace_the_registration(cad: GripperCad) -> None:
    X_CH = hand_pose(3)
    view = perfect_view(cad, X_CH, depth_factor=1.01)
    registration = IcpRefiner(cad).register(view, X_CH, STATED, 0.02)
    assert registration is not None
    assert pose_difference(registration.X_CH, X_CH)[0] < 0.002  # 1 % are 5 to 8 mm


def test_the_depth_factor_sigma_enters_the_covariance_along_the_line_of_sight(cad: GripperCad) -> None:
    X_CH = hand_pose(0)
    along = X_CH[:3, 3] / np.linalg.norm(X_CH[:3, 3])
    for sigma in (1e-3, 0.02):
        view = replace(perfect_view(cad, X_CH), depth_factor_sigma=sigma)
        registration = IcpRefiner(cad).register(view, X_CH, STATED, 0.02)
        assert registration is not None
        depth_sigma_m = (along @ registration.covariance[3:, 3:] @ along) ** 0.5
        assert depth_sigma_m == pytest.approx(sigma * np.linalg.norm(X_CH[:3, 3]), rel=0.15)


def test_a_start_far_from_the_depth_has_no_registration(cad: GripperCad) -> None:
    X_CH = hand_pose(0)
    far = make_pose(np.eye(3), [0.3, 0.3, 0.0]) @ X_CH
    assert IcpRefiner(cad).refine(perfect_view(cad, X_CH), far, STATED, 0.02) is None


@pytest.mark.parametrize("seed", range(10))
def test_fusion_lowers_the_uncertainty_of_the_fit_but_not_below_both_in_any_direction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    of_fit, of_icp = (m @ m.T * 1e-2 + 1e-3 * np.eye(6) for m in rng.normal(size=(2, 6, 6)))
    X_CH = hand_pose(seed)
    fused = fuse(X_CH, of_fit, registered(X_CH, of_icp))
    assert np.linalg.det(fused.covariance) <= np.linalg.det(of_fit) * (1 + 1e-9)
    for direction in rng.normal(size=(50, 6)):
        of_both = [direction @ np.linalg.inv(c) @ direction for c in (of_fit, of_icp / 3.5)]
        combined = direction @ np.linalg.inv(fused.covariance) @ direction
        assert min(of_both) * (1 - 1e-4) <= combined <= max(of_both) * (1 + 1e-4)


def test_a_far_more_certain_estimate_determines_the_fused_pose() -> None:
    X_CH = hand_pose(0)
    other = start(hand_pose(0), 1)
    sure = 1e-8 * np.eye(6)
    unsure = 1e-2 * np.eye(6)
    np.testing.assert_allclose(fuse(X_CH, unsure, registered(other, sure)).X_CH, other, atol=1e-6)
    np.testing.assert_array_equal(fuse(X_CH, sure, registered(other, unsure)).X_CH, X_CH)


def test_a_fit_with_singular_covariance_gives_a_finite_fused_pose() -> None:
    X_CH = hand_pose(0)
    singular = np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 0.0])
    fused = fuse(X_CH, singular, registered(start(X_CH, 0), STATED))
    assert np.isfinite(fused.X_CH).all()


def test_cells_at_depth_edges_are_excluded_from_the_surface(cad: GripperCad) -> None:
    view = perfect_view(cad, hand_pose(2))
    cells = surface_cells(view)
    assert 0.5 * view.gripper.sum() < cells.sum() <= view.gripper.sum()
    assert not (cells & ~view.gripper).any()
    step = np.abs(np.log(view.depth_m[:, 1:] / view.depth_m[:, :-1]))
    assert step[cells[:, 1:] & cells[:, :-1]].max() <= 0.03


def test_rays_hit_the_fingers_at_their_opening(cad: GripperCad) -> None:
    tip = 0.1034
    down = make_pose(rotation_exp([np.pi, 0, 0]), [0.0, 0.0, 0.5])  # fingers towards the camera
    for opening in (0.01, 0.03):
        rays = np.array(
            [[0.0, -(opening + 0.008), 0.5 - tip], [0.0, opening + 0.008, 0.5 - tip], [0.0, 0.0, 0.5 - tip]]
        )
        assert cad.cast(down, rays, opening).part.tolist() == [2, 3, 1]
