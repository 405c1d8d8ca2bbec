"""What the next run into the same folder does: it keeps finished samples, and repeats what has changed."""

import json
from functools import partial

import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.results.metadata import Shard
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs import score
from kinebench_drake.runs.config import RunKind
from kinebench_drake.runs.score import score_videos
from tests.fakes.records import RunRecorder, content


def test_resume_skips_finished_samples_unless_inputs_or_options_changed(film, config, grounded, tmp_path):
    film("videos/a.mp4")
    film("videos/b.mp4", has_gripper=False)
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
    observer = RunRecorder()
    score_videos(config(frame_period_s=0.2, model="m"), observer)
    assert "1 earlier results are dropped: they are not among the 2 videos named now" in observer.warnings[0]
    assert set(read_rows(tmp_path / "out")) == {"a", "b"}
    assert not (tmp_path / "out" / "tracks" / "c.npz").exists()


def test_another_code_version_invalidates_stored_rows(film, grounded, monkeypatch):
    film("videos/a.mp4")
    assert [grounded(), grounded()] == [1, 0]
    monkeypatch.setattr(score, "VideoEvaluator", partial(score.VideoEvaluator, code="another version"))
    assert grounded() == 1


@pytest.mark.parametrize("part", [{"limit": 1}, {"shard": Shard(index=1, count=3)}])
def test_a_partial_run_keeps_other_rows_and_refuses_to_run_if_they_are_outdated(film, config, grounded, tmp_path, part):
    """`results.json` states one configuration, of all rows."""
    for name in ("a", "b"):
        film(f"videos/{name}.mp4")
    film("videos/c.mp4", raises=RuntimeError())
    score_videos(config(frame_period_s=0.2))
    assert grounded(frame_period_s=0.2, **part) == 0
    assert set(read_rows(tmp_path / "out")) == {"a", "b", "c"}  # the error, too: nothing has changed
    before = content(tmp_path / "out")
    film("videos/b.mp4", frames=9)
    for period_s in (0.2, 0.1):
        with pytest.raises(UsageError, match=r"1 of its 3 results would be lost \(such as 'b'\).*not among those"):
            score_videos(config(frame_period_s=period_s, **part))
        assert content(tmp_path / "out") == before
    assert grounded(frame_period_s=0.1) == 3
    rows = read_rows(tmp_path / "out").items()
    assert {id: row.frame_period_s for id, row in rows if row.status is Status.OK} == {"a": 0.1, "b": 0.1}


def test_an_output_folder_of_another_run_kind_is_refused_without_overwrite(film, config, tmp_path):
    film("videos/a.mp4")
    score_videos(config(kind=RunKind.GROUND))
    before = content(tmp_path / "out")
    with pytest.raises(UsageError, match=r"of kind ground, this one is of kind score; name another.*overwrite=True"):
        score_videos(config())
    assert content(tmp_path / "out") == before
    score_videos(config(overwrite=True))
    assert json.loads((tmp_path / "out" / "results.json").read_text())["kind"] == "score"


def test_an_output_folder_of_another_source_is_refused_without_overwrite(film, config, tmp_path):
    film("videos/a.mp4")
    film("others/b.mp4")
    score_videos(config())
    with pytest.raises(UsageError, match=r"of source .videos., this run is of .others.; name another folder"):
        score_videos(config(source=tmp_path / "others"))
    assert set(read_rows(tmp_path / "out")) == {"a"}
    score_videos(config(source=tmp_path / "others", overwrite=True))
    assert set(read_rows(tmp_path / "out")) == {"b"}


def test_results_and_report_are_rewritten_only_when_something_changed(film, config, tmp_path):
    out = tmp_path / "out"

    def written():
        return [(out / name).stat().st_mtime_ns for name in ("results.json", "report.html")]

    def rewrites(**changes):
        before = written()
        summaries.append(score_videos(config(**changes)))
        changed = [now != then for now, then in zip(written(), before, strict=True)]
        assert changed[0] == changed[1]
        return changed[0]

    film("videos/a.mp4")
    film("videos/b.mp4", feasible=False)
    (tmp_path / "videos" / "c.mp4").touch()  # an error, which is tried again and remains
    summaries = [score_videos(config())]
    first = content(out)
    assert not rewrites()
    assert summaries[1] == summaries[0]
    (out / "report.html").write_text("half a page")  # as if the run had been killed before it
    assert rewrites()
    assert content(out) == first
    (out / "replays").mkdir()
    (out / "replays" / "a.html").touch()  # as `view` writes one
    assert rewrites()
    assert "replays/a.html" in (out / "report.html").read_text()
    assert rewrites(seed=1)
    assert not rewrites(seed=1)
    assert summaries[-1].counts == summaries[0].counts


@pytest.mark.parametrize("kind", [RunKind.GROUND, RunKind.SCORE])
def test_repeating_a_finished_run_writes_no_file(film, config, tmp_path, kind):
    def times():
        return {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}

    film("videos/a.mp4")
    score_videos(config(kind=kind))
    before = times()
    score_videos(config(kind=kind))
    assert times() == before


def test_deleted_track_thumbnail_and_overlay_files_are_restored_byte_by_byte(film, config, tmp_path):
    film("videos/a.mp4")
    score_videos(config(overlay=True))
    files = [path for path in (tmp_path / "out").glob("*/a.*") if path.parent.name != "videos"]
    assert {path.parent.name for path in files} >= {"tracks", "thumbnails", "overlays"}
    before = content(tmp_path / "out")
    for path in files:
        path.unlink()
        score_videos(config(overlay=True))
        assert content(tmp_path / "out") == before


def test_error_rows_are_retried_by_the_next_run(film, config):
    path = film("videos/a.mp4")
    data = path.read_bytes()
    path.write_bytes(b"")
    assert score_videos(config()).counts[Status.ERROR] == 1
    path.write_bytes(data)
    assert score_videos(config()).counts[Status.OK] == 1


def test_files_written_by_an_earlier_run_are_not_scored(film, config, tmp_path):
    """Clips inside the output folder are scored, what the first run drew of them is not."""
    film("out/clips/a.mp4")
    first = score_videos(config(source=tmp_path / "out" / "clips", overlay=True))
    assert (tmp_path / "out" / "overlays" / "a.mp4").is_file()
    second = score_videos(config(source=tmp_path / "out", out=tmp_path / "other"))
    assert [row.id for row in second.rows] == [row.id for row in first.rows] == ["a"]
