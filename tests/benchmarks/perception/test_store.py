"""Stored measurements, and the fingerprint of the code and models that they depend on."""

import subprocess
import sys

import numpy as np

from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.sources import trace_sources
from benchmarks.perception.store import MeasurementStore, fingerprint

MEASURING = "benchmarks.perception.trial"
SHAPING = (
    *("camera", "geometry", "track", "io.reader", "models.panda.cad", "models.perception.network"),
    *("grounding.pipeline", "grounding.tracking.tracker", "grounding.tracking.pose"),
    *("grounding.registration.fit", "grounding.registration.solver", "grounding.anomaly.detect"),
)
STUDIES = ("errors", "clip", "variants", "perturbation.gripper", "perturbation.catalogue")
PRESENTING = ("study", "summary", "tables")


def reached(module):
    return {source.name for source in trace_sources(module)}


def test_the_fingerprint_covers_measuring_modules_and_no_presenting_ones():
    names = reached(MEASURING)
    assert {f"kinebench_drake.{name}" for name in SHAPING} <= names
    assert {f"benchmarks.perception.{name}" for name in STUDIES} <= names
    assert not {*(f"benchmarks.perception.{name}" for name in PRESENTING), "training.train"} & names


def test_the_fingerprint_covers_every_module_that_is_loaded():
    code = f"import sys, {MEASURING}\nprint(*(m for m in sys.modules if m.startswith('kinebench_drake.')), sep='\\n')"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert set(loaded) <= reached(MEASURING)


def test_a_fingerprint_changes_with_settings_and_modules():
    prints = [fingerprint(1, modules=[MEASURING]), fingerprint(2, modules=[MEASURING]), fingerprint(1)]
    assert len(set(prints)) == 3
    assert fingerprint(1, modules=[MEASURING]) == prints[0]


def test_a_fingerprint_changes_with_the_contents_of_files(tmp_path):
    file = tmp_path / "weights.safetensors"
    file.write_bytes(b"1")
    one = fingerprint(files=[file])
    file.write_bytes(b"2")
    assert fingerprint(files=[file]) != one != fingerprint()


def test_a_torn_last_line_is_dropped_from_stored_measurements(tmp_path, errors):
    path = tmp_path / "deep" / "kept.jsonl"
    store = MeasurementStore(path, ClipErrors)
    store.put("a", errors(0.001))
    with path.open("a") as file:
        file.write('{"key": "torn')
    again = MeasurementStore(path, ClipErrors)
    again.put("b", errors(0.002))
    assert "torn" not in path.read_text()
    both = MeasurementStore(path, ClipErrors)
    assert "a" in both
    np.testing.assert_array_equal(both["b"].position_m, again["b"].position_m)
    assert "a" not in MeasurementStore(None, ClipErrors)
