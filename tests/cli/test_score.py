"""Whole runs over tiny videos with the fakes: rows, files, jobs, parts of the samples."""

import json
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.results.metadata import Shard
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs import score
from kinebench_drake.runs.config import RunKind
from kinebench_drake.runs.evaluator import KINEMATIC_METRICS
from kinebench_drake.runs.score import VISUAL_METRICS, score_videos
from kinebench_drake.track import Domain
from tests.fakes.records import content
from tests.fakes.resources import fail_to_load


def test_every_kind_of_sample_becomes_a_row(film, config, tmp_path):
    film("videos/good.mp4")
    film("videos/bad.mp4", feasible=False, vanishes=True)
    film("videos/empty_room.mp4", has_gripper=False)
    film("videos/bug.mp4", raises=RuntimeError("the fake\nfell over"))
    film("videos/single.mp4", frames=1)
    film("videos/tiny.mp4", side=8)
    (tmp_path / "videos" / "zero.mp4").touch()
    (tmp_path / "videos" / "text.mp4").write_text("no film")
    cut = film("videos/cut.mp4")
    cut.write_bytes(cut.read_bytes()[:-600])
    summary = score_videos(config())
    rows = read_rows(tmp_path / "out")
    assert {id: (row.status.value, row.feasible) for id, row in rows.items()} == {
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
    assert rows["good"].null_reasons["ldlj"] == "the fake has none"
    assert rows["good"].details["table_height_m"] == 0.0
    for id in ("good", "bad"):  # what is null has a reason, what is not has none
        assert set(rows[id].null_reasons) == {name for name, value in rows[id].metrics.items() if value is None}
        assert all(rows[id].null_reasons.values())
    assert [(a.kind.value, a.frame_start, a.frame_end, a.severity) for a in rows["bad"].anomalies] == [
        ("vanish", 4, 5, 2.0)
    ]
    assert {p.stem for p in (tmp_path / "out" / "tracks").iterdir()} == {"good", "bad"}
    aggregates = json.loads((tmp_path / "out" / "results.json").read_text())["aggregates"]
    assert aggregates["feasible"]["n"] == 2
    assert aggregates["samples"] == {"total": 9, "ok": 2, "unmeasurable": 3, "error": 4}


def test_outputs_are_byte_equal_between_runs_and_for_any_number_of_jobs(film, config, tmp_path):
    for k in range(4):
        film(f"videos/v{k}.mp4", feasible=k != 2)
    score_videos(config(out=tmp_path / "a", overlay=True))
    score_videos(config(out=tmp_path / "b", overlay=True))
    first = content(tmp_path / "a")
    assert first == content(tmp_path / "b")
    assert len(first) == 4 * 3 + 4
    score_videos(config(out=tmp_path / "c", overlay=True, jobs=2))
    third = content(tmp_path / "c")
    unlike = {name for name in first if first[name] != third[name]}
    assert unlike <= {"results.json", "report.html"}  # they state the number of jobs
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
    for k in range(5):
        film(f"videos/v{k}.mp4", kills_worker=k in (1, 3))
    score_videos(config(jobs=2))
    rows = read_rows(tmp_path / "out")
    assert {id for id, row in rows.items() if row.status is Status.OK} == {"v0", "v2", "v4"}
    assert "SIGKILL" in rows["v1"].reason
    assert rows["v1"].status is rows["v3"].status is Status.ERROR


@pytest.mark.parametrize("jobs", [1, 2])
def test_resources_that_cannot_be_loaded_stop_the_run_before_any_row(film, config, tmp_path, jobs):
    film("videos/a.mp4")
    film("videos/b.mp4")
    with pytest.raises(SetupError, match="doctor"):
        score_videos(config(make_resources=fail_to_load, jobs=jobs))
    assert read_rows(tmp_path / "out") == {}


def test_a_sample_with_nan_in_its_video_part_still_has_a_hash_and_a_row(film, config, tmp_path, monkeypatch):
    """Whatever readers let through, the boundary of the sample holds."""
    film("videos/a.mp4", raises=RuntimeError())
    find = score.find_samples

    def find_broken(*arguments, **named):
        samples = find(*arguments, **named)
        (sample,) = samples.samples
        part = replace(sample.part, from_s=float("nan"), to_s=float("nan"))
        return replace(samples, samples=(replace(sample, part=part),))

    monkeypatch.setattr(score, "find_samples", find_broken)
    score_videos(config())
    (row,) = read_rows(tmp_path / "out").values()
    assert row.status is Status.ERROR
    assert len(row.content_hash) == 64


def test_an_arm_without_gripper_is_reported_with_the_gripper_of_the_configuration(film, config, tmp_path):
    film("videos/a.mp4", result={"domain": Domain.ARM, "gripper": GripperKind.ROBOTIQ_2F85})
    score_videos(config())
    (row,) = read_rows(tmp_path / "out").values()
    assert (row.domain, row.gripper) == ("arm_alone", "robotiq-2f85")
    with pytest.raises(UsageError, match="gripper is 'claw', expected 'franka'"):
        config(gripper="claw")
