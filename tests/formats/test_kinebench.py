"""Runs and data set of KineBench: what is read is what its evaluator wrote."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kinebench_drake.formats.kinebench import read_rows
from kinebench_drake.formats.trajectories.reading import TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.runs.score import compare_extractors
from kinebench_drake.suites.report.suite_page import write_suite_report
from kinebench_drake.track import GripperTrack

FRAMES = 5
POSE7 = [[0.4, 0.0, 0.3 + 0.01 * k, 0.0, 1.0, 0.0, 0.0] for k in range(FRAMES)]
"""Poses of the CAD: it looks down."""


def write_episode(folder: Path, *, success: bool, videos: int = 2) -> None:
    meta = {"pose7": [POSE7], "eef_z_offset": 0.12, "eef_offset_frame": "local"}
    rollouts = []
    for k in range(2):
        attempt = folder / f"attempt_{k:03d}"
        attempt.mkdir(parents=True)
        if k < videos:
            (attempt / "generated.mp4").write_bytes(b"x")
            (attempt / "rollout.mp4").write_bytes(b"x")
        rollouts.append({"attempt_dir": attempt.name, "success": success and k == 1, "action_meta": meta})
    info = {"env_id": "CloseBox-v1", "episode": 3, "prompt": "Close it.", "success": success, "num_rollouts": 2}
    (folder / "info.json").write_text(json.dumps({**info, "rollouts": rollouts}))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "outputs" / "wan_20260101_120000"
    write_episode(folder / "CloseBox-v1" / "0003", success=True)
    write_episode(folder / "CloseBox-v1" / "0004", success=False, videos=1)
    (folder / "PullCube-v1").mkdir()
    (folder / "PullCube-v1" / "summary.csv").write_text("episode,done,success,error\n0,True,True,\n1,True,False,late\n")
    return folder


def test_each_attempt_is_a_sample_with_the_labels_and_executed_poses_of_its_run(run: Path) -> None:
    samples = find_samples(run.parent).samples
    assert [s.id for s in samples] == [f"CloseBox-v1-000{k}-attempt_00{a}" for k in (3, 4) for a in (0, 1)]
    assert [s.success for s in samples] == [False, True, False, False]
    assert {(s.task, s.model, s.prompt, s.dataset_period_s) for s in samples} == {
        ("CloseBox-v1", "wan", "Close it.", 0.2)
    }
    assert [s.problem is None for s in samples] == [True, True, True, False]
    X_BG = samples[0].reference_X_BG
    assert X_BG is not None
    assert np.allclose(X_BG[:, :3, 3], [[0.4, 0.0, 0.18 + 0.01 * k] for k in range(FRAMES)])  # 0.12 m further down


def test_the_data_set_has_a_sample_per_case(tmp_path: Path) -> None:
    for case in ("close_box_61", "open_box_easy_v2_7", "pickfruits_12"):
        video = tmp_path / "suite0/videos/videos" / case / "observation.images.base_camera.mp4"
        video.parent.mkdir(parents=True)
        video.write_bytes(b"x")
    samples = find_samples(tmp_path).samples
    assert [(s.id, s.task, s.seed) for s in samples] == [
        ("close_box_61", "CloseBox-v1", 61),
        ("open_box_easy_v2_7", "OpenBoxEasy-v2", 7),
        ("pickfruits_12", "PickFruits-v1", 12),
    ]


def test_the_suite_report_counts_the_successes_of_a_run(run: Path, tmp_path: Path) -> None:
    assert [(r.id, r.success, r.reason) for r in read_rows(run)] == [
        ("CloseBox-v1-0003", True, None),
        ("CloseBox-v1-0003", False, None),
        ("PullCube-v1-0000", True, None),
        ("PullCube-v1-0001", False, "late"),
    ]
    page = write_suite_report([run], tmp_path / "report").read_text()
    assert "Suite 0 (kinebench)" in page


def test_executed_commands_are_read_as_poses_of_the_tcp(tmp_path: Path) -> None:
    euler = np.array([[3.0, 0.1 * k, 0.2] for k in range(FRAMES)])
    p = np.array(POSE7)[:, :3]
    actions = np.column_stack([p, euler, [1, 1, 1, -1, -1]])
    with h5py.File(tmp_path / "trajectory.h5", "w") as file:
        file.attrs.update({"format": "kinebench_rollout_v1", "env_id": "CloseBox-v1", "prompt": "Close it."})
        file["traj_0/actions"] = actions[None]
        file["traj_0/generated_frames"] = np.zeros((1, 3, FRAMES, 8, 8))
    (sample,) = find_trajectories(tmp_path, TrajectoryOptions())
    assert (sample.task, sample.prompt) == ("CloseBox-v1", "Close it.")
    trajectory = read_trajectory(sample, TrajectoryOptions())
    assert trajectory.X_BG is not None
    assert np.allclose(trajectory.X_BG[:, :3, 3], p)
    assert np.allclose(trajectory.X_BG[:, :3, :3], Rotation.from_euler("XYZ", euler).as_matrix())
    assert trajectory.finger_width_m.tolist() == [0.08, 0.08, 0.08, 0.0, 0.0]
    assert np.allclose(np.diff(trajectory.t_s), 0.2)


def test_agreement_of_extractors_is_measured_over_the_frames_that_both_have() -> None:
    X_BG = np.tile(np.eye(4), (4, 1, 1))
    lost = np.full((4, 4), np.nan)
    track = GripperTrack(
        t_s=0.2 * np.arange(4), X_CH=X_BG, X_BG=np.concatenate([X_BG[:3], [lost]]), confidence=np.ones(4),
        tracked=np.array([True, True, True, False]), finger_width_m=np.zeros(4),
    )  # fmt: skip
    reference = X_BG.copy()
    reference[:, 0, 3] = 0.01
    reference[1, :3, :3] = Rotation.from_rotvec([0, 0, 0.3]).as_matrix()
    reference[2] = lost
    assert compare_extractors(track, reference) == pytest.approx(
        {
            "reference_share": 0.5,
            "reference_position_m": 0.01,
            "reference_position_p95_m": 0.01,
            "reference_rotation_rad": 0.15,
        }
    )
    assert set(compare_extractors(track, reference[:3]).values()) == {None}
    assert compare_extractors(track, np.tile(lost, (4, 1, 1)))["reference_position_m"] is None
    assert compare_extractors(track, None) == {}
