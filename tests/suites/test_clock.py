"""Clips of any length on the task's clock."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kinebench_drake.clip_timing import sample_uniformly
from kinebench_drake.suites.clock import CLIP_S, FRAME_PERIOD_S


@given(st.integers(2, 400), st.floats(0.05, 60.0), st.floats(0.02, 2.0))
def test_resampled_frames_keep_their_times_and_are_evenly_spaced(
    frames: int, duration_s: float, period_s: float
) -> None:
    chosen, t_s = sample_uniformly(frames, duration_s, period_s)
    assert chosen[0] == 0
    assert chosen[-1] == frames - 1
    assert (np.diff(chosen) > 0).all()
    assert len(chosen) == min(frames, max(round(duration_s / period_s), 1) + 1)
    np.testing.assert_allclose(t_s, chosen * duration_s / (frames - 1))
    even = np.linspace(0.0, duration_s, len(chosen))
    assert np.abs(t_s - even).max() <= 0.5 * duration_s / (frames - 1) + 1e-9


def test_a_benchmark_clip_keeps_all_frames() -> None:
    chosen, t_s = sample_uniformly(49, CLIP_S, FRAME_PERIOD_S)
    assert chosen.tolist() == list(range(49))
    np.testing.assert_array_equal(t_s, FRAME_PERIOD_S * np.arange(49))


def test_a_clip_with_as_many_frames_as_periods_keeps_its_duration() -> None:
    assert sample_uniformly(34, 10.0, 0.3)[1][-1] == 10.0


def test_resampling_reduces_150_frames_to_49_and_keeps_25() -> None:
    chosen, t_s = sample_uniformly(150, CLIP_S, FRAME_PERIOD_S)
    assert len(chosen) == 49
    assert t_s[-1] == CLIP_S
    chosen, t_s = sample_uniformly(25, CLIP_S, FRAME_PERIOD_S)
    np.testing.assert_allclose(np.diff(t_s), 0.4)
    assert len(chosen) == 25
