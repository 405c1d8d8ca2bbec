from dataclasses import replace

import numpy as np

from kinebench_drake.camera import CameraSource, benchmark_camera
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.metrics.executable import reason_kind
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.preparation import with_camera_option
from kinebench_drake.runs.score import score_videos
from tests.fakes.behavior import Behavior

WIDE = np.zeros((12, 96, 160, 3), np.uint8)


def test_the_camera_option_replaces_the_camera_of_every_video(tmp_path):
    save_camera(replace(benchmark_camera(), fx=400.0), tmp_path / "mine.json")
    sample = VideoSample(id="a", path=tmp_path / "a.mp4", video="a.mp4")
    (changed,) = with_camera_option([sample], str(tmp_path / "mine.json"))
    assert changed.camera.fx == 400.0
    assert changed.camera_source is CameraSource.OPTION
    (insisted,) = with_camera_option([sample], "benchmark", mirrored=True)
    assert insisted.camera_source is CameraSource.OPTION
    assert insisted.mirrored


def test_without_a_base_frame_only_smoothness_and_anomalies_are_measured(config, tmp_path):
    np.save(tmp_path / "wide.npy", WIDE)
    score_videos(config(source=tmp_path / "wide.npy"))
    row = read_rows(tmp_path / "out")["wide"]
    assert row.status is Status.OK
    assert row.feasible is None
    assert row.null_reasons["feasible"] == row.base_frame_reason == row.null_reasons["ik_success_rate"]
    assert row.metrics["sparc"] is not None
    assert row.metrics.anomalies == ()
    assert row.executable is None
    assert row.executable_reasons == ("undecided",)
    assert row.camera_source == "none"
    assert row.trust.level == "unknown"
    with np.load(tmp_path / "out" / "tracks" / "wide.npz") as track:
        assert np.isnan(track["base_from_tcp"]).all()
        assert np.isfinite(track["camera_from_hand"]).all()


def test_anomalies_are_against_execution_without_a_base_frame_too(config, refusal, fakes, tmp_path):
    np.save(tmp_path / "wide.npy", WIDE)
    fakes.prepare(WIDE, Behavior(vanishes=True))
    score_videos(config(source=tmp_path / "wide.npy"))
    row = read_rows(tmp_path / "out")["wide"]
    assert row.base_frame_reason is not None
    assert row.executable is False
    assert list(map(reason_kind, row.executable_reasons)) == ["vanish", "undecided", "lost"]
    assert "no base frame" in refusal("view", tmp_path / "out", "wide")
    assert "kinebench-drake view OUT" not in (tmp_path / "out" / "report.html").read_text()


def test_camera_benchmark_makes_videos_of_another_aspect_ratio_unmeasurable(config, tmp_path):
    np.save(tmp_path / "wide.npy", WIDE)
    score_videos(config(source=tmp_path / "wide.npy", camera="benchmark"))
    row = read_rows(tmp_path / "out")["wide"]
    assert (row.status, row.camera_source) == (Status.UNMEASURABLE, "option")
    assert "aspect ratios differ" in row.reason
    assert "the model's first frame: save it as ID.png beside ID.mp4" in row.reason


def test_an_untrusted_sample_still_has_a_track_with_poses_and_an_overlay(film, config, tmp_path):
    film("videos/a.mp4", is_sure=False)
    score_videos(config(camera="benchmark", overlay=True))
    row = read_rows(tmp_path / "out")["a"]
    assert row.status is Status.UNMEASURABLE
    assert "trusted in 0" in row.reason
    assert row.executable is None
    assert (tmp_path / "out" / "overlays" / "a.mp4").is_file()
    with np.load(tmp_path / "out" / "tracks" / "a.npz") as track:
        assert np.isfinite(track["camera_from_hand"]).all()
        assert not track["tracked"].any()
