"""Runs that are killed, that are interrupted, whose disk is full: the next one makes up for them."""

import errno
import os
import re
import signal
import subprocess
import sys

import pytest

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.report import replay
from kinebench_drake.results import store
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.score import score_videos
from tests.fakes.records import content

PROGRAM = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs are born deaf to it
from kinebench_drake import cli
from kinebench_drake.runs.config import ScoreConfig
from tests.fakes.resources import FakeResources
ScoreConfig.__init__.__kwdefaults__["make_resources"] = FakeResources
if __name__ == "__main__":
    cli.main(sys.argv[1:])
"""


@pytest.fixture
def start(tmp_path, fakes):
    """Starts the program in a process of its own, whose workers hold its standard error open."""
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)

    def run(*arguments):
        return subprocess.Popen(
            [sys.executable, script, *map(str, arguments)], stderr=subprocess.PIPE, text=True, process_group=0
        )

    return run


def lines_until(stream, beginning):
    """Read lines until one begins with this; fail at the end of the stream."""
    lines = []
    for line in stream:
        lines.append(line)
        if line.startswith(beginning):
            return
    raise AssertionError(f"no line begins with {beginning!r}: {lines}")


@pytest.mark.parametrize(("jobs", "waiting"), [(1, "waits_in_overlay"), (2, "waits_for")])
def test_a_run_killed_by_sigkill_and_resumed_has_the_files_of_an_uninterrupted_run(
    film, config, fakes, gate, start, tmp_path, jobs, waiting
):
    for k in range(5):
        film(f"videos/v{k}.mp4", **{waiting: gate if k > 1 else None})
    out = tmp_path / "killed"
    with gate.closed():
        process = start("score", tmp_path / "videos", "--out", out, "--overlay", "--replays", 0, "--jobs", jobs)
        lines_until(process.stderr, "[2/5] ")
        process.kill()
    process.communicate()  # orphaned workers end, too
    done = read_rows(out)
    assert set(done) == {"v0", "v1"}
    with (out / "samples.jsonl").open("a") as file:
        file.write('{"id": "v4", "sta')  # as if it had been writing
    fakes.take_calls()
    score_videos(config(out=out, overlay=True, replays=0))
    assert len(fakes.take_calls()) == 5 - len(done)
    score_videos(config(out=tmp_path / "whole", overlay=True, replays=0))
    assert content(out) == content(tmp_path / "whole")


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_prints_how_to_resume(program, film, gate, start, tmp_path, jobs, sent):
    for k in range(6):
        film(f"videos/v{k}.mp4", waits_for=gate if k else None)
    out = tmp_path / "out"
    arguments = ["score", tmp_path / "videos", "--out", out]
    with gate.closed():
        process = start(*arguments, "--jobs", jobs)
        lines_until(process.stderr, "[1/6] ")
        os.killpg(process.pid, sent) if sent == signal.SIGINT else process.send_signal(sent)
    _, err = process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in err
    assert re.search(r"interrupted with \d of 6 samples finished; run the same command again", err)
    kept = len(read_rows(out))
    assert 1 <= kept < 6
    code, _, err = program(*arguments)
    assert code == 0
    assert f"{kept} of 6 samples are finished already" in err


def test_a_full_disk_stops_the_run_and_keeps_finished_rows(film, config, tmp_path, monkeypatch):
    for k in range(3):
        film(f"videos/v{k}.mp4")
    append = store.append_line
    written = []

    def append_one(path, row):
        if path.name == store.SAMPLES:
            if written:
                with disk_errors(path.name):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            written.append(row)
        return append(path, row)

    with monkeypatch.context() as patch:
        patch.setattr(store, "append_line", append_one)
        with pytest.raises(SetupError, match="No space left"):
            score_videos(config())
    assert set(read_rows(tmp_path / "out")) == {"v0"}
    assert score_videos(config()).counts[Status.OK] == 3


def test_replays_that_could_not_be_written_are_made_up_on_the_next_run(film, config, tmp_path, monkeypatch):
    film("videos/a.mp4")
    written = []

    def fail(out, ids, plant):
        raise SetupError("cannot write a.html (No space left on device)")

    monkeypatch.setattr(replay, "write_replays", fail)
    with pytest.raises(SetupError):
        score_videos(config(replays=3))
    assert (tmp_path / "out" / "report.html").is_file()
    monkeypatch.setattr(replay, "write_replays", lambda out, ids, plant: written.extend(ids))
    score_videos(config(replays=3))
    assert written == ["a"]


def test_a_failed_run_leaves_no_empty_folder(film, config, tmp_path):
    film("videos/a.mp4", raises=RuntimeError())
    score_videos(config())
    with pytest.raises(UsageError):
        score_videos(config(source=film("others/b.mp4").parent, out=tmp_path / "out"))
    assert [p for p in (tmp_path / "out").iterdir() if p.is_dir()] == []
