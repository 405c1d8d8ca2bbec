"""Formats of demonstrations: their clips and ground truth, and their files read back and replayed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import ExecutorKind, create_executor
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.formats.lerobot.writer import CAMERA, STATE
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.reader import read_video
from kinebench_drake.suites.demo_config import FRAME_CHOICES, FormatKind, RenderOptions
from kinebench_drake.suites.demo_formats import LeRobot, VideoFolder, cut_clips, ground_truth
from kinebench_drake.suites.demos import make_demos
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, render_video
from kinebench_drake.suites.simulator import Simulator
from tests.films import decoded
from tests.suites.orders import FIRST, TASK, Recorder, an_order
from tests.suites.records import doubled, record_of

Filmed = tuple[Simulator, Rollout, RolloutVideo]
OPTIONS = RenderOptions(size=96)


def test_frame_choices_divide_the_192_control_steps_of_a_clip() -> None:
    assert {25, 49, 97, 193} <= set(FRAME_CHOICES)
    for frames in FRAME_CHOICES:
        shots = RenderOptions(frames=frames)
        assert shots.every * (frames - 1) == 192
        assert shots.frame_period_s * (frames - 1) == pytest.approx(9.6)
    with pytest.raises(UsageError, match="25, 33, 49"):
        RenderOptions(frames=50)


@pytest.mark.sapien
def test_ground_truth_object_poses_equal_those_of_the_scene(filmed: Filmed) -> None:
    _, rollout, video = filmed
    truth = ground_truth(rollout, video, OPTIONS)
    placements = rollout.episode.layout().placements
    for k, name in enumerate(truth["objects"]):
        assert np.allclose(truth["base_from_object"][0, k], placements[name].X_BM, atol=1e-3)
    assert np.allclose(truth["control_q"][-1], truth["q"][-1], atol=0.01)  # the servos have caught up
    assert truth["t_s"][-1] == pytest.approx(9.6)


@pytest.mark.sapien
def test_each_clip_begins_with_the_last_frame_of_its_predecessor(filmed: Filmed) -> None:
    simulator, rollout, _ = filmed
    long = doubled(rollout)
    clips = list(cut_clips(long, render_video(simulator, long.snapshots), OPTIONS))
    assert len(clips) == 2
    for clip, video in clips:
        assert len(clip.snapshots) == 49
        assert len(clip.controls) == 192
        assert ground_truth(clip, video, OPTIONS)["t_s"][0] == 0.0
    assert np.array_equal(clips[0][1].rgb[-1], clips[1][1].rgb[0])


@pytest.mark.sapien
def test_a_lerobot_dataset_round_trips_the_rollout(filmed: Filmed, tmp_path: Path) -> None:
    simulator, rollout, _ = filmed
    order = an_order(tmp_path, FormatKind.LEROBOT, 1, replace(OPTIONS, fps=5.0))
    form = LeRobot()
    both = [rollout, replace(rollout, episode=replace(rollout.episode, id="other"))]
    for one in both:
        form.write_part(tmp_path, simulator, one, order.options)
    files = form.finish(order, [record_of(one) for one in both])
    assert all(path.is_file() for path in files)
    info = json.loads((tmp_path / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, 98, 5)
    samples = find_trajectories(tmp_path, TrajectoryOptions())
    assert [sample.prompt for sample in samples] == [rollout.episode.prompt] * 2
    for sample in samples:
        track = read_trajectory(sample, TrajectoryOptions())
        assert track.q is not None
        assert np.allclose(track.q, [s.q for s in rollout.snapshots], atol=1e-6)
        assert np.allclose(track.t_s, 0.2 * np.arange(49))
        assert track.finger_width_m.max() == pytest.approx(0.08, abs=2e-3)
    episodes = pq.read_table(tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert [(e["dataset_from_index"], e["dataset_to_index"]) for e in episodes] == [(0, 49), (49, 98)]
    key = f"videos/{CAMERA}"
    spans = [(e[f"{key}/from_timestamp"], e[f"{key}/to_timestamp"]) for e in episodes]
    assert np.allclose(spans, [(0.0, 9.8), (9.8, 19.6)])
    times, pictures = decoded(files[-1])
    assert np.allclose(times, np.arange(98) / 5.0)
    assert np.array_equal(pictures[:49], pictures[49:])
    films = find_samples(tmp_path).samples
    assert [film.prompt for film in films] == [rollout.episode.prompt] * 2
    assert films[0].camera.to_json() == order.options.camera.to_json()
    for k, film in enumerate(films):
        assert film.dataset_period_s == pytest.approx(0.2)
        assert np.array_equal(read_video(film.path, film.part).frames, pictures[49 * k : 49 * (k + 1)])
    stats = json.loads((tmp_path / "meta" / "stats.json").read_text())
    assert set(stats) == set(info["features"])
    assert np.shape(stats[CAMERA]["mean"]) == (3, 1, 1)
    assert stats[STATE]["count"] == [98]


@pytest.mark.sapien
def test_a_video_folder_names_each_clip_with_its_caption(filmed: Filmed, tmp_path: Path) -> None:
    simulator, rollout, _ = filmed
    form = VideoFolder()
    record = record_of(rollout)
    order = an_order(tmp_path, FormatKind.MP4, 1)
    form.write_part(tmp_path, simulator, rollout, order.options)
    assert all(path.is_file() for path in form.part_files(tmp_path, record))
    form.finish(order, [record])
    [row] = [json.loads(line) for line in (tmp_path / "metadata.jsonl").read_text().splitlines()]
    assert (tmp_path / row["file_name"]).is_file()
    assert row["text"] == record.prompt
    with np.load(tmp_path / row["truth"]) as truth:
        assert len(truth["t_s"]) == row["frames"] == 49
        X_BG = truth["base_from_tcp"]
    inputs = find_samples(tmp_path / "manifest.jsonl")
    assert not inputs.warnings
    [sample] = inputs.samples
    assert sample.frame_period_s == 0.2
    assert sample.initial_state is not None
    assert np.allclose(sample.initial_state.X_BG, X_BG[0], atol=1e-6)
    assert sample.initial_state.finger_width_m == pytest.approx(0.08, abs=1e-6)
    assert load_camera(tmp_path / "camera.json").camera.to_json() == order.options.camera.to_json()


@pytest.mark.sapien
def test_the_manifest_states_the_robot_in_the_first_frame_of_each_clip(filmed: Filmed, tmp_path: Path) -> None:
    simulator, rollout, film = filmed
    long = doubled(rollout)
    form = VideoFolder()
    order = an_order(tmp_path, FormatKind.MP4, 1)
    form.write_part(tmp_path, simulator, long, order.options)
    form.finish(order, [record_of(long)])
    for k, sample in enumerate(find_samples(tmp_path / "manifest.jsonl").samples):
        assert sample.initial_state is not None
        assert np.allclose(sample.initial_state.X_BG, film.X_BG[[0, 48][k]], atol=1e-6)
    assert not np.allclose(film.X_BG[0], film.X_BG[48], atol=1e-3)


@pytest.mark.sapien
def test_demonstrations_of_a_run_are_joined_into_one_dataset(tmp_path: Path) -> None:
    order = an_order(tmp_path, FormatKind.LEROBOT, 1)
    make_demos(order, create_executor(ExecutorKind.LOCAL, 1), Recorder())
    assert not (tmp_path / ".parts").exists()
    [sample] = find_trajectories(tmp_path, TrajectoryOptions())
    track = read_trajectory(sample, TrajectoryOptions())
    with np.load(tmp_path / "truth" / f"{TASK}_s{FIRST}.npz") as truth:
        assert track.q is not None
        assert np.allclose(track.q, truth["q"], atol=1e-5)
