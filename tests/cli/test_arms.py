"""Small data sets in the layouts in which people record other arms than Franka's, audited by a plain command."""

import json

import numpy as np
import pytest

from kinebench_drake.cli import main
from kinebench_drake.formats.trajectories.reading import PERCENT, Reading
from kinebench_drake.formats.trajectories.trajectory import ColumnTable, NumberColumn
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import list_arms, load_robot
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.audit import AuditConfig, audit_trajectories
from tests.arm_sets import minimum_jerk, write_episodes

N = 60
INSTALLED = {str(arm["name"]) for arm in list_arms() if "missing" not in arm}
SO100 = ["shoulder_pan.pos", "shoulder_lift.pos", "elbow_flex.pos", "wrist_flex.pos", "wrist_roll.pos", "gripper.pos"]
KOCH = [f"main_{name.removesuffix('.pos')}" for name in SO100]
G1 = ("ShoulderPitch", "ShoulderRoll", "ShoulderYaw", "ElbowPitch", "ElbowRoll")
LAYOUTS = {
    "so100": ("so100", "so100_follower", SO100, "deg", {"angle": "deg"}),
    "koch": ("koch", "koch", KOCH, "deg", {"angle": "deg"}),
    "xarm": ("xarm7", "xarm7", [*(f"joint{k}.pos" for k in range(1, 8)), "gripper.pos"], "rad", {}),
    "ur5e": ("ur5e", "ur5e", [*(f"joint_{k}" for k in range(6)), "gripper"], "rad", {}),
    "widowx": ("wxai", "wxai", [*(f"joint_{k}" for k in range(6)), "left_carriage_joint"], "rad", {}),
    "g1": ("g1_left", None, [f"k{s}{n}" for s in ("Left", "Right") for n in G1], "rad", {}),
    "aloha": (
        "vx300s_left",
        None,
        [f"{s}_{n}" for s in ("left", "right")
         for n in ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate", "gripper")],
        "rad",
        {},
    ),
}  # fmt: skip
"""Arm, robot_type, names of the state, unit, and the reading that it needs, by data set."""


def write_dataset(folder, robot, robot_type, names, unit):
    """Write a LeRobot v2.1 data set with one slow episode about the rest posture; the rest of the state is 0.5."""
    q = robot.rest_q + 0.1 * np.sin(np.linspace(0.0, 3.0, N))[:, None] * np.linspace(0.5, 1.0, len(robot.joints))
    state = np.full((N, len(names)), 0.5)
    state[:, : q.shape[1]] = np.rad2deg(q) if unit == "deg" else q
    write_episodes(folder, robot_type, names, [state])
    return q


def audit(folder, out, **options):
    """Return the row of an audit."""
    audit_trajectories(AuditConfig(source=folder, out=out, replays=0, **options))
    [row] = read_rows(out).values()
    return row


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_public_data_sets_are_audited(tmp_path, layout):
    name, robot_type, names, unit, reading = LAYOUTS[layout]
    if name not in INSTALLED:
        pytest.skip(f"{name} is not installed")
    robot = load_robot(name)
    write_dataset(tmp_path / "set", robot, robot_type, names, unit)
    options = {} if robot_type else {"robot": name}
    if reading:
        asked = audit(tmp_path / "set", tmp_path / "asked", **options)
        assert "deg" in (asked.reason or str(asked.warnings))  # refused, and asked
        (tmp_path / "reading.json").write_text(json.dumps(reading))
        options["reading"] = tmp_path / "reading.json"
    row = audit(tmp_path / "set", tmp_path / "out", **options)
    assert row.status.value == "ok", row.reason
    assert not {violation.kind.value for violation in row.violations} & {"joint_limit", "velocity", "discontinuity"}
    assert json.loads((tmp_path / "out/results.json").read_text())["config"]["robot"] == name


def run_program(*arguments):
    """Run the program and return its exit status."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return stop.value.code


@pytest.mark.slow
@pytest.mark.parametrize("joints", [5, 6])
def test_the_gate_of_a_plain_command_holds_for_arms_of_five_and_six_joints(tmp_path, write_arm, capfd, joints):
    if joints == 5:
        robot = load_robot("so100")
        names = SO100[:5]
        options = ("--robot", "so100")
    else:
        urdf = write_arm(joints=6)
        robot = load_robot(urdf, "tool")
        names = [f"j{k}.pos" for k in range(1, 7)]
        options = ("--robot", urdf, "--tool", "tool")
    far = robot.rest_q + 0.1
    too_far = far.copy()
    too_far[2] = robot.limits.upper[2] + 0.3
    episodes = [minimum_jerk(robot.rest_q, end, 60 + 10 * k) for k, end in enumerate((far, too_far, far - 0.15))]
    write_episodes(tmp_path / "set", "so100" if joints == 5 else None, names, episodes)
    (tmp_path / "reading.json").write_text(json.dumps({"angle": "rad"}))
    options += ("--reading", tmp_path / "reading.json", "--fail-on", "joint_limit", "--sarif", tmp_path / "log.sarif")
    options += ("--write-kept", tmp_path / "kept", "--out", tmp_path / "out", "--replays", "1")
    assert run_program("audit", tmp_path / "set", *options) == 1
    assert "bound missed: joint_limit: 1 sample, such as set-episode_000001" in "".join(capfd.readouterr())
    kept = (tmp_path / "kept/meta/episodes.jsonl").read_text().splitlines()
    assert [json.loads(line)["length"] for line in kept] == [60, 80]
    [result] = json.loads((tmp_path / "log.sarif").read_text())["runs"][0]["results"]
    assert result["message"]["text"].startswith("set-episode_000001, frames ")
    assert (tmp_path / "out/replays/set-episode_000001.html").is_file()


def test_rows_and_report_say_what_five_joints_follow(tmp_path):
    robot = load_robot("so100")
    X = ArmPlant(robot).forward_path(minimum_jerk(robot.rest_q, robot.rest_q + 0.2, 40))
    np.savez(tmp_path / "poses.npz", t_s=np.arange(40) / 10.0, base_from_tcp=X)
    row = audit(tmp_path / "poses.npz", tmp_path / "out", robot="so100")
    assert row.followed is not None
    assert row.followed.startswith("position and the direction of one axis of the tool")
    assert row.followed in (tmp_path / "out/report.html").read_text()
    assert row.feasible is True


def test_a_robot_type_that_contradicts_the_option_gives_no_verdict(tmp_path):
    write_dataset(tmp_path / "set", load_robot("so100"), "so100", SO100, "rad")
    row = audit(tmp_path / "set", tmp_path / "out", robot="koch")
    assert row.feasible is None
    assert "names the robot so100, not koch" in row.null_reasons["feasible"]


def test_readings_know_percent_signs_widths_and_first_states(tmp_path):
    joints = ("a", "b", "c", "d", "e")
    values = np.vstack([[100.0, -100.0, 50.0, 0.0, 10.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 100.0]])
    columns = (NumberColumn(name="s", size=6), NumberColumn(name="d", size=5))
    data = {"s": values, "d": np.full((2, 5), 0.1)}
    table = ColumnTable(columns=columns, load=data.__getitem__, t_s=np.array([0.0, 0.1]), joints=joints)
    ends = {"range_min": 1024, "range_max": 3071.5}
    (tmp_path / "calibration.json").write_text(json.dumps(dict.fromkeys((*joints, "gripper"), ends)))
    keys = {"columns": ["s[0:5]"], "layout": "joints", "angle": PERCENT, "calibration": "calibration.json"}
    keys |= {"signs": [1, 1, -1, 1, 1], "width": "s[5]", "width_range": [0, 100]}
    (tmp_path / "reading.json").write_text(json.dumps(keys))
    raw = Reading.parse(tmp_path / "reading.json").apply(table)
    half = np.pi / 2
    np.testing.assert_allclose(raw.q[0], [half, -half, -0.5 * half, 0.0, 0.1 * half], atol=1e-12)
    np.testing.assert_allclose(raw.finger_width_m, [0.0, 0.08])
    deltas = Reading(columns=("d",), layout="joints", deltas=True, start="s[0:5]", angle="deg").apply(table)
    np.testing.assert_allclose(deltas.q, np.deg2rad(values[0, :5] + 0.1 * np.arange(2)[:, None]))
