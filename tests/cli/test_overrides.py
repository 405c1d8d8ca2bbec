"""Stages of the grounding replaced by files: whole runs with fake analyzer, whose track shows what it was given."""

import json
import sys

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.geometry import make_pose
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.score import score_videos

T = 8
SIDE = 96
MASK = np.zeros((T, SIDE, SIDE), dtype=bool)
MASK[:, :, :24] = True
DEPTH_MM = np.broadcast_to(600 + 10 * np.arange(T)[:, None, None], MASK.shape).astype(np.uint16)
X_CH = make_pose(np.diag([1.0, -1.0, -1.0]), [[0.02 * k, 0.1, 0.9] for k in range(T)])
CLASS = """
import numpy as np

class Wall:
    def depth(self, frames, camera):
        return np.full(frames.shape[:3], 0.77)
"""


@pytest.fixture
def folder(tmp_path):
    """A demonstration folder: the truth of a film a.mp4."""
    truth = tmp_path / "videos" / "truth"
    truth.mkdir(parents=True)
    np.savez(
        truth / "a.npz",
        camera_from_hand=X_CH,
        finger_width_m=np.full(T, 0.011),
        depth_mm=DEPTH_MM,
        mask=np.packbits(MASK, axis=-1),
    )
    return truth.parent


@pytest.fixture
def track(tmp_path):
    """What a run with these settings finds for the film a."""

    def run(config):
        score_videos(config)
        (row,) = read_rows(tmp_path / "out").values()
        assert row.status.value == "ok", row.reason
        with np.load(tmp_path / "out" / "tracks" / "a.npz") as arrays:
            return row, dict(arrays)

    return run


def test_files_of_masks_depth_and_poses_replace_their_grounding_stages(film, config, folder, track, tmp_path):
    film("videos/a.mp4")
    row, plain = track(config())
    assert row.replaced == {}
    row, masked = track(config(masks=folder))
    assert row.replaced == {"masks": "videos"}
    assert masked["confidence"] == pytest.approx(np.full(T, 0.25))
    assert masked["camera_from_hand"] == pytest.approx(plain["camera_from_hand"])
    _, deep = track(config(depth=str(folder)))
    assert deep["camera_from_hand"][:, 2, 3] == pytest.approx(0.6005 + 0.01 * np.arange(T))
    _, posed = track(config(poses=folder))
    assert posed["camera_from_hand"] == pytest.approx(X_CH)
    assert posed["finger_width_m"] == pytest.approx(np.full(T, 0.011))
    row, all_three = track(config(masks=folder, depth=str(folder), poses=folder))
    assert row.replaced == {"depth": "videos", "masks": "videos", "poses": "videos"}
    assert all_three["confidence"] == pytest.approx(masked["confidence"])
    told = json.loads((tmp_path / "out" / "results.json").read_text())["config"]
    assert (told["masks"], told["depth"], told["poses"], told["depth_exact"]) == ("videos", "videos", "videos", False)
    assert str(tmp_path) not in (tmp_path / "out" / "results.json").read_text()


def test_a_depth_class_from_the_current_folder_loads_in_workers_too(film, config, track, tmp_path, monkeypatch):
    (tmp_path / "wall_of_mine.py").write_text(CLASS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if p])  # as an installed program has it
    film("videos/a.mp4")
    for jobs in (1, 2):
        row, deep = track(config(depth="wall_of_mine:Wall", jobs=jobs, overwrite=True))
        assert row.replaced == {"depth": "wall_of_mine:Wall"}
        assert deep["camera_from_hand"][:, 2, 3] == pytest.approx(0.77)


def test_first_base_from_tcp_of_a_manifest_sets_the_first_pose(film, config, track, tmp_path):
    film("videos/a.mp4")
    manifest = tmp_path / "videos" / "manifest.jsonl"
    for X_BG in X_CH[:2]:  # another one is another input
        manifest.write_text(json.dumps({"video": "a.mp4", "first_base_from_tcp": X_BG.tolist()}))
        row, found = track(config(source=manifest))
        assert row.replaced == {"first_frame": "manifest"}
        assert found["base_from_tcp"][0] == pytest.approx(X_BG)


def test_a_mask_file_that_does_not_fit_its_video_is_an_error_of_that_sample(film, config, tmp_path):
    given = tmp_path / "given"
    given.mkdir()
    for name in ("fits", "short", "small", "none"):
        film(f"videos/{name}.mp4")
    np.save(given / "fits.npy", MASK)
    np.save(given / "short.npy", MASK[:-1])
    np.save(given / "small.npy", MASK[:, ::2])
    score_videos(config(masks=given))
    rows = read_rows(tmp_path / "out")
    assert {id: row.status.value for id, row in rows.items()} == {
        "fits": "ok", "short": "error", "small": "error", "none": "error"
    }  # fmt: skip
    assert rows["short"].reason == "mask given for the video: shape (7, 96, 96), expected (8, 96, 96)"
    assert "(8, 48, 96)" in rows["small"].reason
    assert "--masks: given has nothing" in rows["none"].reason
    assert "none.npz, none.npy, none/" in rows["none"].reason


def test_resume_skips_finished_samples_unless_override_files_changed(film, grounded, folder, tmp_path):
    film("videos/a.mp4")
    masks = tmp_path / "masks"
    masks.mkdir()
    np.save(masks / "a.npy", MASK)
    assert [grounded(), grounded(masks=masks), grounded(masks=masks)] == [1, 1, 0]
    np.save(masks / "a.npy", ~MASK)
    assert [grounded(masks=masks), grounded(masks=masks)] == [1, 0]
    assert [grounded(masks=folder), grounded(poses=folder), grounded(depth=str(folder))] == [1, 1, 1]
    assert [grounded(depth=str(folder), depth_exact=True), grounded()] == [1, 1]


def test_mask_images_inside_the_source_folder_are_not_scored_as_videos(film, config, track, tmp_path):
    film("videos/a.mp4")
    masks = tmp_path / "videos" / "masks"
    (masks / "a").mkdir(parents=True)
    for number, mask in enumerate(MASK):
        Image.fromarray(mask).save(masks / "a" / f"{number}.png")
    _, masked = track(config(masks=masks))
    assert masked["confidence"] == pytest.approx(np.full(T, 0.25))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--masks", "nowhere"), "--masks nowhere: there is no such folder"),
        (("--poses", "nowhere"), "--poses nowhere: there is no such folder"),
        (("--depth", "nowhere"), "expected a folder, module:Class or FILE.py:Class"),
        (("--depth", "no_such_module_at_all:Depth"), "no module 'no_such_module_at_all'"),
        (("--depth-exact",), "--depth-exact"),
    ],
)
def test_override_options_naming_missing_files_or_modules_end_with_status_2(refusal, film, tmp_path, options, told):
    film("videos/a.mp4")
    for command in ("score", "ground"):
        assert told in refusal(command, tmp_path / "videos", "--out", tmp_path / "out", *options)
    assert not (tmp_path / "out").exists()
