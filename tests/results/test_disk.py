"""Output folders on disks that are full or read-only, and under a clock that jumps."""

import errno
import json
import os
import signal
import time
from pathlib import Path

import pytest

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.io import atomic as storage
from kinebench_drake.results.store import ResultStore, read_rows
from tests.report.pages import row


def full(*_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def filled(out, ids="ab"):
    with ResultStore(out) as store:
        for id in ids:
            store.append(row(id), 0.1)


def test_a_full_disk_is_a_setup_error_and_keeps_finished_rows(tmp_path, monkeypatch):
    filled(tmp_path)
    with ResultStore(tmp_path) as store, monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(SetupError, match="free some space and run the same command again"):
            store.append(row("c"), 0.1)
        with pytest.raises(SetupError, match="free some space"):
            store.finish({})
    assert sorted(read_rows(tmp_path)) == ["a", "b"]
    assert not [p for p in tmp_path.rglob("*") if ".part." in p.name]
    with ResultStore(tmp_path) as store:
        store.append(row("c"), 0.1)
        store.finish({"kind": "score"})
    assert sorted(read_rows(tmp_path)) == ["a", "b", "c"]


def test_a_row_cut_off_by_a_full_disk_is_removed(tmp_path):
    """With a true limit of the system: a file may grow to so many bytes and no more."""
    import resource

    filled(tmp_path)
    limit = (tmp_path / "samples.jsonl").stat().st_size + 40
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with ResultStore(tmp_path) as store:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
            with pytest.raises(SetupError, match="cannot write"):
                store.append(row("c"), 0.1)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert sorted(read_rows(tmp_path)) == ["a", "b"]
    assert (tmp_path / "samples.jsonl").read_bytes().endswith(b"\n")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_output_folder_is_a_usage_error(tmp_path):
    out = tmp_path / "out"
    filled(out)
    out.chmod(0o500)
    try:
        with pytest.raises(UsageError, match="cannot be written"):
            ResultStore(out)
    finally:
        out.chmod(0o700)


def test_a_read_only_file_system_is_an_error_that_keeps_finished_rows(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    filled(tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refuse)
        with pytest.raises(UsageError, match=r"out .* cannot be written \(Read-only file system\)"):
            ResultStore(tmp_path / "out")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", refuse)
        with pytest.raises(SetupError, match="make the folder writable"):
            storage.write_atomically(tmp_path / "out" / "x", b"1")
    assert sorted(read_rows(tmp_path / "out")) == ["a", "b"]


@pytest.mark.parametrize("jump_s", [-1e9, 1e9, -3600.0])
def test_a_jumping_system_clock_changes_no_deadline_and_no_row(tmp_path, monkeypatch, jump_s):
    from kinebench_drake.suites.worldmodels.http_client import Deadline

    true = time.time
    calls = iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: true() + jump_s * (next(calls) % 2))
    deadline = Deadline(60.0)
    assert 59.0 < deadline.left() <= 60.0
    filled(tmp_path)
    for path in tmp_path.iterdir():
        os.utime(path, (true() + jump_s, true() + jump_s))
    with ResultStore(tmp_path) as store:
        assert sorted(store.rows) == ["a", "b"]
        store.append(row("c"), 0.1)
        store.finish({"kind": "score"})
    walls = [json.loads(line)["wall_s"] for line in (tmp_path / "timings.jsonl").read_text().splitlines()]
    assert all(wall >= 0 for wall in walls)
