import numpy as np

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.grounding.anomaly.detection import Detection, finite_median, sustained


def test_an_anomaly_is_a_run_of_scores_of_at_least_one_with_its_worst_frames_severity():
    score = np.array([1.0, 1.2, 0.9, 2.0, 0.0, 0.0, 1.0])
    detection = Detection.from_score(AnomalyKind.DEFORMATION, score, 10 * score)
    runs = [(a.frame_start, a.frame_end, a.severity) for a in detection.anomalies]
    assert runs == [(0, 1, 12.0), (3, 3, 20.0), (6, 6, 10.0)]


def test_peaks_shorter_than_the_window_are_removed_and_longer_ones_kept():
    values = np.array([0, 5, 5, 0, 2, 3, 4, 3, 0, np.nan, 9], dtype=float)
    assert sustained(values, 3).tolist() == [0, 0, 0, 0, 2, 3, 3, 3, 0, 0, 0]
    assert sustained([1.0, 2.0], 3).tolist() == [0, 0]


def test_the_moving_median_ignores_unknown_values():
    values = np.array([1, np.nan, 1, 9, 1, np.nan, np.nan, np.nan, 1])
    smoothed = finite_median(values, 3)
    assert smoothed[[3, 4]].tolist() == [1, 5]
    assert np.isnan(smoothed[[6, 7]]).all()
