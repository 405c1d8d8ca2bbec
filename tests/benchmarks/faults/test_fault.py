"""Kinds, sizes and labels of planted faults."""

import numpy as np
import pytest

from benchmarks.faults.fault import GRADES, FaultForm, choose
from benchmarks.faults.plant import deformation
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import UsageError


def test_every_kind_has_sizes_at_and_below_its_gate() -> None:
    assert set(GRADES) == set(AnomalyKind)
    for grades in GRADES.values():
        assert min(grades.sizes) < grades.gate
        assert grades.gate in grades.sizes


def test_gated_sizes_are_those_that_must_be_detected() -> None:
    grades = choose([AnomalyKind.CAMERA], "gated")
    assert [(g.size, g.form) for g in grades] == [(s, f) for s in (2, 4, 8) for f in (FaultForm.SHAKE, FaultForm.DRIFT)]
    assert grades[0].label == "camera_motion_shake_2px"


def test_labels_of_faults_are_unique() -> None:
    labels = [grade.label for grade in choose(list(AnomalyKind), "all")]
    assert len(set(labels)) == len(labels)


def test_numeric_sizes_are_accepted_for_one_kind_only() -> None:
    assert [g.size for g in choose([AnomalyKind.TELEPORT], "0.03,0.05")] == [0.03, 0.05]
    for kinds, sizes in (([AnomalyKind.TELEPORT, AnomalyKind.FREEZE], "5"), ([AnomalyKind.FREEZE], "x")):
        with pytest.raises(UsageError, match="sizes"):
            choose(kinds, sizes)


@pytest.mark.parametrize("strength", [0.1, 0.3])
def test_a_deformation_has_its_nominal_stretch_and_keeps_the_volume(strength: float) -> None:
    J = np.stack(
        [(deformation(strength, np.random.default_rng(5))(h) / 1e-6)[0] for h in 1e-6 * np.eye(3)[:, None]], axis=1
    )
    stretch = np.linalg.svd(J)[1] - 1.0
    assert np.abs(stretch).max() == pytest.approx(strength, rel=0.02)
    assert stretch.sum() == pytest.approx(0.0, abs=1e-5)
