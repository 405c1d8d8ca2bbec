"""Stored measurements, and the fingerprint of the code and models that they depend on."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import kinebench_drake
from benchmarks.perception import store
from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.store import MeasurementStore, fingerprint
from kinebench_drake.environment.sources import reachable_sources

TOP = Path(kinebench_drake.__file__).parent
MEASURING = "benchmarks.perception.trial"
SHAPING = (
    *("camera.py", "geometry.py", "types.py", "io/reader.py", "models/panda/cad.py"),
    *(
        "models/perception/network.py",
        "grounding/pipeline.py",
        "grounding/tracking/tracker.py",
        "grounding/tracking/confidence.py",
    ),
    *("grounding/registration/fit.py", "grounding/registration/solver.py", "grounding/framing/search.py"),
    *("grounding/overrides/depth.py", "grounding/anomaly/detect.py", "benchmarks/perception/errors.py"),
    *("benchmarks/perception/clip.py", "benchmarks/perception/variants.py", "benchmarks/perception/reframing.py"),
    *("benchmarks/perception/perturbation/gripper.py", "benchmarks/perception/perturbation/catalogue.py"),
)
PRESENTING = tuple(
    f"grounding/evaluation/{name}.py"
    for name in ("anomaly_table", "depth_map", "figures", "study", "summary", "tables")
)


def reached(module):
    return {path.relative_to(TOP).as_posix() for path in reachable_sources(module)}


def test_measuring_modules_count_and_presenting_ones_do_not():
    assert set(SHAPING) <= reached(MEASURING)
    assert not {*PRESENTING, "cli/perception.py", "training/train.py"} & reached(MEASURING)
    for name in ("registration", "framing", "overrides", "anomaly"):
        folder = {p.name for p in (TOP / "grounding" / name).glob("*.py")}
        unused = folder - {Path(p).name for p in reached(MEASURING) if p.startswith(f"grounding/{name}/")}
        assert unused <= {"overrides.py", "poses.py"}, name  # read files of a user, which no measurement has


@pytest.mark.parametrize("name", ["trial", "anomalies"])
def test_every_loaded_module_counts(name):
    module = f"benchmarks.perception.{name}"
    code = f"import sys, {module}\nprint(*(m for m in sys.modules if m.startswith('kinebench_drake.')), sep='\\n')"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    stems = {p.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for p in reached(module)}
    assert {m.removeprefix("kinebench_drake.") for m in loaded} <= stems


def test_a_fingerprint_changes_with_what_shapes_a_measurement_alone(tmp_path, monkeypatch):
    for name in ("grounding", "models", "io", "kinematics", "executors", "environment", "results"):
        shutil.copytree(TOP / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for path in TOP.glob("*.py"):
        shutil.copy(path, tmp_path / path.name)
    monkeypatch.setattr(kinebench_drake, "__file__", str(tmp_path / "__init__.py"))
    sources = reachable_sources(MEASURING)  # slow, and comments change no import
    monkeypatch.setattr(store, "reachable_sources", lambda *modules: sources)

    def append(name):
        with (tmp_path / name).open("ab") as file:
            file.write(b"\n# changed\n")

    prints = [fingerprint(1, modules=[MEASURING])]
    for name in PRESENTING:
        append(name)
    assert fingerprint(1, modules=[MEASURING]) == prints[0] != fingerprint(2, modules=[MEASURING])
    for name in (*SHAPING, "models/perception/confidence.json", "models/perception/gripper.safetensors"):
        append(name)
        prints.append(fingerprint(1, modules=[MEASURING]))
        assert prints[-1] not in prints[:-1], name


def test_files_count_by_their_contents(tmp_path):
    file = tmp_path / "weights.safetensors"
    file.write_bytes(b"1")
    one = fingerprint(files=[file])
    file.write_bytes(b"2")
    assert fingerprint(files=[file]) != one != fingerprint()


def test_stored_measurements_survive_a_torn_line(tmp_path, errors):
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
    assert both["b"].to_json() == again["b"].to_json()
    assert "a" not in MeasurementStore(None, ClipErrors)
