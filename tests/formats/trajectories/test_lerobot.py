"""LeRobot datasets of both layouts, and which of their columns are taken."""

import json

import numpy as np
import pytest
from pyarrow import parquet

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.trajectories.columns import complete
from kinebench_drake.formats.trajectories.reading import Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import ColumnTable, NumberColumn
from kinebench_drake.geometry import pose_difference, rotation_log
from tests.formats.trajectories.conftest import read_all

NUMBERED = [f"joint_{j}" for j in range(7)]
STATE = {"observation.state": [*NUMBERED, "gripper"]}


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
        assert trajectory.columns == "observation.state[0:7]: joints"
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
    p = X_BG[:, :3, 3]
    R = X_BG[:, :3, :3]
    yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    pitch = -np.arcsin(R[:, 2, 0])
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
    assert found.columns == "tcp_pose: matrix_rows"


def table(**columns):
    described = []
    for name, names in columns.items():
        size, names = (names, ()) if isinstance(names, int) else (len(names), tuple(names))
        described.append(NumberColumn(name=name.replace("__", "."), size=size, names=names))
    return ColumnTable(columns=tuple(described), load={}.__getitem__, t_s=np.zeros(1))


@pytest.mark.parametrize(
    ("columns", "column", "layout"),
    [
        ({"observation__state": [f"panda_joint{j}" for j in range(1, 8)]}, "observation.state", "joints"),
        ({"observation__state": [f"joint_{j}.pos" for j in range(1, 8)]}, "observation.state", "joints"),
        ({"observation__state": [f"q{j}_rad" for j in range(1, 8)]}, "observation.state", "joints"),
        ({"observation__joint_positions": 7, "action": NUMBERED}, "observation.joint_positions", "joints"),
        ({"observation__qpos": 9}, "observation.qpos", "joints"),
        (
            {"observation__state": 8, "observation__states__joint_state": NUMBERED},
            "observation.states.joint_state",
            "joints",
        ),
        (
            {"observation__ee": ["x", "y", "z", "roll", "pitch", "yaw"], "observation__state": NUMBERED},
            "observation.state",
            "joints",
        ),
        (
            {"observation__joint_velocities": NUMBERED, "ee_pose": ["x", "y", "z", "qx", "qy", "qz", "qw"]},
            "ee_pose",
            "quaternion_wxyz",
        ),
    ],
)
def test_columns_are_recognized_by_their_names(columns, column, layout):
    found = complete(table(**columns), Reading())
    assert (found.columns[0].partition("[")[0], found.layout) == (column, layout)


@pytest.mark.parametrize("other", ["joint_vel.", "target_", "torque.", "error_"])
def test_elements_that_are_velocities_targets_or_errors_are_not_taken_as_joint_angles(other):
    names = [f"{other}joint_{k}" for k in range(7)]
    found = complete(table(observation__state=names, observation__q=NUMBERED), Reading())
    assert found.columns == ("observation.q",)


def test_nested_element_names_are_read(dataset, q):
    root = dataset({0: {"observation.state": with_gripper(q)}}, {"observation.state": 8})
    info = json.loads((root / "meta" / "info.json").read_text())
    info["features"]["observation.state"]["names"] = {"motors": [*NUMBERED, "gripper"]}
    (root / "meta" / "info.json").write_text(json.dumps(info))
    assert read_all(root)[1][0].columns == "observation.state[0:7]: joints"


def test_joints_are_ordered_by_their_numbers():
    found = complete(table(observation__state=["gripper", *reversed(NUMBERED)]), Reading())
    assert found.columns == tuple(f"observation.state[{k}]" for k in (7, 6, 5, 4, 3, 2, 1))


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
        {"observation__state": [f"joint_{j}.vel" for j in range(7)]},
        {"observation__state": NUMBERED[:6]},
    ],
)
def test_ambiguous_columns_are_refused_with_the_key_that_names_them(columns):
    with pytest.raises(InputError, match="no column is known") as caught:
        complete(table(**columns), Reading())
    assert "name some in $reading FILE; `kinebench-drake reading PATH` proposes them" in str(caught.value)
    for name in columns:
        assert name.replace("__", ".") in str(caught.value)


def test_one_of_two_arms_is_read_only_if_a_reading_names_it(dataset, q):
    names = [f"{side}_joint_{j}" for side in ("left", "right") for j in range(7)]
    root = dataset({0: {"observation.state": np.hstack([q, q + 0.1])}}, {"observation.state": names})
    with pytest.raises(UsageError, match=r'2 arms \(left, right\): .reading FILE with {"arm": "left"}'):
        find_trajectories(root, TrajectoryOptions())
    np.testing.assert_allclose(read_all(root, arm="right")[1][0].q, q + 0.1, atol=1e-6)


def test_readings_select_columns_and_unknown_columns_are_refused(dataset, q, X_BG, quaternion):
    pose = np.hstack([X_BG[:, :3, 3], quaternion])
    root = dataset({0: {"observation.state": q, "action": pose}}, {"observation.state": 7, "action": 7})
    with pytest.raises(UsageError, match=r"ds: no column is known.*observation.state \(7\); action \(7\)"):
        find_trajectories(root, TrajectoryOptions())
    _, (found,) = read_all(root, columns="observation.state", layout="joints")
    np.testing.assert_allclose(found.q, q, atol=1e-6)
    _, (found,) = read_all(root, columns="action", layout="quaternion_wxyz")
    assert max(d.max() for d in pose_difference(found.X_BG, X_BG)) < 1e-5
    with pytest.raises(UsageError, match=r"'nope' is no column and no number; found observation\.state"):
        read_all(root, columns="nope")
    with pytest.raises(UsageError, match='7 numbers per frame, expected "layout": one of joints, quaternion_wxyz'):
        read_all(root, columns="action")
    with pytest.raises(InputError, match="6 numbers per frame, quaternion_wxyz has 7"):
        read_all(dataset({0: {"a": q[:, :6]}}, {"a": 6}, folder="six"), columns="a", layout="quaternion_wxyz")


def test_joint_angles_and_euler_angles_in_degrees_are_refused(dataset, q, X_BG):
    with pytest.raises(InputError, match="look like degrees"):
        read_all(dataset({0: {"observation.state": with_gripper(np.rad2deg(q))}}, STATE))
    rows = np.hstack([X_BG[:, :3, 3], np.tile([180.0, 0.0, 45.0], (len(q), 1))])
    names = {"observation.state": ["x", "y", "z", "roll", "pitch", "yaw"]}
    with pytest.raises(InputError, match=r"up to 180 \(frame 0\).*degrees"):
        read_all(dataset({0: {"observation.state": rows}}, names, folder="rpy"))


def test_an_episode_without_rows_is_refused(dataset, q):
    root = dataset({0: {"observation.state": with_gripper(q)}}, STATE)
    path = root / "data" / "chunk-000" / "episode_000000.parquet"
    parquet.write_table(parquet.read_table(path)[:0], path)
    with pytest.raises(InputError, match=r"holds no frame of episode 0"):
        read_all(root)


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
        with pytest.raises(InputError, match=r"rows of different lengths|holds 0 numbers|reshape"):
            read_all(ragged)
    less = dataset({0: {"observation.state": q[:, :5]}}, STATE, folder="less")
    with pytest.raises(InputError, match="holds 5 numbers per frame, 8 are described"):
        read_all(less)


STATE_FEATURE = {"observation.state": {"dtype": "float32", "shape": [7], "names": NUMBERED}}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "cannot be read as JSON"),
        ("[]", "names no features"),
        (json.dumps({"codebase_version": "v1.6", "features": {}}), "version v1.6, expected v2.x or v3.x"),
        (json.dumps({"codebase_version": "v3.0", "features": {}}), "found no column of numbers"),
        (json.dumps({"codebase_version": "v3.0", "features": STATE_FEATURE}), "no episode"),
    ],
)
def test_an_unusable_info_json_is_a_usage_error_or_one_bad_sample_among_others(tmp_path, text, told):
    (tmp_path / "ds" / "meta").mkdir(parents=True)
    (tmp_path / "ds" / "meta" / "info.json").write_text(text)
    with pytest.raises(UsageError, match=told):
        find_trajectories(tmp_path / "ds", TrajectoryOptions())
    (sample,) = find_trajectories(tmp_path, TrajectoryOptions())  # beside others it is one bad sample
    assert sample.problem is not None
