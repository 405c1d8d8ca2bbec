"""Even times in place of jittering stamps, where the motion tells that the recording was even."""

import numpy as np
import pytest

from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.trajectory import RawTrajectory
from kinebench_drake.geometry import make_pose

RATES_HZ = [30, 100, 250]
JITTER_S = 5e-4


def raw(motion_s, t_s, *, poses=False):
    """Return a trajectory of the state of a motion at `motion_s`, with noise of sensors, stamped `t_s`."""
    q = np.sin(np.outer(motion_s, np.linspace(0.5, 2.0, 7)) + np.arange(7))
    q += 1e-5 * np.random.default_rng(1).normal(size=q.shape)
    X_BG = make_pose(np.broadcast_to(np.eye(3), (len(q), 3, 3)), 0.3 * q[:, :3])
    return RawTrajectory(columns="test", t_s=t_s, X_BG=X_BG) if poses else RawTrajectory(columns="test", t_s=t_s, q=q)


def times(rate_hz, seed):
    """Return even times of two seconds, and the same with jitter [s]."""
    even = np.arange(2 * rate_hz) / rate_hz
    return even, even + JITTER_S * np.random.default_rng(seed).uniform(-1.0, 1.0, len(even))


@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("seed", range(3))
def test_jittering_stamps_of_an_even_recording_are_replaced(rate_hz, seed, poses):
    even, stamps = times(rate_hz, seed)
    found = check(raw(even, stamps, poses=poses))
    assert np.ptp(np.diff(found.t_s)) < 1e-9
    np.testing.assert_allclose(found.t_s - even, 0.0, atol=2 * JITTER_S)
    assert any("smoother over even ones" in warning for warning in found.warnings)


@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("seed", range(3))
def test_true_times_of_an_uneven_recording_are_kept(rate_hz, seed, poses):
    _, stamps = times(rate_hz, seed)
    found = check(raw(stamps, stamps, poses=poses))
    np.testing.assert_array_equal(found.t_s, stamps)
    assert found.warnings == ()


def test_time_stamps_around_a_missing_frame_are_kept():
    even, stamps = (np.delete(t_s, 90) for t_s in times(100, 0))
    np.testing.assert_array_equal(check(raw(even, stamps)).t_s, stamps)


def test_time_stamps_of_a_motion_with_jumps_are_kept():
    """A motion that is broken by jumps is as rough over even times as over its stamps, and is judged as it is."""
    even, stamps = times(100, 0)
    broken = raw(np.zeros_like(even), stamps)
    broken.q[::7] += 0.3
    np.testing.assert_array_equal(check(broken).t_s, stamps)


def test_jittering_stamps_are_replaced_despite_untracked_frames():
    even, stamps = times(100, 0)
    lost = raw(even, stamps)
    tracked = np.ones(len(even), dtype=bool)
    tracked[40:60] = False
    lost = RawTrajectory(columns="test", t_s=stamps, q=np.where(tracked[:, None], lost.q, np.nan), tracked=tracked)
    assert np.ptp(np.diff(check(lost).t_s)) < 1e-9


def test_time_stamps_without_five_consecutive_poses_are_kept():
    even, stamps = times(100, 0)
    tracked = np.arange(len(even)) % 4 > 0
    sparse = RawTrajectory(
        columns="test", t_s=stamps, q=np.where(tracked[:, None], raw(even, stamps).q, np.nan), tracked=tracked
    )
    np.testing.assert_array_equal(check(sparse).t_s, stamps)


@pytest.mark.parametrize(("rate_hz", "jitter_s"), [(10, 0.015), (250, 0.0018)])
def test_time_stamps_with_deviations_beyond_jitter_are_kept(rate_hz, jitter_s):
    """Beyond 10 ms, or 0.4 of a step, the stamps are taken as they are, smooth as the motion would be without them."""
    even = np.arange(100) / rate_hz
    stamps = even + jitter_s * np.where(np.arange(100) % 3 == 0, 1.0, -1.0)
    assert (np.diff(stamps) > 0).all()
    np.testing.assert_array_equal(check(raw(even, stamps)).t_s, stamps)
