import errno
import json
import pickle
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.errors import InputError, SetupError, UsageError
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.io.jsonl import dump
from kinebench_drake.results import store as results
from kinebench_drake.results.aggregate import aggregate, estimate, split_rows
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import ResultStore, read_rows
from tests.rows import make_row


def row(id="a", status=Status.OK, **changes):
    values = {"content_hash": "0" * 64, "feasible": True, "metrics": {"sparc": -1.5, "ldlj": float("nan")}}
    return make_row(id, status, **{**values, **changes})


def test_rows_in_memory_share_equal_strings(tmp_path):
    """As they come from worker processes each has its own copy of every name: most of a row's memory."""
    told = row(
        metrics={"sparc": -1.5},
        details={"limits": {"joints": ["joint 1"]}},
        violations=({"kind": "jerk"},),
        extra={"seed": 7},
    )
    with ResultStore(tmp_path / "a") as store:
        for name in "ab":
            store.append(pickle.loads(pickle.dumps(replace(told, id=name))), 0.1)
        kept = store.rows
    for rows in (kept, read_rows(tmp_path / "a")):
        a, b = rows.values()
        assert a == replace(b, id="a")
        assert [id(key) for key in a.metrics] == [id(key) for key in b.metrics]
        assert a.details["limits"]["joints"][0] is b.details["limits"]["joints"][0]
        assert a.violations[0].unit is b.violations[0].unit
        assert a.content_hash is b.content_hash


@pytest.mark.parametrize("folder", ["overlays", "videos"])
def test_partial_videos_of_a_killed_worker_are_removed(tmp_path, monkeypatch, folder):
    """A worker that is lost half-way leaves part of a film; the run goes on with another and ends."""
    left = []
    (tmp_path / folder).mkdir()
    with monkeypatch.context() as patch:
        patch.setattr("os.replace", lambda source, target: left.append(source))
        write_video(tmp_path / folder / "a.mp4", np.zeros((2, 96, 96, 3), np.uint8), 17.0)
    with ResultStore(tmp_path) as store:
        for path in left:
            path.write_bytes(b"half")
        (tmp_path / folder / "a.mp4").write_bytes(b"whole")
        store.append(row(), 0.1)
        store.finish({})
    assert len(left) == 1
    assert [path.name for path in (tmp_path / folder).iterdir()] == ["a.mp4"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_the_work_folder_of_a_killed_world_model_is_removed(tmp_path, overwrite):
    """A program works in a folder of its own, named as unfinished files are."""
    left = tmp_path / "videos" / ".7.part.abc"
    left.mkdir(parents=True)
    (left / "video.mp4").write_bytes(b"half")
    (tmp_path / "mine").mkdir()
    (tmp_path / "videos" / ".8.part.link").symlink_to(tmp_path / "mine")
    with ResultStore(tmp_path, overwrite=overwrite):
        assert list((tmp_path / "videos").iterdir()) == []
        assert (tmp_path / "mine").is_dir()


def test_rows_are_strict_json_without_nan():
    assert "NaN" not in dump(row(metrics={"a": float("nan"), "b": float("inf")}).to_json())
    with pytest.raises(ValueError, match="not JSON compliant"):
        dump({"a": float("nan")})


@pytest.mark.parametrize("torn", ["{", '{"id": "b", "status": "ok"', '{"id": "b", "vid\n', "\0\0\0\0"])
def test_a_torn_last_line_is_dropped_on_resume(tmp_path, torn):
    with ResultStore(tmp_path) as store:
        store.append(row("a"), 0.1)
    with (tmp_path / results.SAMPLES).open("a") as file:
        file.write(torn)
    with ResultStore(tmp_path) as store:
        assert list(store.rows) == ["a"]
        store.keep_rows(lambda _: True)
        store.append(row("c"), 0.1)
    assert list(read_rows(tmp_path)) == ["a", "c"]


@pytest.mark.parametrize("id", ["", "../victim", "a/b", "/etc/passwd", "..", ".hidden", "a\0b"])
def test_a_row_whose_id_is_no_file_name_is_refused(id):
    with pytest.raises(InputError, match="is no file name"):
        SampleRow.from_json({**row("a").to_json(), "id": id})


def test_a_broken_line_in_the_middle_is_refused_without_overwrite(tmp_path):
    (tmp_path / results.SAMPLES).write_text("garbage\n" + dump(row().to_json()))
    with pytest.raises(InputError, match="line 1 is broken"):
        read_rows(tmp_path)
    with pytest.raises(UsageError, match="overwrite=True"):
        ResultStore(tmp_path)
    with ResultStore(tmp_path, overwrite=True) as store:
        assert not store.rows


def test_finished_rows_are_sorted_by_id_and_hold_no_timings(tmp_path):
    with ResultStore(tmp_path) as store:
        for id in "cab":
            store.append(row(id), 0.123)
        store.finish({"schema_version": 1})
    lines = (tmp_path / "samples.jsonl").read_text().splitlines()
    assert [json.loads(line)["id"] for line in lines] == ["a", "b", "c"]
    assert not any("wall" in line for line in lines)
    timings = [json.loads(line) for line in (tmp_path / "timings.jsonl").read_text().splitlines()]
    assert [t["id"] for t in timings] == ["c", "a", "b"]


def test_a_second_run_in_the_same_output_folder_is_refused(tmp_path):
    with ResultStore(tmp_path), pytest.raises(UsageError, match="another run"):
        ResultStore(tmp_path)
    with ResultStore(tmp_path):
        pass


def test_an_output_path_that_is_a_file_is_a_usage_error(tmp_path):
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(UsageError, match="cannot be written"):
            ResultStore(out)


@pytest.mark.parametrize("name", ["tracks", "replays", "videos", "ask"])
def test_an_artifact_folder_that_is_a_link_is_refused(tmp_path, name):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match=f"{name} is a link"):
        ResultStore(tmp_path / "out", overwrite=True)


def test_only_files_of_the_run_s_own_rows_are_removed(tmp_path):
    def left():
        return sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file())

    with ResultStore(tmp_path) as store:
        for id in ("a", "b"):
            store.append(row(id), 1.0)
        for name in ("replays/a.html", "replays/b.html", "replays/mine.html", "tracks/.7.part.b.npz", "notes.md"):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).touch()
        store.keep_artifacts("replays", ["a"])
    assert [name for name in left() if "/" in name] == ["replays/a.html", "replays/mine.html", "tracks/.7.part.b.npz"]
    with ResultStore(tmp_path, overwrite=True):
        assert left() == ["notes.md", "replays/mine.html", "samples.jsonl"]


def test_an_artifact_that_cannot_be_deleted_is_a_setup_error(tmp_path, monkeypatch):
    with ResultStore(tmp_path) as store:
        store.append(row("a"), 0.1)
        (tmp_path / "tracks").mkdir()
        monkeypatch.setattr(results, "artifact_path", lambda out, part, id: out / part)  # a folder cannot be unlinked
        with pytest.raises(SetupError, match="make the folder writable"):
            store.keep_rows(lambda _: False)


def test_a_failed_atomic_write_keeps_the_old_file_and_leaves_no_other(tmp_path, monkeypatch):
    write_atomically(tmp_path / "a", b"old")
    monkeypatch.setattr(results.os, "replace", lambda *_: (_ for _ in ()).throw(OSError(errno.EIO, "I/O error")))
    with pytest.raises(SetupError, match="I/O error"):
        write_atomically(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_bootstrap_interval_covers_the_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(200):
        e = estimate([float(v) for v in rng.normal(3.0, 1.0, size=40)], total=40)
        hits += e.low <= 3.0 <= e.high
    assert 0.88 <= hits / 200 <= 0.99


def test_a_chunked_bootstrap_gives_the_same_estimate_in_less_memory(monkeypatch):
    values = [float(v) for v in np.random.default_rng(1).normal(size=701)]
    whole = estimate(values, total=701, seed=4)
    monkeypatch.setattr("kinebench_drake.stats._AT_ONCE", 10_000)
    tracemalloc.start()
    assert estimate(values, total=701, seed=4) == whole
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2000 * 701 * 8 / 4


def test_means_of_no_values_are_null_and_intervals_of_one_value_or_equal_values_are_null():
    assert estimate([], total=3).mean is None
    assert estimate([None, float("nan")], total=3).n == 0
    one = estimate([2.0], total=3)
    assert (one.mean, one.low, one.high, one.n, one.total) == (2.0, None, None, 1, 3)
    same = estimate([2.0, 2.0], total=2)
    assert (same.mean, same.low, same.high) == (2.0, None, None)


def test_aggregates_count_all_samples_and_average_only_measured_ones():
    vanish = [{"kind": "vanish", "frame_start": 1, "frame_end": 2, "severity": 1.0}] * 2
    rows = [
        row("a", metrics={"sparc": -1.0, "anomalies": vanish}, model="m"),
        row("b", metrics={"sparc": None}, feasible=False, violations=({"kind": "jerk"}, {"kind": "jerk"}), model="m"),
        row("c", Status.UNMEASURABLE, metrics={"sparc": 0.0}, feasible=None, model="n"),
        row("d", Status.ERROR, metrics={}, feasible=None),
    ]
    told = aggregate(rows).to_json()
    assert told["samples"] == {"total": 4, "ok": 2, "unmeasurable": 1, "error": 1}
    assert told["feasible"]["mean"] == 0.5
    assert (told["metrics"]["sparc"]["mean"], told["metrics"]["sparc"]["n"], told["metrics"]["sparc"]["total"]) == (
        *(-1.0, 1, 4),
    )
    assert told["violations"] == {"jerk": 1}
    assert told["anomalies"] == {"vanish": 1}
    assert {name: len(group) for name, group in split_rows(rows, "model").items()} == {"m": 2, "n": 1}


def test_an_output_folder_has_no_empty_subfolders(tmp_path):
    with ResultStore(tmp_path) as store:
        assert [p.name for p in tmp_path.iterdir()] == ["samples.jsonl"]
        (tmp_path / "videos").mkdir()  # of a world model that gave none
        store.finish({})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["results.json", "samples.jsonl"]


def _long(id):
    details = {"limits": {"joints": [f"joint {k}" for k in range(300)]}, "of": id}
    metrics = {f"metric_{k}": 0.1 * k for k in range(40)}
    return row(id, details=details, metrics=metrics, null_reasons={"sparc": f"none of {id}"}, extra={"seed": 7})


def test_rows_in_memory_are_a_fraction_of_the_size_of_samples_jsonl(tmp_path):
    """Details stay in the file until they are asked for."""
    ids = [f"{k:03d}" for k in range(300)]
    with ResultStore(tmp_path) as store:
        for id in ids:
            store.append(_long(id), 0.1)
    read_rows(tmp_path)
    tracemalloc.start()
    rows = read_rows(tmp_path)
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert kept < 0.6 * (tmp_path / results.SAMPLES).stat().st_size
    assert kept < 3000 * len(rows)
    assert [rows[id].details["of"] for id in ids] == ids
    assert rows["007"] == _long("007")


def test_rows_stay_readable_while_their_file_is_sorted_and_replaced(tmp_path):
    with ResultStore(tmp_path) as store:
        for id in "cab":
            store.append(_long(id), 0.1)
        before = dict(store.rows)
        read = read_rows(tmp_path)
        store.finish({})
        store.append(_long("aa"), 0.1)
        (tmp_path / results.SAMPLES).rename(tmp_path / "elsewhere")
        for rows in (before, read, store.rows):
            assert {id: r.details["of"] for id, r in rows.items()} == {id: id for id in rows}
            assert {id: dict(r.null_reasons) for id, r in rows.items()} == {
                id: {"sparc": f"none of {id}"} for id in rows
            }
        assert pickle.loads(pickle.dumps(store.rows["c"])) == _long("c")


def test_a_sorted_samples_jsonl_is_not_rewritten(tmp_path):
    with ResultStore(tmp_path) as store:
        for id in "ba":
            store.append(_long(id), 0.1)
        store.finish({})
    before = (tmp_path / results.SAMPLES).stat().st_ino
    with ResultStore(tmp_path) as store:
        store.keep_rows(lambda _: True)
        store.finish({})
    assert (tmp_path / results.SAMPLES).stat().st_ino == before
    with ResultStore(tmp_path) as store:
        store.keep_rows(lambda row: row.id == "b")
    assert list(read_rows(tmp_path)) == ["b"]
