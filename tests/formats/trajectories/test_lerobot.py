"""LeRobot datasets of both layouts, and which of their columns are taken."""

import json

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.trajectories.lerobot_columns import find_columns
from kinebench_drake.formats.trajectories.reading import Layout
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import TrajectoryOptions
from kinebench_drake.geometry import pose_difference, rotation_log

NUMBERED = [f"joint_{j}" for j in range(7)]
STATE = {"observation.state": [*NUMBERED, "gripper"]}


def read_all(path, **choice):
    chosen = TrajectoryOptions(**choice)
    samples = find_trajectories(path, chosen)
    return samples, [read_trajectory(s, chosen) for s in samples]


def with_gripper(q):
    return np.hstack([q, np.ones((len(q), 1))])


@pytest.mark.parametrize("version", ["v2.0", "v2.1", "v3.0"])
def test_every_episode_yields_its_joint_angles_prompt_and_times(dataset, q, version):
    episodes = {k: {"observation.state": with_gripper(q + 0.01 * k)} for k in (0, 3, 12)}
    samples, found = read_all(dataset(episodes, STATE, version=version))
    assert [s.id for s in samples] == ["ds-episode_000000", "ds-episode_000003", "ds-episode_000012"]
    assert [s.prompt for s in samples] == ["task 0", "task 3", "task 12"]
    for k, trajectory in zip(episodes, found, strict=True):
        np.testing.assert_allclose(trajectory.q, q + 0.01 * k, atol=1e-6)
        np.testing.assert_array_equal(trajectory.t_s, np.arange(len(q)) / 20.0)
        assert trajectory.columns == "observation.state[joint_0 .. joint_6]: joint angles"
        assert trajectory.warnings == ()
        assert np.isnan(trajectory.finger_width_m).all()  # what unit the gripper has is not said


def test_a_v3_dataset_without_episode_metadata_is_read(dataset, q):
    root = dataset({k: {"observation.state": with_gripper(q)} for k in (0, 1)}, STATE, version="v3.0", describe=False)
    samples, _ = read_all(root)
    assert [s.part for s in samples] == ["0", "1"]


def test_uneven_time_stamps_are_kept_unless_a_rate_is_set(dataset, q):
    stamps = np.cumsum(np.linspace(0.03, 0.07, len(q)))
    _, (found,) = read_all(dataset({0: {"observation.state": with_gripper(q)}}, STATE, stamps=stamps))
    np.testing.assert_allclose(found.t_s, stamps, atol=1e-6)
    _, (found,) = read_all(dataset({0: {"observation.state": with_gripper(q)}}, STATE, stamps=stamps), rate_hz=7.0)
    np.testing.assert_allclose(found.t_s, np.arange(len(q)) / 7.0)


def test_poses_are_read_in_every_rotation_layout(dataset, X_BG, quaternion):
    p, R = X_BG[:, :3, 3], X_BG[:, :3, :3]
    yaw, pitch = np.arctan2(R[:, 1, 0], R[:, 0, 0]), -np.arcsin(R[:, 2, 0])
    roll = np.arctan2(R[:, 2, 1], R[:, 2, 2])  # R = Rz(yaw) Ry(pitch) Rx(roll)
    layouts = {
        "wxyz": (["x", "y", "z", "qw", "qx", "qy", "qz"], np.hstack([p, quaternion])),
        "xyzw": (
            ["ee.pos.x", "ee.pos.y", "ee.pos.z", "ee.quat.x", "ee.quat.y", "ee.quat.z", "ee.quat.w"],
            np.hstack([p, quaternion[:, [1, 2, 3, 0]]]),
        ),
        "rw": (["x", "y", "z", "rx", "ry", "rz", "rw"], np.hstack([p, quaternion[:, [1, 2, 3, 0]]])),
        "rpy": (["x", "y", "z", "roll", "pitch", "yaw", "pad"], np.column_stack([p, roll, pitch, yaw, 0 * yaw])),
        "vector": (["x", "y", "z", "axis_angle1", "axis_angle2", "axis_angle3"], np.hstack([p, rotation_log(R)])),
        "shuffled": (
            ["yaw", "z", "roll", "x", "pitch", "y"],
            np.column_stack([yaw, p[:, 2], roll, p[:, 0], pitch, p[:, 1]]),
        ),
    }
    for name, (names, rows) in layouts.items():
        _, (found,) = read_all(dataset({0: {"observation.state": rows}}, {"observation.state": names}, folder=name))
        assert max(d.max() for d in pose_difference(found.X_BG, X_BG)) < 1e-5, name
    _, (found,) = read_all(dataset({0: {"tcp_pose": X_BG.reshape(-1, 16)}}, {"tcp_pose": 16}, folder="matrix"))
    assert max(d.max() for d in pose_difference(found.X_BG, X_BG)) < 1e-5
    assert found.columns == "tcp_pose[0:16]: 4x4 matrix by rows"


def features(**columns):
    told = {}
    for name, names in columns.items():
        size = names if isinstance(names, int) else len(names)
        given = None if isinstance(names, int) else names
        told[name.replace("__", ".")] = {"dtype": "float32", "shape": [size], "names": given}
    return told


@pytest.mark.parametrize(
    ("columns", "column", "layout"),
    [
        ({"observation__state": [f"panda_joint{j}" for j in range(1, 8)]}, "observation.state", Layout.JOINTS),
        ({"observation__state": [f"joint_{j}.pos" for j in range(1, 8)]}, "observation.state", Layout.JOINTS),
        ({"observation__state": [f"q{j}_rad" for j in range(1, 8)]}, "observation.state", Layout.JOINTS),
        ({"observation__joint_positions": 7, "action": NUMBERED}, "observation.joint_positions", Layout.JOINTS),
        ({"observation__qpos": 9}, "observation.qpos", Layout.JOINTS),
        (
            {"observation__state": 8, "observation__states__joint_state": NUMBERED},
            "observation.states.joint_state",
            Layout.JOINTS,
        ),
        (
            {"observation__ee": ["x", "y", "z", "roll", "pitch", "yaw"], "observation__state": NUMBERED},
            "observation.state",
            Layout.JOINTS,
        ),
        (
            {"observation__joint_velocities": NUMBERED, "ee_pose": ["x", "y", "z", "qx", "qy", "qz", "qw"]},
            "ee_pose",
            Layout.QUATERNION,
        ),
    ],
)
def test_columns_are_recognized_by_their_names(columns, column, layout):
    found = find_columns(features(**columns), TrajectoryOptions())
    assert (found.column, found.layout) == (column, layout)


@pytest.mark.parametrize("other", ["joint_vel.", "target_", "torque.", "error_"])
def test_elements_that_are_velocities_targets_or_errors_are_not_taken_as_joint_angles(other):
    names = [f"{other}joint_{k}" for k in range(7)]
    found = find_columns(features(observation__state=names, observation__q=NUMBERED), TrajectoryOptions())
    assert found.column == "observation.q"


def test_nested_element_names_are_read(q):
    feature = {"dtype": "float32", "shape": [8], "names": {"motors": [*NUMBERED, "gripper"]}}
    assert find_columns({"observation.state": feature}, TrajectoryOptions()).indices == tuple(range(7))


def test_joints_are_ordered_by_their_numbers():
    found = find_columns(features(observation__state=["gripper", *reversed(NUMBERED)]), TrajectoryOptions())
    assert found.indices == (7, 6, 5, 4, 3, 2, 1)


def test_finger_joints_and_widths_in_metres_become_the_finger_width(dataset, q):
    width = np.linspace(0.0, 0.08, len(q))[:, None]
    names = {
        "fingers": ([*NUMBERED, "panda_finger_joint1", "panda_finger_joint2"], np.hstack([q, width / 2, width / 2])),
        "finger": ([*NUMBERED, "panda_finger_joint1"], np.hstack([q, width / 2])),
        "width": ([*NUMBERED, "gripper_width_m"], np.hstack([q, width])),
    }
    for name, (elements, rows) in names.items():
        _, (found,) = read_all(dataset({0: {"observation.state": rows}}, {"observation.state": elements}, folder=name))
        np.testing.assert_allclose(found.finger_width_m, width[:, 0], atol=1e-7)


@pytest.mark.parametrize(
    "columns",
    [
        {"action": NUMBERED},  # what was commanded is not what was done
        {"observation__state": 7},
        {"observation__state": ["x", "y", "z", "rx", "ry", "rz"]},  # a rotation vector, or angles?
        {"observation__state": ["x", "y", "z", "rot_vec_0", "rot_vec_1", "rot_vec_2", "rot_vec_3"]},
        {"observation__state": ["shoulder_pan.pos", "shoulder_lift.pos", "elbow_flex.pos"]},
        {"observation__state": [f"{side}_joint_{j}" for side in ("left", "right") for j in range(7)]},
        {"observation__state": [f"joint_{j}.vel" for j in range(7)]},
        {"observation__state": NUMBERED[:6]},
    ],
)
def test_ambiguous_columns_are_refused_with_the_options_that_name_them(columns):
    with pytest.raises(InputError, match="no column is known") as caught:
        find_columns(features(**columns), TrajectoryOptions())
    assert "$joints COLUMN" in str(caught.value)
    for name in columns:
        assert name.replace("__", ".") in str(caught.value)


def test_options_select_columns_and_unknown_columns_are_refused(dataset, q, X_BG, quaternion):
    pose = np.hstack([X_BG[:, :3, 3], quaternion])
    root = dataset({0: {"observation.state": q, "action": pose}}, {"observation.state": 7, "action": 7})
    with pytest.raises(UsageError, match=r"ds: no column is known.*observation.state \(7\); action \(7\)"):
        find_trajectories(root, TrajectoryOptions())
    _, (found,) = read_all(root, joints="observation.state")
    np.testing.assert_allclose(found.q, q, atol=1e-6)
    _, (found,) = read_all(root, poses="action")
    assert max(d.max() for d in pose_difference(found.X_BG, X_BG)) < 1e-5
    assert "x y z qw qx qy qz is assumed" in found.warnings[0]
    with pytest.raises(UsageError, match=r"no column 'nope' of numbers; found observation\.state"):
        find_trajectories(root, TrajectoryOptions(joints="nope"))
    with pytest.raises(UsageError, match="expected x y z with"):
        find_trajectories(dataset({0: {"a": q[:, :6]}}, {"a": 6}, folder="six"), TrajectoryOptions(poses="a"))


def test_joint_angles_and_euler_angles_in_degrees_are_refused(dataset, q, X_BG):
    with pytest.raises(InputError, match="look like degrees"):
        read_all(dataset({0: {"observation.state": with_gripper(np.rad2deg(q))}}, STATE))
    rows = np.hstack([X_BG[:, :3, 3], np.tile([180.0, 0.0, 45.0], (len(q), 1))])
    names = {"observation.state": ["x", "y", "z", "roll", "pitch", "yaw"]}
    with pytest.raises(InputError, match=r"up to 180 \(frame 0\).*degrees"):
        read_all(dataset({0: {"observation.state": rows}}, names, folder="rpy"))


def test_unreadable_files_are_errors_of_their_episodes(dataset, q, tmp_path):
    root = dataset({0: {"observation.state": with_gripper(q)}, 1: {"observation.state": with_gripper(q)}}, STATE)
    (root / "data" / "chunk-000" / "episode_000001.parquet").write_bytes(b"PAR1 no")
    good, bad = find_trajectories(root, TrajectoryOptions())
    assert read_trajectory(good, TrajectoryOptions()).q is not None
    with pytest.raises(InputError, match=r"episode_000001\.parquet is not a readable parquet file") as caught:
        read_trajectory(bad, TrajectoryOptions())
    assert str(tmp_path) not in str(caught.value)
    gone = dataset({0: {"observation.state": with_gripper(q)}}, STATE, version="v3.0", folder="gone")
    (gone / "data" / "chunk-000" / "file-000.parquet").unlink()
    (sample,) = find_trajectories(gone, TrajectoryOptions())
    assert "there is no such file" in sample.problem
    for lengths in ((6, 8), (0,)):
        rows = [row[: lengths[k % len(lengths)]] for k, row in enumerate(with_gripper(q))]
        ragged = dataset({0: {"observation.qpos": rows}}, {"observation.qpos": 7}, folder=f"ragged{len(lengths)}")
        with pytest.raises(InputError, match=r"rows of different lengths|holds 0 numbers"):
            read_all(ragged)
    less = dataset({0: {"observation.state": q[:, :5]}}, STATE, folder="less")
    with pytest.raises(InputError, match=r"holds 5 numbers, less than meta/info\.json says"):
        read_all(less)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "names no features"),
        (json.dumps({"codebase_version": "v1.6", "features": {}}), "version v1.6, expected v2.x or v3.x"),
        (json.dumps({"codebase_version": "v3.0", "features": {}}), "found no column of numbers"),
        (json.dumps({"codebase_version": "v3.0", "features": features(observation__state=NUMBERED)}), "no episode"),
    ],
)
def test_an_unusable_info_json_is_a_usage_error_or_one_bad_sample_among_others(tmp_path, text, told):
    (tmp_path / "ds" / "meta").mkdir(parents=True)
    (tmp_path / "ds" / "meta" / "info.json").write_text(text)
    with pytest.raises(UsageError, match=told):
        find_trajectories(tmp_path / "ds", TrajectoryOptions())
    (sample,) = find_trajectories(tmp_path, TrajectoryOptions())  # beside others it is one bad sample
    assert sample.problem is not None
