"""Comparison of verdicts in two precisions of the networks."""

import pytest

from benchmarks.precision import find_flips, report
from kinebench_drake.errors import KinebenchError
from tests.rows import make_row


def row_with(kinds, *, executable, score, open_kinds=()):
    anomalies = [{"kind": kind, "frame_start": 3, "frame_end": 3, "severity": 0.05} for kind in kinds]
    extra = {"anomaly_scores": {"teleport": score}, "anomalies_open": open_kinds}
    return make_row("clip", executable=executable, metrics={"anomalies": anomalies}, extra=extra)


def test_equal_verdicts_are_no_flips():
    rows = {"clip": row_with((), executable=True, score=0.3)}
    assert list(find_flips(rows, rows)) == []


def test_an_anomaly_in_one_precision_alone_is_a_contradiction_with_its_measure():
    single = {"clip": row_with(("teleport",), executable=False, score=1.3)}
    half = {"clip": row_with((), executable=True, score=0.7)}
    executable, teleport = find_flips(single, half)
    assert (executable.name, executable.values) == ("executable", (False, True))
    assert executable.is_contradiction
    assert (teleport.name, teleport.values) == ("teleport", (True, False))
    assert teleport.measure == "score 1.3 / 0.7, difference 0.6, bound 1"
    text, contradictions = report({"videos": (single, half)})
    assert contradictions == 2
    assert "| videos | 1 | 2 | 1 (100.0 %) | 2 | 1 / 1 |" in text


def test_an_open_kind_is_no_contradiction():
    single = {"clip": row_with((), executable=None, score=1.1, open_kinds=("teleport",))}
    half = {"clip": row_with((), executable=True, score=0.7)}
    flips = list(find_flips(single, half))
    assert [(flip.name, flip.values) for flip in flips] == [("executable", (None, True)), ("teleport", (None, False))]
    assert not any(flip.is_contradiction for flip in flips)


def test_runs_of_different_clips_are_not_compared():
    row = row_with((), executable=True, score=0.3)
    with pytest.raises(KinebenchError, match="1 clips in float32, 0 in bfloat16"):
        list(find_flips({"clip": row}, {}))
