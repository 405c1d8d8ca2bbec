"""The clock of a video: where the period between frames comes from, and what is warned about it."""

import html
import json

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import UsageError
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.inputs import input_lines, list_inputs
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.score import score_videos
from tests.fakes.records import RunRecorder


def frame_period(row):
    return row.frame_period_s, row.frame_period_source


def test_the_frame_period_is_that_of_option_manifest_file_or_benchmark_and_names_its_source(film, config, tmp_path):
    film("videos/a.mp4", fps=10)
    folder = tmp_path / "videos" / "still"
    folder.mkdir()
    for k in range(3):
        Image.fromarray(np.zeros((96, 96, 3), dtype=np.uint8)).save(folder / f"{k}.png")
    observer = RunRecorder()
    summary = score_videos(config(), observer)
    rows = read_rows(tmp_path / "out")
    lines = input_lines(summary.rows)
    assert lines == [
        "frame period: 0.1 s, 1 / fps of the file (1 x); 0.2 s, the benchmark's, by default (1 x)",
        "camera: the benchmark's",
        "look: familiar to the networks",
    ]
    page = html.unescape(summary.report.read_text())
    assert all(f'<p class="note">{line.capitalize()}</p>' in page for line in lines)
    assert json.loads((tmp_path / "out" / "results.json").read_text())["inputs"] == list_inputs(summary.rows)
    assert frame_period(rows["a"]) == (pytest.approx(0.1), "fps")
    assert frame_period(rows["still"]) == (0.2, "benchmark")
    assert any("$frame_period_s" in warning for warning in observer.warnings)
    score_videos(config(frame_period_s=0.5))
    assert frame_period(read_rows(tmp_path / "out")["a"]) == (0.5, "option")
    samples = [{"video": "a.mp4", "fps": 4, "frame_period_s": 0.25, "id": "a1"}]
    samples += [{"video": "a.mp4", "fps": 4, "id": "a2"}]
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text("\n".join(map(json.dumps, samples)))
    score_videos(config(source=manifest, out=tmp_path / "m"))
    rows = read_rows(tmp_path / "m")
    assert [frame_period(rows[i]) for i in ("a1", "a2")] == [(0.25, "manifest"), (0.25, "manifest_fps")]
    with np.load(tmp_path / "m" / "tracks" / "a1.npz") as track:
        assert track["t_s"] == pytest.approx(0.25 * np.arange(8))


def test_with_a_task_duration_long_videos_are_resampled_to_the_frame_period(film, config, tmp_path):
    film("videos/long.mp4", frames=20)
    film("videos/short.mp4", frames=4)
    depth = tmp_path / "depth"
    depth.mkdir()
    far_m = 1.0 + np.arange(20)
    for id, frames in (("long", 20), ("short", 4)):
        np.save(depth / f"{id}.npy", np.broadcast_to(far_m[:frames, None, None], (frames, 96, 96)))
    score_videos(config(task_duration_s=1.8, depth=str(depth), overlay=True))
    rows = read_rows(tmp_path / "out")
    for id, clip, frames, period in (("long", 20, 10, 0.2), ("short", 4, 4, 0.6)):
        row = rows[id]
        assert (row.clip_timing, row.clip_frames, row.frames) == ("uniform", clip, frames)
        assert frame_period(rows[id]) == (pytest.approx(period), "task_duration")
        with np.load(tmp_path / "out" / "tracks" / f"{id}.npz") as track:
            used = np.rint(np.linspace(0, clip - 1, frames)).astype(int)
            np.testing.assert_allclose(track["t_s"], used * 1.8 / (clip - 1))
            np.testing.assert_allclose(track["camera_from_hand"][:, 2, 3], far_m[used])
        assert len(read_video(tmp_path / "out" / "overlays" / f"{id}.mp4").frames) == frames
    assert json.loads((tmp_path / "out" / "results.json").read_text())["config"]["task_duration_s"] == 1.8
    score_videos(config(task_duration_s=9.6, frame_period_s=1.2, out=tmp_path / "other"))
    assert read_rows(tmp_path / "other")["long"].frames == 9


def test_task_durations_out_of_range_are_refused(config):
    with pytest.raises(UsageError, match=r"\$task_duration_s is nan, expected seconds from 0.0001 to 1000"):
        config(task_duration_s=float("nan"))


def test_an_implausible_frame_period_warns_of_wrong_units(film, config, tmp_path):
    film("videos/a.mp4")
    observer = RunRecorder()
    score_videos(config(frame_period_s=200.0), observer)
    assert "in milliseconds (then write 0.2) or in frames per second (then write 0.005)" in observer.warnings[0]
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text(json.dumps({"video": "a.mp4", "frame_period_s": 17}))
    for period_s, source, warned in ((None, manifest, True), (0.2, tmp_path / "videos", False)):
        observer = RunRecorder()
        score_videos(config(source=source, frame_period_s=period_s, out=tmp_path / f"out-{source.name}"), observer)
        assert any("17 s between two frames" in warning for warning in observer.warnings) is warned


def test_an_unread_manifest_in_a_source_folder_is_a_warning(film, config, tmp_path):
    film("videos/a.mp4")
    manifest = tmp_path / "videos" / "manifest.jsonl"
    manifest.write_text(json.dumps({"video": "a.mp4", "task": "t", "model": "m", "frame_period_s": 0.2}))
    observer = RunRecorder()
    score_videos(config(), observer)
    ignored, assumed = observer.warnings
    assert "the arm confirms one that is known by name" in assumed
    assert ignored == (
        f"{manifest} ignored, also the frame periods and cameras that it states; score the manifest itself to use them"
    )
