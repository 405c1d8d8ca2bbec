"""Two arms in a row: each judged, their collisions found, one row that says which arm."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.cli import main
from kinebench_drake.errors import UsageError
from kinebench_drake.kinematics.arm_pair import PairContact
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import list_arms, load_robot
from kinebench_drake.results.store import read_rows
from kinebench_drake.runs.audit import AuditConfig, audit_trajectories
from kinebench_drake.runs.two_arms import find_arm_collisions
from tests.arm_sets import minimum_jerk, write_episodes

N = 60
INSTALLED = {str(arm["name"]) for arm in list_arms() if "missing" not in arm}
BASES = {"left": [0.0, 0.35, 0.0], "right": [0.0, -0.35, 0.0]}
MOVE = np.array([0.3, 0.2, 0.1, 0.2, 0.1, 0.1, 0.1])
TOWARDS = np.array([-1.2, 0.6, 0.0, 0.9, 0.0, 0.0, 0.0])
MIRROR = np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
NAMES = {
    "g1": [f"k{side}{part}" for side in ("Left", "Right")
           for part in ("ShoulderPitch", "ShoulderRoll", "ShoulderYaw", "ElbowPitch", "ElbowRoll")],
    "g1_29": [f"k{side}{part}" for side in ("Left", "Right")
              for part in ("ShoulderPitch", "ShoulderRoll", "ShoulderYaw", "Elbow", "WristRoll", "WristPitch",
                           "Wristyaw")],
    "aloha": [f"{side}_{part}" for side in ("left", "right")
              for part in ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate", "gripper")],
}  # fmt: skip
TYPES = {"g1": "g1_23", "g1_29": "Unitree_G1", "aloha": "aloha"}


@pytest.fixture(scope="module")
def panda():
    return ArmPlant()


@pytest.fixture
def audit(tmp_path):
    def run(source, reading=None, **options):
        if reading is not None:
            (tmp_path / "reading.json").write_text(json.dumps(reading))
            options["reading"] = tmp_path / "reading.json"
        summary = audit_trajectories(AuditConfig(source=source, out=tmp_path / "out", **options))
        return summary, read_rows(tmp_path / "out")

    return run


def paths(panda, left, right):
    rest = panda.robot.rest_q
    return {
        "left_q": minimum_jerk(rest, rest + left, N),
        "right_q": minimum_jerk(rest, rest + right, N),
        "t_s": np.arange(N) / 20.0,
    }


@pytest.mark.slow
def test_each_arm_is_judged_and_collisions_between_them_have_their_own_reason(panda, audit, tmp_path):
    (tmp_path / "set").mkdir()
    faults = {
        "clean": (MOVE, MIRROR * MOVE),
        "fast": (MOVE, 9.0 * MIRROR * MOVE),
        "touch": (TOWARDS, MIRROR * TOWARDS),
    }
    for name, (left, right) in faults.items():
        np.savez(tmp_path / "set" / f"{name}.npz", **paths(panda, left, right))
    summary, rows = audit(tmp_path / "set", {"arms": BASES}, fail_on="self_collision", sarif=tmp_path / "log.sarif")
    assert rows["clean"].feasible is True
    assert rows["clean"].arms == ("left", "right")
    assert {*rows["clean"].details} == {"left", "right"}
    assert rows["clean"].metrics.number("executability") > rows["touch"].metrics.number("executability")
    assert {violation.arm for violation in rows["fast"].violations if violation.joint} == {"right"}
    [touch] = rows["touch"].violations
    assert touch.kind.value == "self_collision"
    assert touch.link.startswith("left_panda_")
    assert touch.body.startswith("right_panda_")
    assert touch.value < touch.limit == -0.002
    assert (touch.arm, touch.joint) == (None, None)
    assert summary.missed[0].startswith("self_collision: ")
    texts = [r["message"]["text"] for r in json.loads((tmp_path / "log.sarif").read_text())["runs"][0]["results"]]
    assert any(text.endswith(": self collision") for text in texts)
    assert any("right " in text for text in texts)
    assert "left and right, each as one arm" in (tmp_path / "out/report.html").read_text()
    with np.load(tmp_path / "out/tracks/clean.npz") as file:
        assert file["left_q"].shape == file["right_q"].shape == (N, 7)
    with pytest.raises(SystemExit):
        main(["view", str(tmp_path / "out"), "clean"])


def test_of_poses_contacts_of_the_tools_alone_are_certain(panda, audit, tmp_path):
    sides = paths(panda, TOWARDS, MIRROR * TOWARDS)
    poses = {key.replace("_q", "_base_from_tcp"): panda.forward_path(q) for key, q in sides.items() if "_q" in key}
    np.savez(tmp_path / "poses.npz", t_s=sides["t_s"], **poses)
    _, rows = audit(tmp_path / "poses.npz", {"arms": BASES})
    [touch] = [violation for violation in rows["poses"].violations if violation.kind.value == "self_collision"]
    assert {touch.link.removeprefix("left_panda_"), touch.body.removeprefix("right_panda_")} <= {
        "hand", "leftfinger", "rightfinger", "link7"
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_data_sets_of_two_arms_are_audited_by_their_robot_type(audit, tmp_path, name):
    if name not in INSTALLED:
        pytest.skip(f"{name} is not installed")
    arms = [load_robot(f"{ {'aloha': 'vx300s'}.get(name, name) }_{side}") for side in ("left", "right")]
    start = [robot.rest_q.copy() for robot in arms]
    start[0][0] += 0.4 if name == "aloha" else 0.0  # away from the other arm
    episodes = []
    for k, shift in enumerate((0.05, 0.1)):
        parts = [minimum_jerk(q, q + shift, N + k) for q in start]
        if name == "aloha":
            parts = [np.column_stack([part, np.full(N + k, 0.5)]) for part in parts]
        episodes.append(np.hstack(parts))
    episodes[1][:, 1] = minimum_jerk(arms[0].rest_q[1:2], arms[0].limits.upper[1:2] + 0.3, N + 1)[:, 0]
    write_episodes(tmp_path / "set", TYPES[name], NAMES[name], episodes)
    summary, rows = audit(tmp_path / "set", {"angle": "rad"}, write_kept=tmp_path / "kept", replays=0)
    first, second = rows.values()
    assert first.arms == second.arms == ("left", "right")
    assert not {violation.kind.value for violation in first.violations} & {"joint_limit", "velocity", "discontinuity"}
    assert ("joint_limit", "left") in [(violation.kind.value, violation.arm) for violation in second.violations]
    kept = (tmp_path / "kept/meta/episodes.jsonl").read_text().splitlines()
    dropped = {drop.id for drop in summary.drops if drop.reason.drops_all}
    assert [json.loads(line)["length"] for line in kept] == [N + k for k, id in enumerate(rows) if id not in dropped]


def test_one_arm_of_two_is_still_chosen_by_its_name(panda, audit, tmp_path):
    np.savez(tmp_path / "a.npz", **paths(panda, MOVE, MIRROR * MOVE))
    _, rows = audit(tmp_path / "a.npz", {"arm": "right"})
    assert rows["a"].arms is None
    assert rows["a"].columns.startswith("right_q")
    _, rows = audit(tmp_path / "a.npz", overwrite=True)  # neither arm in the place of the other
    assert '2 arms (left, right): --reading FILE with {"arm": "left"} chooses one' in rows["a"].reason


@pytest.mark.parametrize(
    ("arms", "reason"),
    [({"left": [0, 0, 0]}, "expected left and right"), ({"left": [0.0], "right": [0, 0, 0]}, "has 1 numbers")],
)
def test_arms_without_a_place_are_refused(panda, audit, tmp_path, arms, reason):
    np.savez(tmp_path / "a.npz", **paths(panda, MOVE, MIRROR * MOVE))
    with pytest.raises(UsageError, match=reason):
        audit(tmp_path / "a.npz", {"arms": arms})


class OpenFingers:
    """Pair of arms whose open fingers alone meet."""

    def contacts(self, q, finger_width_m, tolerance_m):
        is_open = np.nan_to_num(finger_width_m[0], nan=0.08) > 0.04
        depth = np.where(is_open, -0.01, np.nan)
        return [PairContact(links=("leftfinger", "hand"), of_tools=True, distance_m=depth)] if is_open.any() else []


@pytest.mark.parametrize(("gap_m", "count"), [(np.nan, 0), (0.08, 1), (0.0, 0)])
def test_fingers_of_an_unknown_gap_do_not_collide_by_being_open(gap_m, count):
    q = np.zeros((N, 7))
    arm = SimpleNamespace(
        contact_tolerance_m=0.002,
        track=SimpleNamespace(finger_width_m=np.full(N, gap_m)),
        joints=SimpleNamespace(q=q),
        curves={"q_smooth": q},
    )
    violations, doubt = find_arm_collisions(OpenFingers(), [arm, arm], ["left", "right"], of_poses=False)
    assert (len(violations), doubt) == (count, None)
