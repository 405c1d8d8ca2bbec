"""Matching of detected anomalies with planted ones."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.perception.anomalies import ClipAnomalies, find_cases, located
from benchmarks.perception.anomaly_table import (
    alarms,
    area,
    draw_anomalies,
    rows,
    table_json,
    table_lines,
)
from benchmarks.perception.clip import PlantedCase
from benchmarks.perception.store import MeasurementStore
from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.camerafile import save_camera


def clip(i, planted=None, score=0.1, found=()):
    kind = planted.kind if planted else AnomalyKind.TELEPORT
    scores = {k: 0.1 for k in AnomalyKind} | {kind: score}
    return ClipAnomalies(id=f"v{i}", task="StackCube-v1", planted=planted, scores=scores, detected=tuple(found))


def jump(frame, kind=AnomalyKind.TELEPORT, end=None):
    return Anomaly(kind=kind, frame_start=frame, frame_end=frame if end is None else end, severity=1.0)


PLANTED = PlantedCase(kind=AnomalyKind.TELEPORT, frame_start=20, frame_end=48, size=0.05, form="")


def test_a_planted_fault_is_located_by_an_anomaly_of_its_kind_at_its_frames():
    assert located(PLANTED, jump(21))
    assert not located(PLANTED, jump(23))
    assert not located(PLANTED, jump(20, AnomalyKind.FREEZE))
    vanish = replace(PLANTED, kind=AnomalyKind.VANISH, frame_end=24)
    assert located(vanish, jump(20, AnomalyKind.VANISH, 25))
    assert not located(vanish, jump(20, AnomalyKind.VANISH, 30))


def test_area_under_the_roc_curve_counts_ordered_pairs_and_its_interval_has_width():
    rng = np.random.default_rng(0)
    x = rng.normal(1, 1, 40)
    y = rng.normal(0, 1, 60).round(1)
    pairs = (x[:, None] > y).mean() + 0.5 * (x[:, None] == y).mean()
    told = area(x, y)
    assert told.value == pytest.approx(pairs)
    assert told.low < told.value < told.high
    apart = area([2, 3, 4], [0, 1, 1])
    mixed = area([0, 0], [1, 1, 1])
    assert (apart.value, apart.high) == (1.0, 1.0)
    assert 0.3 < apart.low < 0.95
    assert (mixed.value, mixed.low) == (0.0, 0.0)
    assert area(np.full(50, 2.0), np.zeros(50)).low > apart.low
    assert np.isnan(area([], [1.0]).value)


def test_the_95_percent_interval_of_the_area_covers_the_true_area_in_95_percent():
    rng = np.random.default_rng(1)
    truth = 0.9213504  # of two normal distributions two standard deviations apart: Phi(2 / sqrt 2)
    told = [area(rng.normal(2, 1, 25), rng.normal(0, 1, 25)) for _ in range(300)]
    assert 0.91 <= np.mean([a.low <= truth <= a.high for a in told]) <= 0.99


def test_detections_and_false_alarms_are_counted_by_kind_and_size():
    small = replace(PLANTED, size=0.02)
    findings = [
        *(clip(i) for i in range(8)),
        clip(8, found=[jump(3)]),
        clip(9, PLANTED, 2.0, [jump(20)]),
        clip(10, PLANTED, 1.5, [jump(30)]),
        clip(11, small, 0.05),
    ]
    below, gate, together = rows(findings)
    assert (below.gated, gate.gated, together.size) == (False, True, None)
    assert (gate.located.hits, gate.named.hits, gate.located.n) == (1, 2, 2)
    assert (below.area.value, gate.area.value, together.area.value) == (0.0, 1.0, 1.0)
    assert (alarms(findings)["any"].hits, alarms(findings)["any"].n) == (1, 9)
    assert alarms(findings)["freeze"].hits == 0
    low, high = alarms(findings)["freeze"].interval
    assert low == 0.0
    assert 0.1 < high < 0.5
    assert any("v8: teleport 3-3" in line for line in table_lines(findings))
    json.dumps(table_json(findings), allow_nan=False)
    store = MeasurementStore(None, ClipAnomalies)
    for finding in findings:
        store.put(finding.id, finding)
        assert store[finding.id] == finding


def test_the_figure_has_one_panel_per_kind_of_anomaly():
    figure = draw_anomalies([clip(0), clip(1, PLANTED, 2.0, [jump(20)])])
    assert [ax.get_title() for ax in figure.axes] == [kind.value.replace("_", " ") for kind in AnomalyKind]


def folder(path, faults):
    (path / "truth").mkdir(parents=True)
    save_camera(benchmark_camera(), path / "camera.json")
    lines = [json.dumps({"video": f"{name}.mp4", "task": name[0]}) for name in faults]
    (path / "manifest.jsonl").write_text("\n".join(lines) + "\n")
    for name in faults:
        (path / "truth" / f"{name}.npz").touch()
    told = {name: fault for name, fault in faults.items() if fault}
    (path / "truth" / "faults.json").write_text(json.dumps(told))
    return path


def test_cases_are_limited_per_task_and_per_size_of_fault(tmp_path):
    fault = {"kind": "freeze", "frame_start": 5, "frame_end": 9, "size": 5.0, "form": None}
    clean = folder(tmp_path / "clean", {"A1": None, "A2": None, "B1": None})
    faulty = folder(tmp_path / "faulty", {f"A{i}_{s}": {**fault, "size": s} for s in (3.0, 5.0) for i in range(3)})
    cases = find_cases(clean, faulty, 2)
    assert [c.id for c in cases if c.planted is None] == ["A1", "B1"]
    assert [c.planted.size for c in cases if c.planted] == [3.0, 3.0, 5.0, 5.0]
    assert len(find_cases(clean, faulty, None)) == 9
    with pytest.raises(UsageError, match="no fault of A1"):
        find_cases(clean, clean, None)
    (faulty / "truth" / "faults.json").unlink()
    with pytest.raises(UsageError, match=r"benchmarks planted-videos"):
        find_cases(clean, faulty, None)
