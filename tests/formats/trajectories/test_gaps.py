"""Lost samples of recordings."""

import numpy as np
import pytest

from kinebench_drake.formats.trajectories.times import fill_gaps

T_S = 0.05 * np.arange(120)
Q = 0.4 * np.sin(0.7 * T_S)[:, None] * np.linspace(1.0, 0.3, 7)
LOST = [15, 75, 100]


@pytest.mark.parametrize("noise_rad", [0.0, 2e-4])
def test_lost_samples_are_listed_and_their_gaps_last_two_periods(noise_rad):
    q = np.delete(Q + np.random.default_rng(0).normal(0.0, noise_rad, Q.shape), LOST, axis=0)
    t_s, frames = fill_gaps(T_S[: len(q)], None, q)
    assert frames == tuple(k - i for i, k in enumerate(LOST))
    np.testing.assert_allclose(t_s, np.delete(T_S, LOST), atol=1e-12)


def test_a_complete_recording_and_a_jump_have_no_lost_sample():
    jump = Q + 0.2 * (np.arange(len(Q)) > 60)[:, None] * np.array([1.0, -1.0, 0, 0, 1.0, 0, 0])
    for q in (Q, jump):
        assert fill_gaps(T_S, None, q)[1] == ()


def test_gaps_in_time_stamps_are_listed_and_kept():
    stamps = np.delete(T_S, LOST)
    t_s, frames = fill_gaps(stamps, None, np.delete(Q, LOST, axis=0))
    assert len(frames) == len(LOST)
    np.testing.assert_array_equal(t_s, stamps)
