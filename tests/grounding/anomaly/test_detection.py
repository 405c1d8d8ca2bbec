import numpy as np
import pytest

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections, Detection, finite_median, sustained


def test_an_anomaly_is_a_run_of_scores_of_at_least_one_with_its_worst_frames_severity():
    score = np.array([1.0, 1.2, 0.9, 2.0, 0.0, 0.0, 1.0])
    detection = Detection.from_score(AnomalyKind.DEFORMATION, score, 10 * score)
    runs = [(a.frame_start, a.frame_end, a.severity) for a in detection.anomalies]
    assert runs == [(0, 1, 12.0), (3, 3, 20.0), (6, 6, 10.0)]


@pytest.mark.parametrize(
    ("peak", "sure", "is_open"), [(0.9, 0, False), (0.96, 0, True), (1.04, 0, True), (1.2, 1, False)]
)
def test_a_score_nearer_to_its_bound_than_the_spread_leaves_the_kind_open(peak, sure, is_open):
    scores = {kind: Detection(kind=kind, score=np.zeros(5)) for kind in AnomalyKind}
    jump = Detection.from_score(AnomalyKind.TELEPORT, np.array([0.0, peak, 0.0, 0.0, 0.0]), np.ones(5))
    found = AnomalyDetections(by_kind={**scores, AnomalyKind.TELEPORT: jump.beyond(0.06)}, spread=0.06)
    assert len(found.anomalies) == sure
    assert found.open_kinds == ((AnomalyKind.TELEPORT,) if is_open else ())


def test_peaks_shorter_than_the_window_are_removed_and_longer_ones_kept():
    values = np.array([0, 5, 5, 0, 2, 3, 4, 3, 0, np.nan, 9], dtype=float)
    assert sustained(values, 3).tolist() == [0, 0, 0, 0, 2, 3, 3, 3, 0, 0, 0]
    assert sustained([1.0, 2.0], 3).tolist() == [0, 0]


def test_the_moving_median_ignores_unknown_values():
    values = np.array([1, np.nan, 1, 9, 1, np.nan, np.nan, np.nan, 1])
    smoothed = finite_median(values, 3)
    assert smoothed[[3, 4]].tolist() == [1, 5]
    assert np.isnan(smoothed[[6, 7]]).all()
