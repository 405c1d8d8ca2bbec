"""Laws of following: planted lags, gains and drifts are recovered, lost frames never improve a verdict."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import interpolate_pose, make_pose, rotation_exp
from kinebench_drake.metrics.following import PoseSeries, measure_following

PERIOD_S = 0.2
T = 60
SIGMA_M = 0.002


def commands(seed: int = 0, size_m: float = 0.2, n: int = T) -> PoseSeries:
    """A smooth motion between random poses, with rests."""
    rng = np.random.default_rng(seed)
    keys = np.array([0.4, 0.0, 0.3]) + rng.uniform(-size_m, size_m, (6, 3))
    turns = 2.0 * size_m * rng.uniform(-1.0, 1.0, (6, 3))
    place = np.linspace(0, 5, n)
    s = 3 * (place % 1) ** 2 - 2 * (place % 1) ** 3
    k = np.minimum(place.astype(int), 4)
    s = np.where(place >= 5, 1.0, s)
    X = make_pose(rotation_exp(turns), keys)
    return PoseSeries(
        t_s=PERIOD_S * np.arange(n), X=interpolate_pose(X[k], X[k + 1], s), finger_width_m=np.linspace(0.08, 0, n)
    )


def made(series: PoseSeries, *, lag=0.0, gain=1.0, noise_m=SIGMA_M, seed=1) -> PoseSeries:
    """What a tracker measures of a robot that executes commands late, and too far."""
    rng = np.random.default_rng(seed)
    late = series.at(series.t_s - PERIOD_S * lag)
    X = late.X.copy()
    X[:, :3, 3] = X[0, :3, 3] + gain * (X[:, :3, 3] - X[0, :3, 3]) + noise_m * rng.standard_normal((len(X), 3))
    return replace(late, t_s=series.t_s, X=X, sigma_m=np.sqrt(3) * noise_m)


def measure(measured, commanded, **options):
    return measure_following(measured, commanded, np.random.default_rng(0), **options)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("lag", [-0.7, 0, 1, 2.4, 4])
@pytest.mark.parametrize("gain", [0.5, 0.8, 1.0, 1.2])
def test_planted_lags_and_gains_are_found(lag, gain, seed) -> None:
    result = measure(made(commands(seed), lag=lag, gain=gain), commands(seed))
    assert result.lag_frames == pytest.approx(lag, abs=0.5)
    assert result.gain == pytest.approx(gain, rel=0.2)


@pytest.mark.parametrize("lag", [0, 1, 2, 4])
def test_a_late_clip_follows_and_has_no_deviation_at_its_lag(lag) -> None:
    result = measure(made(commands(), lag=lag), commands(), camera=benchmark_camera())
    assert (result.follows, result.drift_from_frame) == (True, None)
    assert result.median("distance_m") < 2 * SIGMA_M
    assert result.median("distance_px") < 2.0
    assert result.share >= 0.9 > max(result.controls.values())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("onset", [15, 40])
def test_a_drift_is_found_with_its_size(onset, seed) -> None:
    measured = made(commands(seed), lag=1, seed=seed)
    measured.X[onset:, 0, 3] += 0.02
    result = measure(measured, commands(seed))
    assert result.drift_from_frame == pytest.approx(onset, abs=2)
    assert result.drift_m == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize("size_m", [0.0, 0.2])
def test_nothing_is_claimed_of_a_robot_that_should_rest_and_a_robot_that_rests_does_not_follow(size_m) -> None:
    still = made(commands(size_m=0.0))
    result = measure(still, commands(size_m=size_m))
    assert result.follows is (None if size_m == 0.0 else False)
    assert result.lag_frames is None
    if size_m == 0.0:
        assert "still" in result.reason
        assert result.gain is None


@pytest.mark.parametrize("seed", range(4))
def test_other_shuffled_and_reversed_commands_do_not_follow(seed) -> None:
    own = commands(seed)
    order = np.random.default_rng(seed).permutation(T)
    for rows in (order, np.arange(T)[::-1]):
        assert measure(made(own), replace(own.taken(rows), t_s=own.t_s)).follows is False
    other = commands(seed + 10)
    assert measure(made(own), other).follows is False
    assert measure(made(own), own, other=other).follows
    assert measure(made(own), own, other=own).follows  # the same motion is no control


@settings(max_examples=40, deadline=None)
@given(
    lost=st.sets(st.integers(0, T - 1), max_size=T),
    outside=st.sets(st.integers(0, T - 1), max_size=12),
    lag=st.sampled_from([0, 1.5, 4]),
    error_m=st.sampled_from([0.005, 0.022, 0.1]),
)
def test_lost_frames_never_turn_a_verdict_into_follows(lost, outside, lag, error_m) -> None:
    whole = made(commands(), lag=lag)
    whole.X[list(outside), 1, 3] += error_m
    X = whole.X.copy()
    X[list(lost)] = np.nan
    before = measure(whole, commands())
    after = measure(replace(whole, X=X), commands())
    assert after.share <= before.share
    assert before.follows or not after.follows
    if len(lost) > 0.5 * T:
        assert not after.follows
        assert after.median("distance_m") is None


def test_a_higher_rate_and_a_longer_recording_of_commands_change_nothing() -> None:
    fine = commands(n=3 * T)
    fine = replace(fine, t_s=np.linspace(0, PERIOD_S * (T - 1), 3 * T))
    measured = made(fine.at(PERIOD_S * np.arange(T)), lag=1)
    result = measure(measured, fine)
    assert result.follows
    assert result.lag_frames == pytest.approx(1.0, abs=0.2)
    assert measure(measured.taken(np.arange(30)), fine).lag_frames == pytest.approx(1.0, abs=0.2)
