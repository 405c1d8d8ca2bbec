"""Bundles hold if their numbers follow from their tracks; a changed row, track or aggregate is named."""

import hashlib
import json
import zipfile

import numpy as np
import pytest

from kinebench_drake.io.archive import write_zip
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.results.bundle import open_bundle, write_bundle
from kinebench_drake.runs.audit import AuditConfig, audit_trajectories
from kinebench_drake.runs.verify import verify_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    """A bundle of two recordings of joint angles, one too fast, and two of poses."""
    work = tmp_path_factory.mktemp("verify")
    (work / "in").mkdir()
    plant = ArmPlant()
    t_s = np.arange(30) * 0.05
    for k, (radius, rate_hz) in enumerate([(0.05, 0.5), (0.6, 2.0), (0.1, 0.5), (0.15, 0.7)]):
        q = plant.robot.rest_q + radius * np.sin(2.0 * np.pi * rate_hz * t_s)[:, None] * np.linspace(-1.0, 1.0, 7)
        motion = {"q": q} if k < 2 else {"base_from_tcp": plant.forward_path(q)}
        np.savez(work / "in" / f"t{k}.npz", t_s=t_s, **motion)
    audit_trajectories(AuditConfig(source=work / "in", out=work / "out", replays=None))
    write_bundle(work / "out", work / "r.zip")
    return work / "r.zip"


def altered(bundle, path, change):
    """Write a bundle after `change` of its files by name; a careful forger states the hashes of the result."""
    with zipfile.ZipFile(bundle) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    content = json.loads(files["bundle.json"])
    content["files"] = {n: hashlib.sha256(d).hexdigest() for n, d in files.items() if n != "bundle.json"}
    write_zip(path, {**files, "bundle.json": json.dumps(content).encode()})
    return path


def change_row(files):
    lines = [json.loads(line) for line in files["samples.jsonl"].splitlines()]
    assert lines[1]["feasible"] is False
    lines[1] |= {"feasible": True, "executable": True, "executable_reasons": [], "violations": []}
    files["samples.jsonl"] = b"".join(json.dumps(line).encode() + b"\n" for line in lines)


def change_metric(files):
    lines = [json.loads(line) for line in files["samples.jsonl"].splitlines()]
    lines[2]["metrics"]["manipulability_mean"] *= 1.01
    files["samples.jsonl"] = b"".join(json.dumps(line).encode() + b"\n" for line in lines)


def change_track(files):
    files["tracks/t1.npz"] = files["tracks/t0.npz"]


def change_aggregate(files):
    results = json.loads(files["results.json"])
    results["aggregates"]["executable"]["mean"] = 1.0
    files["results.json"] = json.dumps(results).encode()


def faults(path, samples=4):
    with open_bundle(path) as opened:
        return verify_bundle(opened, samples, 0).faults


def test_a_true_bundle_holds(bundle):
    with open_bundle(bundle) as opened:
        outcome = verify_bundle(opened, 3, 0)
        choices = {verify_bundle(opened, 1, seed).measured[0] for seed in range(5)}
    assert (outcome.faults, outcome.candidates, outcome.samples) == ([], 4, 4)
    assert len(outcome.measured) == 3
    assert len(choices) > 1


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (change_row, "t1: feasible is True, its track gives False"),
        (change_metric, "t2: metrics.manipulability_mean is "),
        (change_track, "t1: feasible is False, its track gives True"),
        (change_aggregate, "results.json: aggregates.executable.mean is 1, the rows give 0."),
    ],
)
def test_a_change_is_named_though_its_hash_is_right(bundle, tmp_path, change, line):
    assert any(fault.startswith(line) for fault in faults(altered(bundle, tmp_path / "r.zip", change)))


def test_changed_bytes_are_named_by_their_hash(bundle, tmp_path):
    with zipfile.ZipFile(bundle) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change_track(files)
    del files["tracks/t0.npz"]
    write_zip(tmp_path / "r.zip", files)
    differs = "SHA-256 differs from that stated"
    assert faults(tmp_path / "r.zip", 0) == [f"tracks/t0.npz: {differs}", f"tracks/t1.npz: {differs}"]
    assert any(fault.startswith("t0: t0.npz: not a track file") for fault in faults(tmp_path / "r.zip"))


def test_rounding_within_the_tolerance_holds(bundle, tmp_path):
    def shift(files):
        lines = [json.loads(line) for line in files["samples.jsonl"].splitlines()]
        lines[2]["metrics"]["manipulability_mean"] *= 1.0 + 5e-4
        files["samples.jsonl"] = b"".join(json.dumps(line).encode() + b"\n" for line in lines)

    assert faults(altered(bundle, tmp_path / "r.zip", shift)) == []
