"""Rows of runs over videos of other formats, sizes and clocks."""

import json

import av
import numpy as np
import pytest
from PIL import Image

from kinebench_drake.grounding.camera.framing import letterboxes
from kinebench_drake.io.container import join_videos, write_video
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.score import score_videos
from tests.films import encode
from tests.formats.videos.conftest import write_info, write_v3_episodes

KEY = "observation.images.front"


@pytest.fixture
def dataset(film, tmp_path):
    """A LeRobot dataset of two episodes in one film."""
    root = tmp_path / "videos"
    write_info(root, "v3.0", 10, {KEY: {"dtype": "video"}})
    write_v3_episodes(root, (KEY,), (8, 6), 10)
    parts = [film(f"part{k}.mp4", frames=n, fps=10) for k, n in enumerate((8, 6))]
    path = root / "videos" / KEY / "chunk-000" / "file-000.mp4"
    path.parent.mkdir(parents=True)
    join_videos(path, parts)
    return root


def test_each_episode_of_a_lerobot_dataset_is_a_row_with_its_prompt_camera_and_frame_period(dataset, config, tmp_path):
    summary = score_videos(config())
    assert summary.counts[Status.OK] == 2
    first, second = (read_rows(tmp_path / "out")[f"videos-episode_{k:06d}"] for k in (0, 1))
    assert (first.frames, second.frames) == (8, 6)
    assert (first.prompt, second.prompt) == ("task 0", "task 1")
    assert (first.camera_key, first.frame_period_source) == (KEY, "dataset")
    assert first.frame_period_s == pytest.approx(0.1)
    score_videos(config(frame_period_s=0.2, overwrite=True))
    row = read_rows(tmp_path / "out")["videos-episode_000000"]
    assert (row.frame_period_s, row.frame_period_source) == (0.2, "option")


def test_a_letterboxed_video_is_measured_without_its_bars(film, config, tmp_path):
    framing = letterboxes((384, 384), (208, 120))[0]
    rows, columns = framing.window
    images = np.zeros((4, 120, 208, 3), np.uint8)
    images[:, rows, columns] = 0
    images[:, rows, columns, 1:] = np.random.default_rng(0).integers(60, 200, (1, 15, 15, 2)).repeat(8, 1).repeat(8, 2)
    (tmp_path / "videos").mkdir()
    write_video(tmp_path / "videos" / "boxed.mp4", images, 17)
    write_video(tmp_path / "videos" / "wide.mp4", images[:, 20:100, 50:180], 17)
    score_videos(config(overlay=True))
    rows = read_rows(tmp_path / "out")
    assert rows["boxed"].status is Status.OK
    told = rows["boxed"]
    assert (told.width, told.height) == (208, 120)
    assert (told.framing["changes"], told.framing["source"]) == (["letterbox"], "bars")
    with av.open(tmp_path / "out" / "overlays" / "boxed.mp4") as overlay:
        assert overlay.streams.video[0].width == 120
    assert rows["wide"].feasible is None
    assert "the shape of the video" in rows["wide"].base_frame_reason


def test_another_first_frame_image_changes_the_content_hash(film, config, tmp_path):
    film("videos/a.mp4")
    (tmp_path / "videos" / "manifest.jsonl").write_text(
        json.dumps({"video": "a.mp4", "first_frame": "given.png"}) + "\n"
    )
    hashes = set()
    for level in (None, 10, 20):
        if level is not None:
            Image.fromarray(np.full((96, 96, 3), level, np.uint8)).save(tmp_path / "videos" / "given.png")
        score_videos(config(source=tmp_path / "videos" / "manifest.jsonl"))
        hashes.add(read_rows(tmp_path / "out")["a"].content_hash)
    assert len(hashes) == 3


def test_a_video_with_variable_frame_rate_is_timed_by_its_time_stamps(config, tmp_path):
    stamps = [0, 50, 100, 400, 450, 500, 900, 950]
    (tmp_path / "videos").mkdir()
    encode(tmp_path / "videos" / "a.mp4", np.zeros((8, 96, 96, 3), np.uint8), "libx264", "yuv420p", stamps=stamps)
    score_videos(config())
    row = read_rows(tmp_path / "out")["a"]
    assert (row.frame_period_source, row.frame_period_s) == ("time_stamps", pytest.approx(0.05, abs=2e-3))
    with np.load(tmp_path / "out" / "tracks" / "a.npz") as track:
        np.testing.assert_allclose(track["t_s"], np.array(stamps) / 1000.0, atol=2e-3)
    score_videos(config(frame_period_s=0.1, overwrite=True))
    with np.load(tmp_path / "out" / "tracks" / "a.npz") as track:
        np.testing.assert_allclose(track["t_s"], 0.1 * np.arange(8))
