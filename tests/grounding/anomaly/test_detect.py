from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.grounding.anomaly.absence import Absence
from kinebench_drake.grounding.anomaly.camera_motion import CameraMotion
from kinebench_drake.grounding.anomaly.detect import AnomalyEvidence, find_anomalies
from kinebench_drake.track import Domain


@pytest.fixture
def clean(reach, t_s):
    n = len(t_s)
    rng = np.random.default_rng(0)
    return AnomalyEvidence(
        t_s=t_s,
        p_C=reach(),
        covariance=np.zeros((n, 3, 3)),
        confidence=np.full(n, 0.8),
        absences=(None,) * n,
        explained=np.full(n, 400.0),
        finger_width_m=0.04 + rng.normal(0, 0.003, n),
        other=np.zeros(n),
        misfit=np.full(n, 0.01),
        residual=np.full(n, 0.55),
        scale=1.0 + rng.normal(0, 0.02, n),
        shapes=(None,) * n,
        still=np.zeros(n, dtype=bool),
        mixed=lambda number: False,
        motion=CameraMotion(px=np.zeros(n), R_AC=np.repeat(np.eye(3)[None], n, axis=0), unit_px=1.0),
    )


def test_a_clean_video_has_no_anomaly_and_a_score_below_one_for_every_kind(clean):
    result = find_anomalies(clean)
    assert result.anomalies == ()
    assert set(result.scores) == set(AnomalyKind)
    assert max(result.scores.values()) < 1.0


def test_anomalies_are_reported_exactly_where_scores_reach_one(clean):
    p = clean.p_C.copy()
    p[30:] += [0.0, 0.1, 0.0]
    other = clean.other.copy()
    other[10:20] = 0.5
    result = find_anomalies(replace(clean, p_C=p, other=other))
    assert [a.kind for a in result.anomalies] == [AnomalyKind.DUPLICATE, AnomalyKind.TELEPORT]
    assert {kind for kind, score in result.scores.items() if score >= 1.0} == {a.kind for a in result.anomalies}
    assert result.by_kind[AnomalyKind.TELEPORT].score[29:32].max() >= 1.0
    assert result.by_kind[AnomalyKind.TELEPORT].score[:26].max() < 1.0


def test_low_confidence_in_an_unfamiliar_video_is_an_anomaly_only_if_the_gripper_vanishes(clean):
    confidence = clean.confidence.copy()
    explained = clean.explained.copy()
    confidence[20:26] = 0.005
    unfamiliar = replace(clean, domain=Domain.UNFAMILIAR)
    assert not find_anomalies(replace(unfamiliar, confidence=confidence)).anomalies
    confidence[20:26] = 0.0
    explained[20:26] = 0.0
    gone = replace(unfamiliar, confidence=confidence, explained=explained)
    assert [a.kind for a in find_anomalies(gone).anomalies] == [AnomalyKind.VANISH]


def test_the_jump_at_the_end_of_a_freeze_is_no_separate_teleport(clean):
    p = clean.p_C.copy()
    still = clean.still.copy()
    p[20:28] = p[19]
    still[20:28] = True
    result = find_anomalies(replace(clean, p_C=p, still=still))
    assert [a.kind for a in result.anomalies] == [AnomalyKind.FREEZE]
    assert result.scores[AnomalyKind.TELEPORT] < 1.0


def test_false_poses_of_a_gripper_that_has_vanished_are_no_teleport(clean):
    p = clean.p_C.copy()
    p[20:24] += [0.0, 0.15, 0.0]
    explained = clean.explained.copy()
    assert [a.kind for a in find_anomalies(replace(clean, p_C=p)).anomalies] == [AnomalyKind.TELEPORT] * 2
    explained[20:24] = 2.0
    result = find_anomalies(replace(clean, p_C=p, explained=explained))
    assert [a.kind for a in result.anomalies] == [AnomalyKind.VANISH]
    assert result.scores[AnomalyKind.TELEPORT] < 0.9


def test_a_video_without_any_measurement_has_no_anomaly(clean):
    n = len(clean.t_s)
    unknown = np.full(n, np.nan)
    blind = replace(
        clean, p_C=np.full((n, 3), np.nan), confidence=np.zeros(n), absences=(Absence.UNSURE,) * n,
        finger_width_m=unknown, other=unknown, misfit=unknown, residual=unknown, scale=unknown,
        motion=replace(clean.motion, px=unknown),
    )  # fmt: skip
    assert max(find_anomalies(blind).scores.values()) == 0.0


def test_series_of_unequal_length_are_refused(clean):
    with pytest.raises(InputError, match="scale"):
        replace(clean, scale=clean.scale[:5])
