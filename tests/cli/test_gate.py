"""The gate of a data set: drop list, exit status, SARIF, kept episodes."""

import json
import re

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from kinebench_drake.errors import UsageError, name_options
from kinebench_drake.runs.audit import AuditConfig, audit_trajectories
from tests.fakes.resources import FakeResources

FPS = 20
NAMES = [f"panda_joint{j}.pos" for j in range(1, 8)]


@pytest.fixture
def dataset(tmp_path):
    """A LeRobot dataset: sound, infeasible (the fake judges by the first joint), late actions, a rest, a copy."""
    rng = np.random.default_rng(0)
    t = np.arange(80)[:, None] / FPS
    sound = [0.3 * np.sin(t * rng.uniform(1.0, 3.0, 7) + rng.uniform(0.0, 6.0, 7)) for _ in range(4)]
    rest = np.concatenate([np.repeat(sound[3][:1], 30, axis=0), sound[3]])
    states = [sound[0], sound[1] + [1.5, 0, 0, 0, 0, 0, 0], sound[2], rest, sound[0]]
    root = tmp_path / "ds"
    (root / "meta").mkdir(parents=True)
    (root / "data" / "chunk-000").mkdir(parents=True)
    vector = {"dtype": "float32", "shape": [7], "names": NAMES}
    features = {"observation.state": vector, "action": vector, "timestamp": {"dtype": "float32", "shape": [1]}}
    (root / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v2.1", "fps": FPS, "features": features}))
    lines = []
    for k, state in enumerate(states):
        n = len(state)
        action = state[np.clip(np.arange(n) + (-5 if k == 2 else 1), 0, n - 1)]
        table = {"observation.state": list(state.astype(np.float32)), "action": list(action.astype(np.float32))}
        table |= {"timestamp": (np.arange(n) / FPS).astype(np.float32), "frame_index": np.arange(n)}
        table |= {"episode_index": np.full(n, k), "index": np.arange(n)}
        parquet.write_table(pyarrow.table(table), root / "data" / "chunk-000" / f"episode_{k:06d}.parquet")
        lines.append(json.dumps({"episode_index": k, "tasks": ["move"], "length": n}))
    (root / "meta" / "episodes.jsonl").write_text("\n".join([*lines, ""]))
    return root


@pytest.fixture
def audit(dataset, tmp_path):
    def run(**changes):
        config = {
            "source": dataset,
            "out": tmp_path / "out",
            "make_resources": FakeResources,
            "replays": None,
            **changes,
        }
        return audit_trajectories(AuditConfig(**config))

    return run


def test_every_planted_fault_is_listed_in_the_file_and_on_the_page(audit, tmp_path):
    summary = audit()
    lines = [json.loads(line) for line in (tmp_path / "out" / "drops.jsonl").read_text().splitlines()]
    assert [(line["id"][-1], line["reason"], line["frame_start"]) for line in lines] == [
        ("1", "infeasible", 3),
        ("2", "action_offset", None),
        ("3", "idle_ends", 0),
        ("4", "duplicate", None),
    ]
    assert [drop.to_json() for drop in summary.drops] == lines
    page = (tmp_path / "out" / "report.html").read_text()
    assert "same motion as ds-episode_000000" in page


def test_a_resumed_run_ends_with_the_same_list(audit, tmp_path):
    first = audit().drops
    assert audit().drops == first


def test_kept_episodes_are_those_without_an_entry_but_for_idle_ends(audit, dataset, tmp_path):
    audit(write_kept=tmp_path / "kept", sarif=tmp_path / "log.sarif")
    rows = (tmp_path / "kept" / "meta" / "episodes.jsonl").read_text().splitlines()
    assert [json.loads(row)["length"] for row in rows] == [80, 110]
    again = audit_trajectories(
        AuditConfig(source=tmp_path / "kept", out=tmp_path / "again", make_resources=FakeResources, replays=None)
    )
    assert {drop.reason.key for drop in again.drops} == {"idle_ends"}
    assert len(json.loads((tmp_path / "log.sarif").read_text())["runs"][0]["results"]) == 4


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({"fail_on": "duplicate"}, ["duplicate: 1 sample, such as ds-episode_000004"]),
        ({"fail_on": "infeasible,velocity"}, ["infeasible: 1 sample", "velocity: 1 sample"]),
        ({"fail_on": "not_measured,jerk"}, []),
        ({"fail_under": {"feasible": "0.8"}}, []),
        ({"fail_under": {"feasible": "0.81"}}, ["feasible is 0.8, expected 0.81 or more"]),
        ({"fail_under": {"ik_success_rate": "1"}}, []),
        ({"fail_under": {"manipulability_mean": "0"}}, ["manipulability_mean is unmeasurable"]),
    ],
)
def test_missed_bounds_are_named(audit, changes, missed):
    found = audit(**changes).missed
    assert len(found) == len(missed)
    assert all(line.startswith(start) for line, start in zip(found, missed, strict=True))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"fail_on": "duplicates"}, r"--fail-on duplicates \(did you mean duplicate\?\)"),
        ({"fail_under": {"feasable": "0.8"}}, r"--fail-under feasable \(did you mean feasible\?\)"),
        ({"fail_under": {"feasible": "most"}}, "--fail-under feasible: could not convert"),
    ],
)
def test_unknown_kinds_names_and_numbers_are_usage_errors(audit, changes, reason):
    with pytest.raises(UsageError) as error:
        audit(**changes)
    assert re.search(reason, name_options(str(error.value)))


def test_kept_episodes_of_anything_but_a_lerobot_dataset_are_refused_before_the_run(audit, dataset, tmp_path):
    np.savez(tmp_path / "a.npz", t_s=np.arange(3.0), q=np.zeros((3, 7)))
    with pytest.raises(UsageError, match="no LeRobot dataset"):
        audit(source=tmp_path / "a.npz", write_kept=tmp_path / "kept")
    with pytest.raises(UsageError, match="exists already"):
        audit(write_kept=dataset)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("fail_on", "status"), [("idle_ends", 1), ("dropped_samples", 0)])
def test_the_exit_status_is_1_if_a_bound_is_missed(dataset, program, tmp_path, fail_on, status):
    code, out, err = program("audit", dataset, "--out", tmp_path / "out", "--fail-on", fail_on)
    assert code == status
    assert ("bound missed: idle_ends" in err) == bool(status)
    assert "drop list: 4 samples" in out
