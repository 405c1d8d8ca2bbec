"""Whole runs over tiny videos with fake analyzer: rows, resume, crashes, full disks."""

import errno
import html
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from fake_tools import LOG, Act, FakeGrounder, FakeTools, broken
from PIL import Image

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.report import replay
from kinebench_drake.results import store
from kinebench_drake.results.inputs import input_lines, list_inputs
from kinebench_drake.results.metadata import Shard
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs import score
from kinebench_drake.runs.config import RunKind
from kinebench_drake.runs.evaluator import KINEMATIC_METRICS
from kinebench_drake.runs.runner import NullRunObserver
from kinebench_drake.runs.score import VISUAL_METRICS, score_videos
from kinebench_drake.track import Domain


@pytest.fixture
def log(tmp_path, monkeypatch):
    path = tmp_path / "log"
    path.touch()
    monkeypatch.setenv(LOG, str(path))
    return path


class Ear(NullRunObserver):
    def __init__(self):
        self.warnings = []

    def warn(self, message):
        self.warnings.append(message)


def content(out):
    """Every byte of an output folder but the timings."""
    return {
        p.relative_to(out).as_posix(): p.read_bytes() for p in out.rglob("*") if p.is_file() and "timings" not in p.name
    }


def test_with_a_task_duration_long_videos_are_resampled_to_the_frame_period(film, config, tmp_path):
    film("videos/long.mp4", frames=20)
    film("videos/short.mp4", frames=4)
    (tmp_path / "depth").mkdir()
    depth = np.full((20, 96, 96), 1.0)
    depth[1:, ...] += np.arange(19)[:, None, None]
    np.save(tmp_path / "depth" / "long.npy", depth)
    np.save(tmp_path / "depth" / "short.npy", np.ones((4, 96, 96)))
    score_videos(config(task_duration_s=1.8, depth=str(tmp_path / "depth"), overlay=True))
    rows = read_rows(tmp_path / "out")
    for id, clip, frames, period in (("long", 20, 10, 0.2), ("short", 4, 4, 0.6)):
        told = {name: rows[id].extra[name] for name in ("clip_timing", "clip_frames", "frames", "frame_period_source")}
        assert told == {
            "clip_timing": "uniform", "clip_frames": clip, "frames": frames, "frame_period_source": "task_duration",
        }  # fmt: skip
        assert rows[id].extra["frame_period_s"] == pytest.approx(period)
        with np.load(tmp_path / "out" / "tracks" / f"{id}.npz") as track:
            taken = np.rint(np.linspace(0, clip - 1, frames))
            np.testing.assert_allclose(track["t_s"], taken * 1.8 / (clip - 1))
        assert len(read_video(tmp_path / "out" / "overlays" / f"{id}.mp4").frames) == frames
    stated = json.loads((tmp_path / "out" / "results.json").read_text())["config"]
    assert stated["task_duration_s"] == 1.8
    score_videos(config(task_duration_s=9.6, frame_period_s=1.2, out=tmp_path / "other"))
    assert read_rows(tmp_path / "other")["long"].extra["frames"] == 9


def test_task_durations_out_of_range_are_refused(config):
    with pytest.raises(UsageError, match=r"\$task_duration_s is nan, expected seconds from 0.0001 to 1000"):
        config(task_duration_s=float("nan"))


def test_every_kind_of_sample_becomes_a_row(film, config, tmp_path):
    film("videos/good.mp4")
    film("videos/bad.mp4", Act.INFEASIBLE)
    film("videos/empty_room.mp4", Act.NO_ROBOT)
    film("videos/bug.mp4", Act.RAISE)
    film("videos/single.mp4", frames=1)
    film("videos/tiny.mp4", side=8)
    (tmp_path / "videos" / "zero.mp4").touch()
    (tmp_path / "videos" / "text.mp4").write_text("no film")
    cut = film("videos/cut.mp4")
    cut.write_bytes(cut.read_bytes()[:-600])
    summary = score_videos(config())
    rows = read_rows(tmp_path / "out")
    told = {id: (row.status.value, row.feasible) for id, row in rows.items()}
    assert told == {
        "good": ("ok", True),
        "bad": ("ok", False),
        "empty_room": ("unmeasurable", None),
        "bug": ("error", None),
        "single": ("unmeasurable", None),
        "tiny": ("unmeasurable", None),
        "zero": ("error", None),
        "text": ("error", None),
        "cut": ("error", None),
    }
    assert summary.counts == {Status.OK: 2, Status.UNMEASURABLE: 3, Status.ERROR: 4}
    assert rows["bug"].reason == "unexpected RuntimeError: the fake fell over"
    assert "in any of 8 frames" in rows["empty_room"].reason
    assert "at least 2" in rows["single"].reason
    assert "at least 64 px" in rows["tiny"].reason
    for row in rows.values():
        assert set(row.metrics) >= {*KINEMATIC_METRICS, *VISUAL_METRICS}
        if row.status is not Status.OK:
            assert row.reason
            assert "\n" not in row.reason
            assert set(row.metrics.values()) == {None}
    assert rows["good"].metrics["ldlj"] is None
    assert rows["good"].null_reasons["ldlj"] == "the fake has none"
    assert rows["good"].details == {"table_height_m": 0.0}
    for id in ("good", "bad"):  # what is null has a reason, what is not has none
        assert set(rows[id].null_reasons) == {name for name, value in rows[id].metrics.items() if value is None}
        assert all(rows[id].null_reasons.values())
    assert rows["bad"].metrics["anomalies"] == [{"kind": "vanish", "frame_start": 4, "frame_end": 5, "severity": 2.0}]
    assert {p.stem for p in (tmp_path / "out" / "tracks").iterdir()} == {"good", "bad"}
    told = json.loads((tmp_path / "out" / "results.json").read_text())
    assert told["aggregates"]["feasible"]["n"] == 2
    assert told["aggregates"]["samples"] == {"total": 9, "ok": 2, "unmeasurable": 3, "error": 4}


def test_outputs_are_byte_equal_between_runs_and_for_any_number_of_jobs(film, config, tmp_path):
    for k in range(4):
        film(f"videos/v{k}.mp4", Act.INFEASIBLE if k == 2 else Act.FEASIBLE)
    score_videos(config(out=tmp_path / "a", overlay=True))
    score_videos(config(out=tmp_path / "b", overlay=True))
    first = content(tmp_path / "a")
    assert first == content(tmp_path / "b")
    assert len(first) == 4 * 3 + 4
    score_videos(config(out=tmp_path / "c", overlay=True, jobs=2))
    third = content(tmp_path / "c")
    unlike = {name for name in first if first[name] != third[name]}
    assert unlike <= {"results.json", "report.html"}  # they tell the number of jobs
    assert str(tmp_path) not in b"".join(first.values()).decode(errors="ignore")


def test_ground_writes_tracks_and_visual_metrics_without_verdict_or_report(film, config, tmp_path):
    film("videos/a.mp4")
    summary = score_videos(config(kind=RunKind.GROUND, overlay=True))
    assert (summary.report, summary.feasible) == (None, None)
    (row,) = read_rows(tmp_path / "out").values()
    assert set(row.metrics) == set(VISUAL_METRICS)
    assert (row.feasible, row.violations) == (None, ())
    with np.load(tmp_path / "out" / "tracks" / "a.npz") as track:
        assert np.isnan(track["q"]).all()
        assert not track["ik_ok"].any()
    assert not (tmp_path / "out" / "report.html").exists()
    assert len(read_video(tmp_path / "out" / "overlays" / "a.mp4").frames) == 8


def test_resume_skips_finished_samples_unless_inputs_or_options_changed(film, config, tmp_path, log):
    def grounded(**changes):
        log.write_text("")
        score_videos(config(**changes))
        return len(log.read_text().splitlines())

    film("videos/a.mp4")
    film("videos/b.mp4", Act.NO_ROBOT)
    assert grounded() == 2
    first = content(tmp_path / "out")
    assert grounded() == 0
    assert content(tmp_path / "out") == first
    assert grounded(overwrite=True) == 2
    assert content(tmp_path / "out") == first
    film("videos/c.mp4")
    assert grounded() == 1
    film("videos/a.mp4", frames=9)  # other bytes
    assert grounded() == 1
    assert grounded(frame_period_s=0.2) == 3
    assert grounded(frame_period_s=0.2, model="m") == 3
    assert grounded(frame_period_s=0.2, model="m", table_height_m=0.1) == 3
    assert grounded(frame_period_s=0.2, model="m") == 3
    save_camera(benchmark_camera().resized(192, 192), tmp_path / "videos" / "camera.json")
    assert grounded(frame_period_s=0.2, model="m") == 3
    assert grounded(frame_period_s=0.2, model="m", overlay=True) == 2  # the unmeasurable one has no overlay
    (tmp_path / "out" / "tracks" / "c.npz").unlink()
    assert grounded(frame_period_s=0.2, model="m") == 1
    (tmp_path / "videos" / "c.mp4").unlink()
    assert grounded(frame_period_s=0.2, model="m") == 0
    assert set(read_rows(tmp_path / "out")) == {"a", "b"}
    assert not (tmp_path / "out" / "tracks" / "c.npz").exists()


@pytest.mark.parametrize("part", [{"limit": 1}, {"shard": Shard(index=1, count=3)}])
def test_a_partial_run_keeps_other_rows_and_refuses_to_run_if_they_are_outdated(film, config, tmp_path, log, part):
    """`results.json` tells one configuration, of all rows."""
    for name in ("a", "b"):
        film(f"videos/{name}.mp4")
    film("videos/c.mp4", Act.RAISE)
    score_videos(config(frame_period_s=0.2))
    log.write_text("")
    score_videos(config(frame_period_s=0.2, **part))
    assert set(read_rows(tmp_path / "out")) == {"a", "b", "c"}  # the error, too: nothing has changed
    before = content(tmp_path / "out")
    film("videos/b.mp4", frames=9)
    for changes in ({"frame_period_s": 0.2}, {"frame_period_s": 0.1}):
        with pytest.raises(UsageError, match=r"1 of its 3 results would be lost \(such as 'b'\).*not among those"):
            score_videos(config(**changes, **part))
        assert content(tmp_path / "out") == before
    assert not log.read_text()
    score_videos(config(frame_period_s=0.1))
    rows = read_rows(tmp_path / "out").items()
    assert {id: row.extra["frame_period_s"] for id, row in rows if row.status is Status.OK} == {"a": 0.1, "b": 0.1}


def test_an_output_folder_of_another_run_kind_is_refused_without_overwrite(film, config, tmp_path):
    film("videos/a.mp4")
    score_videos(config(kind=RunKind.GROUND))
    before = content(tmp_path / "out")
    with pytest.raises(UsageError, match=r"of kind ground, this one is of kind score; name another.*overwrite=True"):
        score_videos(config())
    assert content(tmp_path / "out") == before
    score_videos(config(overwrite=True))
    assert json.loads((tmp_path / "out" / "results.json").read_text())["kind"] == "score"


def test_undecodable_file_names_are_written_with_replacement_characters(film, config, tmp_path):
    """A lone surrogate, as Python reads such names, cannot be written in any encoding."""
    os.rename(film("videos/a.mp4"), os.fsencode(tmp_path / "videos") + b"/caf\xe9.mp4")
    os.rename(tmp_path / "videos", os.fsencode(tmp_path) + b"/vid\xe9os")
    source = next(p for p in tmp_path.iterdir() if p.name.startswith("vid"))
    for _ in range(2):  # also when it goes on
        summary = score_videos(config(source=source, tags={"note": "\udce9"}, task="\ud800"))
    (row,) = summary.rows
    assert (row.id, row.video, row.task, row.status) == ("caf_", "caf?.mp4", "?", Status.OK)
    told = json.loads((tmp_path / "out" / "results.json").read_text())
    assert (told["config"]["source"], told["tags"], list(told["per_task"])) == ("vid?os", {"note": "?"}, ["?"])
    assert "caf?.mp4" in summary.report.read_text()


def test_a_sample_with_nan_in_its_video_part_still_has_a_hash_and_a_row(film, config, tmp_path, monkeypatch):
    """Whatever readers let through, the boundary of the sample holds."""
    film("videos/a.mp4", Act.RAISE)
    find = score.find_samples

    def told(*arguments, **named):
        found = find(*arguments, **named)
        (sample,) = found.samples
        part = replace(sample.part, from_s=float("nan"), to_s=float("nan"))
        return replace(found, samples=(replace(sample, part=part),))

    monkeypatch.setattr(score, "find_samples", told)
    score_videos(config())
    (row,) = read_rows(tmp_path / "out").values()
    assert row.status is Status.ERROR
    assert len(row.content_hash) == 64


def test_another_code_version_invalidates_stored_rows(film, config, log, monkeypatch):
    film("videos/a.mp4")
    score_videos(config())
    score_videos(config())
    assert len(log.read_text().splitlines()) == 1
    monkeypatch.setattr(score, "VideoEvaluator", partial(score.VideoEvaluator, code="another version"))
    score_videos(config())
    assert len(log.read_text().splitlines()) == 2


def test_results_and_report_are_rewritten_only_when_something_changed(film, config, tmp_path, monkeypatch):
    def written():
        return [(tmp_path / "out" / name).stat().st_mtime_ns for name in ("results.json", "report.html")]

    def again(**changes):
        before = written()
        told.append(score_videos(config(**changes)))
        return [now != then for now, then in zip(written(), before, strict=True)]

    film("videos/a.mp4")
    film("videos/b.mp4", Act.INFEASIBLE)
    (tmp_path / "videos" / "c.mp4").touch()  # an error, which is tried again and remains
    told = [score_videos(config())]
    first = content(tmp_path / "out")
    assert again() == [False, False]
    assert told[1] == told[0]
    (tmp_path / "out" / "report.html").write_text("half a page")  # as if the run had been killed before it
    assert again() == [True, True]
    assert content(tmp_path / "out") == first
    (tmp_path / "out" / "replays").mkdir()
    (tmp_path / "out" / "replays" / "a.html").touch()  # as `view` writes one
    assert again() == [True, True]
    assert "replays/a.html" in (tmp_path / "out" / "report.html").read_text()
    assert again(seed=1) == [True, True]
    assert again(seed=1) == [False, False]
    monkeypatch.setattr("kinebench_drake.report.page.report_hash", lambda: "another version")
    assert again(seed=1) == [True, True]
    assert told[-1].counts == told[0].counts


@pytest.mark.parametrize("kind", [RunKind.GROUND, RunKind.SCORE])
def test_repeating_a_finished_run_writes_no_file(film, config, tmp_path, kind):
    film("videos/a.mp4")
    score_videos(config(kind=kind))
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    score_videos(config(kind=kind))
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")} == before


def test_deleted_track_thumbnail_and_overlay_files_are_restored_byte_by_byte(film, config, tmp_path):
    film("videos/a.mp4")
    score_videos(config(overlay=True))
    files = [path for path in (tmp_path / "out").glob("*/a.*") if path.parent.name != "videos"]
    assert {path.parent.name for path in files} >= {"tracks", "thumbnails", "overlays"}
    for path in files:
        content = path.read_bytes()
        path.unlink()
        score_videos(config(overlay=True))
        assert path.read_bytes() == content


def test_error_rows_are_retried_by_the_next_run(film, config, tmp_path):
    path = film("videos/a.mp4")
    data = path.read_bytes()
    path.write_bytes(b"")
    assert score_videos(config()).counts[Status.ERROR] == 1
    path.write_bytes(data)
    assert score_videos(config()).counts[Status.OK] == 1


def test_an_output_folder_of_another_source_is_refused_without_overwrite(film, config, tmp_path):
    film("videos/a.mp4")
    film("others/b.mp4")
    score_videos(config())
    with pytest.raises(UsageError, match=r"of source .videos., this run is of .others.; name another folder"):
        score_videos(config(source=tmp_path / "others"))
    assert set(read_rows(tmp_path / "out")) == {"a"}
    score_videos(config(source=tmp_path / "others", overwrite=True))
    assert set(read_rows(tmp_path / "out")) == {"b"}


def test_limit_and_shard_score_only_their_part_of_the_samples(film, config, tmp_path):
    for k in range(5):
        film(f"videos/v{k}.mp4")
    score_videos(config(limit=2))
    assert set(read_rows(tmp_path / "out")) == {"v0", "v1"}
    for index in (1, 2):
        out = tmp_path / f"part{index}"
        score_videos(config(out=out, shard=Shard(index=index, count=2)))
        assert set(read_rows(out)) == {f"v{k}" for k in range(index - 1, 5, 2)}
        score_videos(config(shard=Shard(index=index, count=2)))  # into one folder, one after the other
    assert set(read_rows(tmp_path / "out")) == {f"v{k}" for k in range(5)}


def test_a_killed_worker_makes_only_its_sample_an_error(film, config, tmp_path):
    for k, act in enumerate([Act.FEASIBLE, Act.DIE, Act.FEASIBLE, Act.DIE, Act.FEASIBLE]):
        film(f"videos/v{k}.mp4", act)
    score_videos(config(jobs=2))
    rows = read_rows(tmp_path / "out")
    assert {id for id, row in rows.items() if row.status is Status.OK} == {"v0", "v2", "v4"}
    assert "SIGKILL" in rows["v1"].reason
    assert rows["v1"].status is rows["v3"].status is Status.ERROR


def test_an_analyzer_that_cannot_be_loaded_stops_the_run_before_any_row(film, config, tmp_path):
    for k in range(3):
        film(f"videos/v{k}.mp4")
    for jobs in (1, 2):
        with pytest.raises(SetupError, match="doctor"):
            score_videos(config(make_resources=broken, jobs=jobs))
    assert read_rows(tmp_path / "out") == {}


def test_options_out_of_range_or_in_conflict_are_refused(film, config, monkeypatch):
    film("videos/a.mp4")
    with pytest.raises(UsageError, match=r"address a:1 goes with \$engine ray"):
        score_videos(config(address="a:1"))
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SetupError, match=r"pip install 'kinebench-drake\[ray\]'"):
        score_videos(config(engine=ExecutorKind.RAY))
    for changes in ({"limit": 0}, {"seed": -1}, {"frame_period_s": float("nan")}, {"frame_period_s": 0.0}):
        with pytest.raises(UsageError, match="expected"):
            config(**changes)
    with pytest.raises(UsageError, match="jobs is 0"):
        score_videos(config(jobs=0))


def frame_period(row):
    return row.extra["frame_period_s"], row.extra["frame_period_source"]


def test_the_frame_period_is_that_of_option_manifest_file_or_benchmark_and_names_its_source(film, config, tmp_path):
    film("videos/a.mp4", fps=10)
    folder = tmp_path / "videos" / "still"
    folder.mkdir()
    for k in range(3):
        Image.fromarray(np.full((96, 96, 3), 90 * (k > 3), dtype=np.uint8)).save(folder / f"{k}.png")
    ear = Ear()
    summary = score_videos(config(), ear)
    rows = read_rows(tmp_path / "out")
    assert input_lines(summary.rows) == [
        "frame period: 0.1 s, 1 / fps of the file (1 x); 0.2 s, the benchmark's, by default (1 x)",
        "camera: the benchmark's",
        "look: familiar to the networks",
    ]
    for line in input_lines(summary.rows):
        assert f'<p class="note">{line.capitalize()}</p>' in html.unescape(summary.report.read_text())
    assert json.loads((tmp_path / "out" / "results.json").read_text())["inputs"] == list_inputs(summary.rows)
    assert frame_period(rows["a"]) == (pytest.approx(0.1), "fps")
    assert frame_period(rows["still"]) == (0.2, "benchmark")
    assert any("$frame_period_s" in w for w in ear.warnings)
    score_videos(config(frame_period_s=0.5))
    assert frame_period(read_rows(tmp_path / "out")["a"]) == (0.5, "option")
    lines = [{"video": "a.mp4", "frame_period_s": 0.25, "fps": 4, "id": "a1"}, {"video": "a.mp4", "fps": 4, "id": "a2"}]
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text("\n".join(map(json.dumps, lines)))
    score_videos(config(source=manifest, out=tmp_path / "m"))
    rows = read_rows(tmp_path / "m")
    assert [frame_period(rows[i]) for i in ("a1", "a2")] == [(0.25, "manifest"), (0.25, "manifest_fps")]
    with np.load(tmp_path / "m" / "tracks" / "a1.npz") as track:
        assert track["t_s"] == pytest.approx(0.25 * np.arange(8))


def test_a_camera_of_another_aspect_ratio_makes_the_sample_unmeasurable(film, config, tmp_path):
    images = np.zeros((4, 96, 160, 3), dtype=np.uint8)
    film("videos/a.mp4")
    np.save(tmp_path / "videos" / "wide.npy", images)
    for source, status in (("wide.npy", Status.UNMEASURABLE), ("a.mp4", Status.OK)):
        score_videos(config(source=tmp_path / "videos" / source, out=tmp_path / source[0], camera="benchmark"))
        (row,) = read_rows(tmp_path / source[0]).values()
        assert row.status is status
        assert row.extra["camera_source"] == "option"
    reason = read_rows(tmp_path / "w")["wide"].reason
    assert "aspect ratios differ" in reason
    assert reason.endswith("its conditioning image: save it as ID.png beside ID.mp4")


def test_a_full_disk_stops_the_run_and_keeps_finished_rows(film, config, tmp_path, monkeypatch):
    for k in range(3):
        film(f"videos/v{k}.mp4")
    append = store.append_line
    written = []

    def full(path, row):
        if path.name == store.SAMPLES:
            if written:
                with disk_errors(path.name):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            written.append(row)
        return append(path, row)

    monkeypatch.setattr(store, "append_line", full)
    with pytest.raises(SetupError, match="No space left"):
        score_videos(config())
    assert set(read_rows(tmp_path / "out")) == {"v0"}
    monkeypatch.setattr(store, "append_line", append)
    assert score_videos(config()).counts[Status.OK] == 3


RUN = """
import sys
from pathlib import Path
from fake_tools import FakeTools
from kinebench_drake.runs.score import score_videos
from kinebench_drake.runs.config import ScoreConfig
if __name__ == "__main__":
    source, out, jobs = sys.argv[1:]
    score_videos(ScoreConfig(source=Path(source), out=Path(out), jobs=int(jobs), make_resources=FakeTools))
"""


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_run_killed_by_sigkill_and_resumed_has_the_files_of_an_uninterrupted_run(film, config, tmp_path, log, jobs):
    for k in range(5):
        film(f"videos/v{k}.mp4", Act.SLOW)
    score_videos(config(out=tmp_path / "whole", jobs=int(jobs)))
    script = tmp_path / "run.py"
    script.write_text(RUN)
    out = tmp_path / "killed"
    command = [sys.executable, str(script), str(tmp_path / "videos"), str(out), jobs]
    log.write_text("")
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while len(read_rows(out) if out.is_dir() else {}) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    time.sleep(random.uniform(0.0, 0.2))  # any moment of a sample's work
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = read_rows(out)
    assert 2 <= len(done) < 5
    with (out / "samples.jsonl").open("a") as file:
        file.write('{"id": "v4", "sta')  # as if it had been writing
    time.sleep(1.0)  # orphaned workers end
    log.write_text("")
    score_videos(config(out=out, jobs=int(jobs)))
    assert len(log.read_text().splitlines()) == 5 - len(done)
    assert content(out) == content(tmp_path / "whole")


def test_an_implausible_frame_period_warns_of_wrong_units(film, config, tmp_path):
    film("videos/a.mp4")
    ear = Ear()
    score_videos(config(frame_period_s=200.0), ear)
    assert "in milliseconds (then write 0.2) or in frames per second (then write 0.005)" in ear.warnings[0]
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text(json.dumps({"video": "a.mp4", "frame_period_s": 17}))
    for period_s, source, warned in ((None, manifest, True), (0.2, tmp_path / "videos", False)):
        ear = Ear()
        score_videos(config(source=source, frame_period_s=period_s, out=tmp_path / f"out-{source.name}"), ear)
        assert any("17 s between two frames" in warning for warning in ear.warnings) is warned


def test_an_unread_manifest_in_a_source_folder_warns_which_fields_are_unused(film, config, tmp_path):
    film("videos/a.mp4")
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text(json.dumps({"video": "a.mp4", "task": "t", "model": "m", "frame_period_s": 0.2}))
    ear = Ear()
    score_videos(config(), ear)
    ignored, assumed = ear.warnings
    assert "the arm confirms one that is known by name" in assumed
    assert [ignored] == [
        f"{manifest} ignored: its tasks, models and frame periods are unused (1 / fps is used unless $frame_period_s "
        "is given); score the manifest itself to use them"
    ]


def test_files_written_by_an_earlier_run_are_not_scored(film, config, tmp_path):
    """Clips inside the output folder are scored, what the first run drew of them is not."""
    film("out/clips/a.mp4")
    first = score_videos(config(source=tmp_path / "out" / "clips", overlay=True))
    assert (tmp_path / "out" / "overlays" / "a.mp4").is_file()
    second = score_videos(config(source=tmp_path / "out", out=tmp_path / "other"))
    assert [row.id for row in second.rows] == [row.id for row in first.rows] == ["a"]


def test_a_dry_run_lists_samples_and_writes_nothing(film, program, tmp_path):
    film("videos/a.mp4", fps=10)
    (tmp_path / "videos" / "b.mp4").write_text("text")
    film("videos/c.mp4")
    code, out, _ = program("score", tmp_path / "videos", "--out", tmp_path / "out", "--dry-run", "--limit", 2)
    a, b, *totals = out.splitlines()
    period = "frame period: 0.1 s, 1 / fps of the file"
    camera = "camera: one known by name where the arm confirms it, else estimated from the arm"
    assert a == f"a: 8 frames of 96 x 96 px; {period}; {camera}"
    assert b.startswith("b: b.mp4: ")
    assert totals == ["1 of 2 samples can be read; nothing was measured or written", period, camera]
    assert code == 0
    assert not (tmp_path / "out").exists()


def test_labels_reach_the_terminal_as_one_printable_line_of_bounded_length(film, program, tmp_path):
    film("videos/a.mp4")
    film("videos/b.mp4")
    labels = {"model": "\x1b[31mred\n\u202e\x07" + "x" * 100_000, "task": "\ud800"}
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text("".join(json.dumps({"video": f"{name}.mp4", **labels}) + "\n" for name in "ab"))
    for arguments in (("--dry-run",), ()):
        _, out, err = program("score", manifest, "--out", tmp_path / "out", *arguments)
        assert all(line.isprintable() and len(line) <= 1000 for line in (out + err).splitlines())


def test_replays_that_could_not_be_written_are_made_up_on_the_next_run(film, config, monkeypatch):
    film("videos/a.mp4")
    written = []

    def full(out, ids, plant):
        raise SetupError("cannot write a.html (No space left on device)")

    monkeypatch.setattr(replay, "write_replays", full)
    with pytest.raises(SetupError):
        score_videos(config(replays=3))
    monkeypatch.setattr(replay, "write_replays", lambda out, ids, plant: written.extend(ids))
    score_videos(config(replays=3))
    assert written == ["a"]


def test_a_dry_run_counts_frames_after_resampling(film, program, tmp_path):
    film("videos/a.mp4", fps=10)
    code, out, _ = program("score", tmp_path / "videos", "--out", tmp_path / "out", "--dry-run", "--task-duration", 0.8)
    assert code == 0
    assert out.startswith("a: 5 frames of 96 x 96 px; frame period: 0.2 s")


@pytest.mark.parametrize("command", ["score", "audit"])
def test_a_source_path_too_long_for_the_disk_is_a_usage_error(program, tmp_path, command):
    code, _, err = program(command, tmp_path / ("x" * 300), "--out", tmp_path / "out")
    assert code == 2
    assert "File name too long" in err


def test_first_frames_of_pending_rounds_are_not_scored_as_a_video(film, program, tmp_path):
    film("run/videos/a_r0.mp4", fps=10)
    for name in ("run/samples.jsonl", "run/results.json"):
        (tmp_path / name).write_text("")
    for k in range(2):
        film(f"run/ask/{k}.png")
    _, out, _ = program("score", tmp_path / "run", "--out", tmp_path / "out", "--dry-run")
    assert "ask" not in out


def test_an_empty_path_is_refused_and_not_taken_as_the_current_folder(film, program, tmp_path, monkeypatch):
    film("videos/a.mp4")
    monkeypatch.chdir(tmp_path / "videos")
    for arguments in (("score", "", "--out", "out"), ("score", ".", "--out", ""), ("audit", "", "--out", "out")):
        code, _, err = program(*arguments)
        assert code == 2
        assert "the path is empty" in err
    assert [path.name for path in Path().iterdir()] == ["a.mp4"]


def test_a_seed_beyond_64_bit_is_refused_before_the_run(film, program, tmp_path):
    film("videos/a.mp4")
    out = ("--out", tmp_path / "out", "--seed")
    assert program("score", tmp_path / "videos", *out, 2**63)[0] == 2
    assert not (tmp_path / "out").exists()
    assert [program("score", tmp_path / "videos", *out, 2**63 - 1)[0] for _ in range(2)] == [0, 0]


def test_a_failed_run_leaves_no_empty_folder(film, config, tmp_path):
    film("videos/a.mp4", Act.RAISE)
    score_videos(config())
    with pytest.raises(UsageError):
        score_videos(config(source=film("others/b.mp4").parent, out=tmp_path / "out"))
    assert [p for p in (tmp_path / "out").iterdir() if p.is_dir()] == []


class ArmGrounder(FakeGrounder):
    """Sees the arm with another gripper."""

    def result(self, result):
        return replace(result, domain=Domain.ARM, gripper=GripperKind.ROBOTIQ_2F85)


class ArmTools(FakeTools):
    make_grounder = ArmGrounder


def test_an_arm_without_gripper_is_reported_with_the_gripper_of_the_configuration(film, config, tmp_path):
    film("videos/a.mp4")
    score_videos(config(make_resources=ArmTools))
    (row,) = read_rows(tmp_path / "out").values()
    assert (row.extra["domain"], row.extra["gripper"]) == ("arm_alone", "robotiq-2f85")
    with pytest.raises(UsageError, match="gripper is 'claw', expected 'franka'"):
        config(gripper="claw")
