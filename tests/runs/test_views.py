"""Tiled videos in a run: the view of options and manifests."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.grounding.panels.panel import Panel, PanelChoice, PanelKind, Rectangle
from kinebench_drake.io.container import write_video
from kinebench_drake.io.video import Video
from kinebench_drake.runs.preparation import filmed_pictures
from kinebench_drake.runs.score import score_videos


@pytest.fixture
def tiled(tmp_path):
    """A film of two pictures, of which the fake network sees the robot best in the left one."""
    rng = np.random.default_rng(0)
    noise = rng.integers(-12, 12, (8, 128, 192, 1)).repeat(3, axis=3) // 8
    film = np.full((8, 128, 192, 3), 60) + 70 * (np.arange(192) < 96)[:, None] + noise
    film[:, 30:60, 20:60] = 200
    film[:, 70:110, 110:130] = 180
    (tmp_path / "videos").mkdir()
    write_video(tmp_path / "videos" / "pair.mp4", film.astype(np.uint8), 10, crf=1)
    return tmp_path / "videos"


def rows(out):
    return [json.loads(line) for line in (out / "samples.jsonl").read_text().splitlines()]


@pytest.mark.parametrize(("view", "name", "left_px"), [("auto", "left", 0), ("2", "right", 96), ("right", "right", 96)])
def test_option_and_manifest_choose_the_same_panel(tiled, config, tmp_path, view, name, left_px):
    manifest = tiled / "manifest.jsonl"
    manifest.write_text(json.dumps({"video": "pair.mp4", "view": int(view) if view.isdecimal() else view}))
    score_videos(config(view=view, out=tmp_path / "option"))
    score_videos(config(source=manifest, out=tmp_path / "manifest"))
    (by_option,) = rows(tmp_path / "option")
    (by_manifest,) = rows(tmp_path / "manifest")
    assert by_option["view"] == by_manifest["view"] == name
    assert by_option["panels"] == by_manifest["panels"]
    assert (by_option["width"], by_option["height"]) == (96, 128)
    assert [p["left_px"] for p in by_option["panels"] if p["name"] == name] == [left_px]


def test_another_view_is_measured_anew(tiled, grounded):
    assert [grounded(view=view) for view in ("auto", "auto", "right", "auto")] == [1, 0, 1, 1]


def test_a_view_that_is_none_is_refused_and_in_a_manifest_an_error(tiled, config, refusal, tmp_path):
    line = refusal("score", tiled, "--out", tmp_path / "out", "--view", "behind")
    assert "--view is 'behind', expected auto, a number from 1 in reading order, or one of top, middle" in line
    entries = [{"video": "pair.mp4", "id": id, "view": view} for id, view in (("a", "behind"), ("b", 0), ("c", 7))]
    (tiled / "manifest.jsonl").write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    score_videos(config(source=tiled / "manifest.jsonl"))
    errors = {row["id"][0]: (row["status"], row["reason"]) for row in rows(tmp_path / "out")}
    assert {status for status, _ in errors.values()} == {"error"}
    assert "expected auto, a number from 1" in errors["a"][1]
    assert "--view 7: the frames have 2 panels, 1 or left (exterior), 2 or right (exterior)" in errors["c"][1]


def test_a_single_view_has_no_panel_beside_the_first(film, config, tmp_path):
    film("videos/a.mp4")
    score_videos(config(view="left"))
    (row,) = rows(tmp_path / "out")
    assert (row["status"], row["reason"][:12]) == ("error", "--view left:")
    score_videos(config(view="1", overwrite=True))
    (row,) = rows(tmp_path / "out")
    assert row["status"] == "ok"
    assert "view" not in row


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_first_picture_of_tiled_frames_is_cut_like_them_and_then_mirrored(tmp_path, mirrored):
    frames = np.random.default_rng(0).integers(0, 256, (3, 40, 60, 3), dtype=np.uint8)
    Image.fromarray(frames[0]).save(tmp_path / "first.png")
    path = Path("a.mp4")
    sample = VideoSample(id="a", path=path, video="a.mp4", mirrored=mirrored, first_frame=tmp_path / "first.png")
    rectangle = Rectangle(left=20, top=0, width=40, height=30)
    panel = Panel(rectangle=rectangle, kind=PanelKind.EXTERIOR, number=1, name=None)
    video, first = filmed_pictures(
        sample, Video(frames=frames, fps=None, stamps_s=None), PanelChoice(panels=(panel,), panel=panel)
    )
    expected = rectangle.crop(frames)[:, :, ::-1] if mirrored else rectangle.crop(frames)
    assert np.array_equal(video.frames, expected)
    assert np.array_equal(first, expected[0])
