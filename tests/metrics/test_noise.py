from math import comb

import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.noise import (
    TrackNoise,
    estimate_joint_noise,
    estimate_track_noise,
    propagate_noise,
    rotation_steps,
)
from tests.metrics.motions import reach_and_place, with_noise


def _measure(t_s: Array, X: Array) -> TrackNoise:
    return estimate_track_noise(t_s, X, np.isfinite(X[:, 0, 0]))


@pytest.mark.parametrize(("position_m", "rotation_rad"), [(0.003, 0.02), (1e-5, 0.1)])
def test_white_noise_is_estimated_at_its_size(position_m: float, rotation_rad: float) -> None:
    X = with_noise(np.tile(np.eye(4), (4000, 1, 1)), position_m, rotation_rad, np.random.default_rng(0))
    noise = _measure(0.1 * np.arange(4000), X)
    assert noise.position_m == pytest.approx(position_m, rel=0.04)
    assert noise.rotation_rad == pytest.approx(rotation_rad, rel=0.04)


@pytest.mark.parametrize("period_s", [0.2, 0.05, 1 / 60])
@pytest.mark.parametrize("millimetres", [1.0, 3.0, 5.0])
def test_motion_hardly_changes_the_noise_estimate(period_s: float, millimetres: float) -> None:
    t_s, X = reach_and_place(period_s)
    rng = np.random.default_rng(0)
    found = [_measure(t_s, with_noise(X, 1e-3 * millimetres, 0.01 * millimetres, rng)) for _ in range(20)]
    most = 1.35 if period_s == 0.2 else 1.1  # six frames a move leave something of the motion in any difference
    assert 0.9 * millimetres < 1e3 * np.mean([n.position_m for n in found]) < most * millimetres
    assert 0.9 * millimetres < 1e2 * np.mean([n.rotation_rad for n in found]) < most * millimetres


@pytest.mark.parametrize(
    ("period_s", "most_m", "most_rad"), [(0.2, 5e-4, 2e-3), (0.05, 1e-6, 1e-5), (0.0167, 1e-8, 1e-6)]
)
def test_the_noise_estimate_of_a_clean_motion_is_nearly_zero(period_s: float, most_m: float, most_rad: float) -> None:
    noise = _measure(*reach_and_place(period_s))
    assert 0.0 <= noise.position_m < most_m
    assert 0.0 <= noise.rotation_rad < most_rad


def test_half_precision_counts_as_noise_that_grows_with_the_values() -> None:
    t_s = 0.01 * np.arange(300)
    q = np.outer(0.1 * np.sin(0.3 * t_s), np.ones(7)) + np.array([0.2, 0.3, 0.6, 0.8, 1.5, 2.0, 3.0])
    stored = q.astype(np.float16).astype(np.float64)
    for values in (stored, stored.round(5)):
        np.testing.assert_array_less(
            0.28 * np.spacing(q.max(axis=0).astype(np.float16)), estimate_joint_noise(t_s, values)
        )
    assert (estimate_joint_noise(t_s, q) < 1e-5).all()


@pytest.mark.parametrize("decimals", [2, 3, 4])
def test_rounding_counts_as_noise_even_in_slow_motion(decimals: int) -> None:
    t_s, X = reach_and_place(0.01)
    unit = 10.0**-decimals
    q = np.outer(np.sin(0.3 * t_s), np.linspace(0.1, 0.4, 7)).round(decimals)
    assert (estimate_joint_noise(t_s, q) >= 0.28 * unit).all()
    X[:, :3, 3] = X[:, :3, 3].round(decimals)
    assert 0.28 * unit <= _measure(t_s, X).position_m <= unit
    assert _measure(t_s, reach_and_place(0.01)[1]).position_m < 1e-6


def test_the_noise_estimate_includes_every_axis() -> None:
    """The axis of depth is noisier than the others; its noise is not lost in the median over all."""
    rng = np.random.default_rng(0)
    X = with_noise(np.tile(np.eye(4), (4000, 1, 1)), [1e-3, 1e-3, 6e-3], 0.0, rng)
    assert _measure(0.1 * np.arange(4000), X).position_m == pytest.approx(np.sqrt(38 / 3) * 1e-3, rel=0.05)


def test_jumps_and_outlier_frames_hardly_change_the_noise_estimate() -> None:
    rng = np.random.default_rng(0)
    X = with_noise(np.tile(np.eye(4), (200, 1, 1)), 0.002, 0.01, rng)
    calm = _measure(0.1 * np.arange(200), X).position_m
    X[60:, 0, 3] += 0.3
    X[120, 1, 3] += 0.5
    assert _measure(0.1 * np.arange(200), X).position_m == pytest.approx(calm, rel=0.25)


def test_uneven_times_and_gaps_do_not_bias_the_noise_estimate() -> None:
    rng = np.random.default_rng(0)
    X = with_noise(np.tile(np.eye(4), (4000, 1, 1)), 0.002, 0.02, rng)
    t_s = np.cumsum(rng.uniform(0.05, 0.15, 4000))
    X[:, :3, 3] += 0.02 * np.sin(0.5 * t_s)[:, None]
    X[rng.random(4000) < 0.05] = np.nan
    noise = _measure(t_s, X)
    assert noise.position_m == pytest.approx(0.002, rel=0.06)
    assert noise.rotation_rad == pytest.approx(0.02, rel=0.06)


def test_frames_that_are_not_tracked_do_not_change_the_noise_estimate() -> None:
    t_s, X = reach_and_place(0.05)
    X = with_noise(X, 1e-3, 1e-2, np.random.default_rng(0))
    tracked = np.ones(len(t_s), dtype=bool)
    tracked[50:60] = False
    clean = estimate_track_noise(t_s, X, tracked)
    X[50:60, :3, 3] += np.random.default_rng(1).normal(scale=0.2, size=(10, 3))
    assert estimate_track_noise(t_s, X, tracked) == clean


@pytest.mark.parametrize("frames", [0, 1, 4])
def test_the_noise_of_a_too_short_track_is_unknown(frames: int) -> None:
    noise = _measure(0.2 * np.arange(frames), np.tile(np.eye(4), (frames, 1, 1)))
    assert np.isnan(noise.position_m)
    assert np.isnan(noise.rotation_rad)
    assert np.isnan(estimate_joint_noise(0.2 * np.arange(frames), np.zeros((frames, 7)))).all()


def test_joint_noise_is_estimated_for_each_joint() -> None:
    sigma = 1e-3 * np.arange(1, 8)
    t_s = 0.05 * np.arange(3000)
    q = np.sin(0.3 * t_s)[:, None] + sigma * np.random.default_rng(0).normal(size=(3000, 7))
    np.testing.assert_allclose(estimate_joint_noise(t_s, q), sigma, rtol=0.08)
    np.testing.assert_allclose(estimate_joint_noise(t_s + 0.01 * np.sin(np.arange(3000)), q), sigma, rtol=0.08)


def test_the_variance_of_differenced_white_noise_is_the_central_binomial_coefficient() -> None:
    x = np.random.default_rng(0).normal(size=200_000)
    for k in range(2, 7):
        assert np.diff(x, k).var() == pytest.approx(comb(2 * k, k), rel=0.02)


def test_rotation_steps_compose_to_the_next_rotation() -> None:
    R = rotation_exp(np.random.default_rng(0).normal(size=(20, 3)))
    np.testing.assert_allclose(rotation_exp(rotation_steps(R)) @ R[:-1], R[1:], atol=1e-12)


def test_joint_noise_propagated_from_pose_noise_is_the_scatter_of_joint_angles(plant: ArmPlant) -> None:
    """Joint angles moved by the pseudo-inverse for random small pose errors scatter as foretold."""
    q = plant.robot.rest_q
    J = plant.jacobian(q)
    noise = TrackNoise(position_m=0.002, rotation_rad=0.01)
    error = np.random.default_rng(0).normal(size=(20_000, 6)) * np.repeat([0.01, 0.002], 3)
    scatter = (error @ np.linalg.pinv(J).T).std(axis=0)
    np.testing.assert_allclose(propagate_noise(J[None], noise)[0], scatter, rtol=0.03)
    assert np.isnan(propagate_noise(np.full((2, 6, 7), np.nan), noise)).all()


def test_the_rotation_noise_does_not_depend_on_the_reference_frame() -> None:
    t_s, X = reach_and_place(0.2)
    X = with_noise(X, 0.002, 0.01, np.random.default_rng(0))
    turned = make_pose(rotation_exp([0.3, -0.8, 1.1]), [1.0, 2.0, 3.0]) @ X
    assert _measure(t_s, turned).rotation_rad == pytest.approx(_measure(t_s, X).rotation_rad, rel=0.2)
