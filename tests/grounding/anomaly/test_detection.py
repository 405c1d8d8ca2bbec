import numpy as np

from kinebench_drake.grounding.anomaly.detection import detection_segments, finite_median, sustained


def test_runs_cover_what_is_true():
    flags = np.array([1, 1, 0, 1, 0, 0, 1], dtype=bool)
    assert list(detection_segments(flags)) == [(0, 1), (3, 3), (6, 6)]


def test_held_levels_short_peaks_and_keeps_long_ones():
    values = np.array([0, 5, 5, 0, 2, 3, 4, 3, 0, np.nan, 9], dtype=float)
    assert sustained(values, 3).tolist() == [0, 0, 0, 0, 2, 3, 3, 3, 0, 0, 0]
    assert sustained([1.0, 2.0], 3).tolist() == [0, 0]


def test_the_median_passes_over_what_is_unknown():
    values = np.array([1, np.nan, 1, 9, 1, np.nan, np.nan, np.nan, 1])
    smoothed = finite_median(values, 3)
    assert smoothed[[3, 4]].tolist() == [1, 5]
    assert np.isnan(smoothed[[6, 7]]).all()
