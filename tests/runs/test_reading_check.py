"""Readings that fit far better than the names say: named, and without a verdict."""

import re

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.formats.trajectories.reading import TOOLS, Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import TrajectoryFormat, TrajectorySample
from kinebench_drake.geometry import invert, make_pose, rotation_z, to_quaternion
from kinebench_drake.runs.audit import judge_trajectory
from kinebench_drake.runs.reading_check import POSTURES, assess_path, assess_readings, doubt_frame, doubt_robot
from kinebench_drake.runs.resources import Resources, RobotOptions

T_S = 0.05 * np.arange(60)
S = np.linspace(0.0, 1.0, 60)[:, None]
DOWN = np.diag([1.0, -1.0, -1.0])
"""A gripper that points down and turns by 20 degrees while it approaches the table."""
X_BG = make_pose(
    np.stack([rotation_z(a) @ DOWN for a in np.deg2rad(20.0) * S[:, 0]]), [0.5, -0.1, 0.2] + S * [0.05, 0.2, -0.18]
)


@pytest.fixture(scope="module")
def tools():
    return Resources(RobotOptions())


def written(tmp_path, p=None, quaternion=None, t_s=T_S, X=X_BG):
    p = X[:, :3, 3] if p is None else p
    quaternion = to_quaternion(X[:, :3, :3]) if quaternion is None else quaternion
    path = tmp_path / "a.csv"
    np.savetxt(path, np.column_stack([t_s, p, quaternion]), delimiter=",", header="t_s,x,y,z,qw,qx,qy,qz", comments="")
    return path


CASES = {
    "quaternion_xyzw": ("layout", {"quaternion": to_quaternion(X_BG[:, :3, :3])[:, [1, 2, 3, 0]]}),
    "mm": ("length", {"p": 1e3 * X_BG[:, :3, 3]}),
    "ns": ("time_unit", {"t_s": 1e9 * T_S}),
    "flange": ("tool", {"X": X_BG @ invert(TOOLS["flange"])}),
}


@pytest.mark.parametrize("value", CASES)
def test_a_mistaken_convention_is_named_and_its_key_ends_the_doubt(tmp_path, tools, value):
    key, numbers = CASES[value]
    [sample] = find_trajectories(written(tmp_path, **numbers), TrajectoryOptions())
    assessment = assess_readings(tools, (sample,), TrajectoryOptions())
    assert getattr(assessment.best.reading, key) == value
    assert f'"{key}": "{value}"' in assessment.doubt
    choice = TrajectoryOptions(reading=Reading(**{key: value}))
    assert assess_readings(tools, (sample,), choice).doubt is None


@pytest.mark.parametrize(
    ("header", "proposed"),
    [
        ("t,n,a,b,c,d,e,f,g", list("abcdefg")),
        ("t,n," + ",".join(f"a{k}_vel" for k in range(7)), None),
        ("t,n,x,y,z,d,e,f,g", None),
    ],
)
def test_seven_columns_in_a_row_are_proposed_if_they_fit_and_say_nothing_else(tmp_path, header, proposed):
    """The proposal is complete: as a reading file it reads the same joint angles."""
    q = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8]) + 0.2 * np.sin(T_S)[:, None]
    path = tmp_path / "mine.csv"
    np.savetxt(path, np.column_stack([T_S, np.arange(60), q]), delimiter=",", header=header, comments="")
    if proposed is None:
        with pytest.raises(UsageError, match="no column is known to hold seven joint angles"):
            assess_path(path, RobotOptions())
        return
    printed = assess_path(path, RobotOptions()).to_json()
    assert printed["reading"] == {"columns": proposed, "layout": "joints", "time": "t"}
    choice = TrajectoryOptions(reading=Reading.parse(printed))
    [sample] = find_trajectories(path, choice)
    np.testing.assert_allclose(read_trajectory(sample, choice).q, q)


def test_a_right_file_is_not_doubted(tmp_path, tools):
    [sample] = find_trajectories(written(tmp_path), TrajectoryOptions())
    assert assess_readings(tools, (sample,), TrajectoryOptions()).doubt is None


@pytest.mark.parametrize(("name", "doubted"), [("xarm7", True), ("ur5", True), ("fr3", True), ("panda", False)])
def test_another_robot_than_the_panda_is_named_unless_the_reading_insists(tmp_path, name, doubted):
    sample = TrajectorySample(id="a", path=tmp_path, video="a", format=TrajectoryFormat.LEROBOT, robot=name)
    assert (doubt_robot(sample, TrajectoryOptions(), "panda") is not None) is doubted
    assert doubt_robot(sample, TrajectoryOptions(reading=Reading(robot="panda")), "panda") is None


READY = np.array(POSTURES["Franka's ready posture"])
Q = READY + 0.4 * S * [1.0, 0.5, -0.3, 0.6, 0.2, 0.3, -1.0]
"""A motion from the ready posture, within all limits."""
FINGERS = np.full((60, 2), 0.02)


def doubt_of(tmp_path, tools, *, reading=None, **arrays):
    """Return the doubt about an npz file."""
    path = tmp_path / f"{len([*tmp_path.iterdir()])}.npz"
    np.savez(path, t_s=T_S, **arrays)
    choice = TrajectoryOptions(reading=reading)
    [sample] = find_trajectories(path, choice)
    assessment = assess_readings(tools, (sample,), choice)
    return assessment and assessment.doubt


@pytest.mark.parametrize("numbers", [Q, np.hstack([Q, FINGERS])])
def test_right_angles_under_any_name_are_not_doubted(tmp_path, tools, numbers):
    assert doubt_of(tmp_path, tools, joint_positions=numbers) is None


@pytest.mark.parametrize("posture", POSTURES.values(), ids=POSTURES)
def test_offsets_from_a_default_posture_are_doubted_until_it_is_stated(tmp_path, tools, posture):
    assert "offset" in doubt_of(tmp_path, tools, joint_positions=Q - posture)
    stated = Reading(offset=posture)
    assert doubt_of(tmp_path, tools, joint_positions=Q - posture, reading=stated) is None


def test_fingers_before_the_arm_are_named_with_the_columns_that_end_the_doubt(tmp_path, tools):
    numbers = np.hstack([FINGERS, Q])
    assert "joint_positions[2:9]" in doubt_of(tmp_path, tools, joint_positions=numbers)
    stated = Reading(columns=("joint_positions[2:9]",), layout="joints")
    assert doubt_of(tmp_path, tools, joint_positions=numbers, reading=stated) is None


@pytest.mark.parametrize(
    ("numbers", "evidence"),
    [
        (Q[:, ::-1], r"joint \d is outside its limits in \d+% of the frames"),
        (np.hstack([Q[:, :6], (S > 0.5).astype(float)]), "like a gripper"),
    ],
    ids=["reversed", "six joints and a gripper"],
)
def test_numbers_that_do_not_fit_the_arm_have_no_verdict(tmp_path, tools, numbers, evidence):
    assert re.search(evidence, doubt_of(tmp_path, tools, joint_positions=numbers))


@pytest.mark.parametrize("numbers", [Q - READY, Q[:, ::-1]], ids=["offsets", "reversed"])
def test_documented_names_and_stated_columns_are_never_doubted(tmp_path, tools, numbers):
    assert doubt_of(tmp_path, tools, q=numbers) is None


def test_angles_that_agree_with_poses_of_the_same_file_are_not_doubted(tmp_path, tools):
    q = Q + 2.5 * (np.arange(7) == 3)  # joint 4 is over its limit throughout
    assert doubt_of(tmp_path, tools, joint_positions=q) is not None
    X_WG = make_pose(np.eye(3), [0.3, 0.0, 0.7]) @ tools.plant.forward_path(q)
    assert doubt_of(tmp_path, tools, joint_positions=q, tcp_pose=X_WG) is None


@pytest.mark.parametrize("reading", [None, Reading(tool="tcp"), Reading(tool="flange")])
def test_poses_whose_frame_decides_the_verdict_have_none_until_it_is_stated(tmp_path, tools, reading):
    choice = TrajectoryOptions(reading=reading)
    [sample] = find_trajectories(written(tmp_path), choice)
    result = judge_trajectory(tools, read_trajectory(sample, choice))
    doubt = doubt_frame(tools, sample, choice, result, lambda trajectory: judge_trajectory(tools, trajectory))
    if reading is None:
        assert re.search('"tool": "tcp".* feasible, .*"tool": "flange".* infeasible .table collision, -\\d+ mm', doubt)
    else:
        assert result.feasible is (reading.tool == "tcp")
        assert doubt is None
