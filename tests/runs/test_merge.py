"""Merging: merged shards equal the output of one run."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import make_pose
from kinebench_drake.results.aggregate import RunStatistics
from kinebench_drake.results.metadata import RunMetadata, read_metadata
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import ResultStore, artifact_path, read_rows
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.runs.config import RunKind
from kinebench_drake.runs.merge import copy_artifact, merge_folders
from kinebench_drake.runs.runner import NullRunObserver, close_run, summarize
from kinebench_drake.track import GripperTrack
from tests.rows import make_row

IDS = ["a", "b", "b_r0", "c", "d", "e", "f"]


class Ear(NullRunObserver):
    def __init__(self):
        self.warnings = []

    def warn(self, message):
        self.warnings.append(message)


def header(kind="suite", **changes):
    config = {"kind": kind, "limit": None, "shard": None, "jobs": 1, "engine": "local", "seed": 3, "rounds": 2}
    config |= {name: changes.pop(name) for name in list(changes) if name in config or name == "replays"}
    told = {"schema_version": 2, "suite_version": None, "kind": kind, "samples_found": len(IDS), "tags": {"run": "7"}}
    told |= {"versions": {"drake": "1.51"}, "code_sha256": "c0de", "weights_sha256": "f00d", "host": {"cores": 2}}
    return RunMetadata(**{**told, "config": config, "bootstrap_seed": 3, **changes})


def sample(id, **changes):
    k = IDS.index(id)
    told = {"video": f"videos/{id}_r0.mp4", "task": f"T{k % 2}", "model": "m", "reason": None, "status": Status.OK}
    told |= {"content_hash": id * 64, "feasible": k % 3 > 0, "extra": {"success": k % 2 == 0}}
    told["metrics"] = {"sparc": -1.5 - 0.1 * k, "manipulability_cost_mean": 8.0 + k}
    return make_row(**{"id": id, **told, **changes})


def failed(id, reason="because"):
    return sample(id, status=Status.ERROR, reason=reason, feasible=None, metrics={})


def fill(out, facts, rows, *, finished=True, replays=99):
    """What a run leaves behind: rows, and files for each."""
    with ResultStore(out) as store:
        store.begin(facts.to_json())
        for row in rows:
            if row.status is Status.OK:
                _write_files(out, row.id)
            store.append(row, 1.5)
        if finished:
            statistics = RunStatistics.of(store.rows.values(), facts.bootstrap_seed)
            store.finish(summarize(store.sorted_rows(), facts, statistics))
            worst = [row.id for row in sorted(store.rows.values(), key=lambda r: (r.feasible is True, r.id))][:replays]
            for id in worst:
                artifact_path(out, "replays", id).parent.mkdir(exist_ok=True)
                (out / "replays").mkdir(exist_ok=True)
                artifact_path(out, "replays", id).write_text(f"replay {id}")
            close_run(store, RunKind(facts.kind), 3, statistics)
    return out


def _write_files(out, id):
    X = make_pose(np.tile(np.eye(3), (4, 1, 1)), np.full((4, 3), IDS.index(id) / 10))
    track = GripperTrack(
        t_s=0.2 * np.arange(4),
        X_CH=X,
        X_BG=X,
        tracked=np.ones(4, bool),
        confidence=np.ones(4),
        finger_width_m=X[:, 0, 3],
    )
    write_track(artifact_path(out, "tracks", id), track, None, {})
    for part in ("overlays", "rollouts", "thumbnails"):
        artifact_path(out, part, id).parent.mkdir(exist_ok=True)
        artifact_path(out, part, id).write_text(f"{part} {id}")
    (out / "videos" / f"{id}_r1").mkdir(parents=True)
    (out / "videos" / f"{id}_r0.mp4").write_text(f"video {id}")
    (out / "videos" / f"{id}_r1" / "0.png").write_text(f"frame {id}")


def content(out, but=("timings.jsonl",)):
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file() and p.name not in but}


@pytest.fixture
def shards(tmp_path):
    """Folders of three shards, filled in another order, and the same with one run."""
    fill(tmp_path / "whole", header(), map(sample, IDS))
    for k in (3, 1, 2):
        facts = header(shard=f"{k}/3", jobs=k, host={"cores": 2 * k})
        fill(tmp_path / f"part{k}", facts, [sample(id) for id in IDS[::-1] if IDS.index(id) % 3 == k - 1])
    return [tmp_path / f"part{k}" for k in (1, 2, 3)]


def test_merged_shards_equal_one_run_except_for_jobs_and_host(shards, tmp_path):
    before = [content(path, but=()) for path in shards]
    ear = Ear()
    summary = merge_folders(shards, tmp_path / "out", ear)
    assert ear.warnings == []
    assert [row.id for row in summary.rows] == IDS
    assert summary.report == tmp_path / "out" / "report.html"
    merged = content(tmp_path / "out")
    whole = content(tmp_path / "whole")
    told, expected = (json.loads(c.pop("results.json")) for c in (merged, whole))
    assert (told["config"].pop("jobs"), expected["config"].pop("jobs")) == (None, 1)
    assert (told.pop("host"), expected.pop("host")) == ({"cores": None}, {"cores": 2})
    assert told == expected
    assert list(told) == list(expected)
    assert merged.pop("report.html") != whole.pop("report.html")  # it tells of jobs and host
    assert merged == whole
    assert [content(path, but=()) for path in shards] == before


def test_merged_shards_of_equal_machines_equal_one_run_byte_by_byte(tmp_path):
    fill(tmp_path / "whole", header(), map(sample, IDS))
    parts = [fill(tmp_path / f"p{k}", header(shard=f"{k}/2"), map(sample, IDS[k - 1 :: 2])) for k in (1, 2)]
    merge_folders(parts, tmp_path / "out")
    assert content(tmp_path / "out") == content(tmp_path / "whole")
    timed = [json.loads(line)["id"] for line in (tmp_path / "out" / "timings.jsonl").read_text().splitlines()]
    assert sorted(timed) == IDS


def test_changing_a_merged_file_leaves_the_shard_unchanged(shards, tmp_path):
    merge_folders(shards, tmp_path / "out")
    artifact_path(tmp_path / "out", "rollouts", "a").write_text("changed in place")
    assert artifact_path(shards[0], "rollouts", "a").read_text() == "rollouts a"


def test_absent_shards_are_warned_about_and_can_be_merged_later(shards, tmp_path):
    ear = Ear()
    out = tmp_path / "out"
    merge_folders([shards[0], shards[2]], out, ear)
    assert ear.warnings == ["2 of 7 samples are absent: no folder is of shard 2/3"]
    assert json.loads((out / "results.json").read_text())["samples_found"] == 7
    ear = Ear()
    merge_folders([shards[1]], out, ear)
    assert ear.warnings == []
    merge_folders(shards, tmp_path / "at_once")
    assert content(out) == content(tmp_path / "at_once")


def test_only_finished_rows_of_an_interrupted_run_are_merged(tmp_path):
    one = fill(tmp_path / "one", header(shard="1/2"), map(sample, IDS[::2]))
    two = fill(tmp_path / "two", header(shard="2/2"), [sample("b")], finished=False)
    with (two / "samples.jsonl").open("a") as file:
        file.write('{"id": "c", "sta')
    (two / "tracks" / "c.npz").write_text("of a row that never came")
    (two / "videos" / "c_r0.mp4").write_text("likewise")
    ear = Ear()
    merge_folders([one, two], tmp_path / "out", ear)
    assert [text.partition(":")[2][:30] for text in ear.warnings] == [" its run has not ended; 1 samp", ""]
    assert ear.warnings[1] == "2 of 7 samples are absent"
    assert set(read_rows(tmp_path / "out")) == {*IDS[::2], "b"}
    assert not (tmp_path / "out" / "tracks" / "c.npz").exists()
    assert not (tmp_path / "out" / "videos" / "c_r0.mp4").exists()


def test_an_interrupted_merge_can_be_repeated(shards, tmp_path, monkeypatch):
    out = tmp_path / "out"
    merge_folders(shards, tmp_path / "at_once")
    with monkeypatch.context() as patch:
        patch.setattr(ResultStore, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            merge_folders(shards, out)
    assert not (out / "results.json").exists()
    (out / "tracks" / ".7.part.a.npz").write_text("half")
    merge_folders(shards, out)
    assert content(out) == content(tmp_path / "at_once")


def test_duplicate_samples_prefer_results_over_errors_and_contradictions_are_refused(tmp_path):
    one = fill(tmp_path / "one", header(), [sample("a"), failed("b", "killed"), failed("c")])
    two = fill(tmp_path / "two", header(), [sample("a"), sample("b"), failed("c")])
    for order in ([one, two], [two, one]):
        out = tmp_path / f"out_{order[0].name}"
        merge_folders(order, out)
        assert {id: row.status.value for id, row in read_rows(out).items()} == {"a": "ok", "b": "ok", "c": "error"}
        assert artifact_path(out, "tracks", "b").is_file()
    three = fill(tmp_path / "three", header(), [sample("a", metrics={"sparc": -9.0})])
    with pytest.raises(UsageError, match=r"one and .*three hold different results of 'a'"):
        merge_folders([one, three], tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"kind": "score"}, 'kind is "suite" and "score"'),
        ({"rounds": 3}, "rounds is 2 and 3"),
        ({"code_sha256": "else"}, 'code_sha256 is "c0de" and "else"'),
        ({"weights_sha256": "else"}, "weights_sha256"),
        ({"suite_version": 2}, "suite_version is null and 2"),
        ({"tags": {"run": "8"}}, "tags is"),
        ({"samples_found": 9}, "samples_found is 7 and 9"),
        ({"schema_version": 0}, "schema_version 0, this program writes 2"),
    ],
)
def test_shards_of_different_runs_are_refused(tmp_path, changes, told):
    one = fill(tmp_path / "one", header(), [sample("a")])
    two = fill(tmp_path / "two", header(**changes), [sample("b")])
    with pytest.raises(UsageError, match=told) as error:
        merge_folders([one, two], tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()
    if "schema_version" not in changes:  # nor are they added to what is there
        merge_folders([one], tmp_path / "out")
        with pytest.raises(UsageError, match=f"{told}.*name another \\$out"):
            merge_folders([two], tmp_path / "out")


def test_invalid_shard_and_output_folders_are_refused(tmp_path):
    one = fill(tmp_path / "one", header(), [sample("a")])
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.md").write_text("mine")
    old = fill(tmp_path / "old", header(), [sample("b")])
    (old / "results.json").unlink()
    odd = fill(tmp_path / "odd", header(), [sample("b"), sample("c")])
    (odd / "samples.jsonl").write_text((odd / "samples.jsonl").read_text().replace('"b"', '"../b"'))
    for folders, out, told in (
        ([], "out", "no folder named"),
        ([one, one], "out", "named twice"),
        ([one], "one", "is or lies in"),
        ([one], "one/merged", "is or lies in"),
        ([one], "mine", r"holds something else \(such as notes.md\)"),
        ([mine], "out", "holds no samples.jsonl"),
        ([old], "out", "neither results.json nor run.json"),
        ([odd], "out", "is no file name"),
    ):
        with pytest.raises(UsageError, match=told):
            merge_folders(folders, tmp_path / out)
    assert content(mine) == {"notes.md": b"mine"}
    assert not (tmp_path / "out").exists()


def test_merged_runs_keep_replays_of_the_worst_samples_only(tmp_path):
    facts = header("audit", replays=2)
    parts = [
        fill(
            tmp_path / f"p{k}",
            replace(facts, config={**facts.config, "shard": f"{k}/2"}),
            map(sample, IDS[k - 1 :: 2]),
            replays=2,
        )
        for k in (1, 2)
    ]
    merge_folders(parts, tmp_path / "out")
    worst = sorted(id for id in IDS if not sample(id).feasible)[:2]
    for part in parts:  # also if one comes after the other
        merge_folders([part], tmp_path / "later")
    assert content(tmp_path / "later") == content(tmp_path / "out")
    assert sorted(path.stem for path in (tmp_path / "out" / "replays").iterdir()) == worst


def test_an_unreadable_file_is_reported_as_a_read_error(tmp_path):
    sick = Path("/proc/self/mem")  # opens, but reading its beginning fails, as on a disk with a bad sector
    with pytest.raises(UsageError, match="mem: cannot be read"):
        copy_artifact(sick, tmp_path / "copy")
    assert list(tmp_path.iterdir()) == []


def test_absent_track_files_and_different_versions_are_warned_about(tmp_path):
    one = fill(tmp_path / "one", header(), [sample("a"), sample("c")])
    two = fill(tmp_path / "two", header(versions={"drake": "1.52"}), [sample("b")])
    artifact_path(one, "tracks", "c").unlink()
    ear = Ear()
    merge_folders([one, two], tmp_path / "out", ear)
    assert any("tracks are absent of 1 sample (such as 'c')" in text for text in ear.warnings)
    assert any("different versions of drake" in text for text in ear.warnings)
    assert json.loads((tmp_path / "out" / "results.json").read_text())["versions"] == {"drake": "1.51, 1.52"}


def test_merging_again_changes_nothing(tmp_path):
    one = fill(tmp_path / "one", header(), [sample("a")])
    two = fill(tmp_path / "two", header(versions={"drake": "1.52"}), [sample("b")])
    merge_folders([one, two], tmp_path / "out")
    before = content(tmp_path / "out")
    merge_folders([one, two], tmp_path / "out")
    assert content(tmp_path / "out") == before


def test_an_extended_merge_warns_of_absent_samples_without_naming_shards(shards, tmp_path):
    merge_folders([shards[0]], tmp_path / "out")
    ear = Ear()
    merge_folders([shards[2]], tmp_path / "out", ear)
    assert ear.warnings == ["2 of 7 samples are absent"]


def test_first_frames_of_pending_episodes_are_merged(tmp_path):
    def waiting(id):
        asked = {"id": f"{id}_r1", "video": f"{id}_r1.mp4", "first_frame": f"{id}_r1.png"}
        return sample(
            id, status=Status.UNMEASURABLE, reason="waits", feasible=None, metrics={}, extra={"pending": asked}
        )

    parts = []
    for k, id in enumerate("ac", 1):
        parts.append(fill(tmp_path / f"part{k}", header(shard=f"{k}/2"), [waiting(id)]))
        (parts[-1] / "ask").mkdir()
        (parts[-1] / "ask" / f"{id}_r1.png").write_text(id)
    merge_folders(parts, tmp_path / "out")
    asked = sorted(p.name for p in (tmp_path / "out" / "ask").iterdir())
    assert asked == ["a_r1.png", "c_r1.png", "camera.json", "manifest.jsonl"]
    lines = (tmp_path / "out" / "ask" / "manifest.jsonl").read_text().splitlines()
    assert [json.loads(line)["id"] for line in lines] == ["a_r1", "c_r1"]


def test_run_metadata_round_trips_through_its_file(tmp_path):
    out = fill(tmp_path / "out", header(), [sample("a")], finished=False)
    found = read_metadata(out)
    assert (found.run, found.finished) == (header(), False)
    assert fill(out, header(), []) == out
    assert read_metadata(out).finished
    assert not (out / "run.json").exists()
    (out / "results.json").write_text('{"kind": 3}')
    with pytest.raises(InputError, match="is not what a run writes"):
        read_metadata(out)
