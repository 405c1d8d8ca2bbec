"""Actions from tracks: what LeRobot and RoboWM-Bench get is what was tracked, and what was not is marked."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.geometry import make_pose
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.runs.action_export import require_own_folder, write_actions
from kinebench_drake.runs.config import ActionFileFormat, RunKind, ScoreConfig
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.runs.score import score_videos
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack
from tests.rows import make_row

FRAMES = 6
LOST = 2
"""Frames of a video, and the one that is not tracked."""
Q = np.linspace(0.0, 0.5, FRAMES)[:, None] * np.ones(7)
WIDTH = np.linspace(0.08, 0.03, FRAMES)


def poses() -> np.ndarray:
    X_BG = np.tile(np.eye(4), (FRAMES, 1, 1))
    X_BG[:, :3, :3] = Rotation.from_euler("xyz", np.linspace([3.1, 0, 0], [3.0, 0.2, 0.5], FRAMES)).as_matrix()
    X_BG[:, 0, 3] = np.linspace(0.4, 0.5, FRAMES)
    return X_BG


def row(sample: VideoSample) -> SampleRow:
    return make_row(
        id=sample.id, video=sample.video, task=None, model=None, status=Status.OK, reason=None, content_hash=""
    )


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Output folder with the tracks of two videos; no gap between the pads is known of the second."""
    for name in ("a", "b"):
        write_video(tmp_path / "in" / f"{name}.mp4", [np.full((64, 96, 3), 30 * k, np.uint8) for k in range(FRAMES)], 5)
    tracked = np.arange(FRAMES) != LOST
    X_BG = np.where(tracked[:, None, None], poses(), np.nan)
    joints = JointTrack(
        t_s=0.2 * np.arange(FRAMES), q=np.where(tracked[:, None], Q, np.nan),
        status=tuple(IkStatus.OK if ok else IkStatus.NOT_TRACKED for ok in tracked),
        position_error_m=np.zeros(FRAMES), rotation_error_rad=np.zeros(FRAMES),
    )  # fmt: skip
    track = GripperTrack(
        t_s=0.2 * np.arange(FRAMES), X_CH=X_BG, X_BG=X_BG, tracked=tracked, confidence=np.full(FRAMES, 0.9),
        finger_width_m=WIDTH,
    )  # fmt: skip
    folder = tmp_path / "out"
    write_track(artifact_path(folder, "tracks", "a"), track, joints, {})
    write_track(artifact_path(folder, "tracks", "b"), replace(track, finger_width_m=0 * WIDTH + np.nan), joints, {})
    return folder


def export(format: ActionFileFormat, out: Path) -> tuple[Path, list[str]]:
    samples = find_samples(out.parent / "in").samples
    warnings: list[str] = []
    return write_actions(format, out, samples, [row(sample) for sample in samples], warnings.append), warnings


def test_actions_are_the_states_of_the_next_frame_and_lost_frames_are_marked(out: Path) -> None:
    folder, warnings = export(ActionFileFormat.LEROBOT, out)
    assert warnings == []
    table = pq.read_table(folder / "data/chunk-000/file-000.parquet").to_pydict()
    column = {name: np.array(values[:FRAMES]) for name, values in table.items()}
    assert column["usable"].tolist() == [True, False, False, True, True, False]
    assert column["gripper_known"].all()
    usable = column["usable"]
    assert np.allclose(column["action"][usable, :7], Q[1:][usable[:-1]])
    assert np.allclose(column["pose_action"][usable, :3], poses()[1:][usable[:-1], :3, 3])
    assert np.allclose(column["delta_action"][usable, :3], np.diff(poses()[:, :3, 3], axis=0)[usable[:-1]], atol=1e-6)
    turns = Rotation.from_rotvec(column["delta_action"][usable, 3:6]).as_matrix()
    assert np.allclose(turns @ poses()[:-1][usable[:-1], :3, :3], poses()[1:][usable[:-1], :3, :3], atol=1e-6)
    assert np.allclose(column["action"][:-1, 7], WIDTH[1:])
    assert np.allclose(column["observation.state"][LOST, :7], Q[LOST - 1])  # held
    assert column["confidence"][LOST] == 0.0
    assert not any(table["gripper_known"][FRAMES:])
    assert np.allclose(np.array(table["observation.state"][FRAMES:])[:, 7], 0.08)


def test_a_data_set_of_actions_is_read_back_as_videos_and_trajectories(out: Path) -> None:
    folder, _ = export(ActionFileFormat.LEROBOT, out)
    samples = find_samples(folder).samples
    assert len(samples) == 2
    assert read_video(samples[1].path, samples[1].part).frames.shape == (FRAMES, 64, 96, 3)


def test_robowm_gets_a_line_per_command_at_20_hz(out: Path) -> None:
    folder, _ = export(ActionFileFormat.ROBOWM, out)
    assert (folder / "file_indices.txt").read_text().split() == ["0", "1"]
    lines = [json.loads(line) for line in (folder / "0.json").read_text().splitlines()]
    assert len(lines) == 21  # one second
    assert np.allclose(np.array(lines)[::4, :7], Q, atol=1e-6)  # the lost frame lies between its neighbours
    assert np.allclose(np.array(lines)[::4, 7:], 0.5 * WIDTH[:, None], atol=1e-6)
    about = [json.loads(line) for line in (folder / "episodes.jsonl").read_text().splitlines()]
    assert about[0] == {"file": "0.json", "id": "a", "frames": FRAMES, "interpolated": 1, "gripper_unknown": 0}
    assert about[1]["gripper_unknown"] == FRAMES


def test_a_frame_rate_that_is_no_whole_number_is_refused(out: Path) -> None:
    path = artifact_path(out, "tracks", "a")
    with np.load(path) as archive:
        arrays = {**archive, "t_s": 0.15 * np.arange(FRAMES)}
    np.savez(path, **arrays)
    with pytest.raises(UsageError, match=r"a: 6\.667 frames per second .* give \$frame_period_s"):
        export(ActionFileFormat.LEROBOT, out)


def test_joints_follow_the_track_from_the_posture_in_which_arms_are_filmed() -> None:
    tools = Resources(RobotOptions())
    q = np.linspace([0.0, 0.39, 0.0, -1.96, 0.0, 2.36, 0.79], [0.3, 0.5, 0.1, -1.8, 0.1, 2.3, 0.9], FRAMES)
    X_BG = tools.plant.forward_path(q)
    tracked = np.arange(FRAMES) != LOST
    X_BG[LOST] = np.nan
    track = GripperTrack(
        t_s=0.2 * np.arange(FRAMES), X_CH=X_BG, X_BG=X_BG, tracked=tracked, confidence=np.ones(FRAMES),
        finger_width_m=WIDTH,
    )  # fmt: skip
    joints = tools.joints(track, 0.0)
    assert np.array_equal(joints.ok, tracked)
    assert np.nanmax(joints.position_error_m) < 1e-4
    assert np.abs(joints.q[tracked] - q[tracked]).max() < 0.3  # the elbow of another solution is over a radian away


def test_where_no_joints_follow_the_track_those_of_its_verdict_are_taken_with_the_table_of_its_sample() -> None:
    tools = Resources(RobotOptions())
    X_BG = np.stack([make_pose(np.diag([1.0, -1.0, -1.0]), [0.45 + 0.1 * k, 0.0, 0.05]) for k in range(FRAMES)])
    everywhere = np.ones(FRAMES, dtype=bool)
    track = GripperTrack(
        t_s=0.2 * np.arange(FRAMES), X_CH=X_BG, X_BG=X_BG, tracked=everywhere, confidence=np.ones(FRAMES),
        finger_width_m=WIDTH,
    )  # fmt: skip
    raised, low = (tools.joints(track, height_m) for height_m in (0.2, -0.5))
    assert raised.status == tools.judge(track, 0.2).joints.status
    assert low.status == tools.judge(track, -0.5).joints.status
    assert raised.status != low.status


@pytest.mark.parametrize("format", ActionFileFormat)
def test_a_folder_that_no_run_wrote_is_refused_and_kept(tmp_path, format):
    kept = tmp_path / format.folder / "mine.json"
    kept.parent.mkdir()
    kept.write_text("{}")
    with pytest.raises(UsageError, match="no run wrote it"):
        score_videos(ScoreConfig(source=tmp_path, out=tmp_path, kind=RunKind.GROUND, format=format))
    assert kept.is_file()
    for name in ("samples.jsonl", "run.json"):
        (tmp_path / name).write_text("")
    require_own_folder(format, tmp_path)  # of an earlier run
