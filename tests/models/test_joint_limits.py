import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import from_quaternion, invert, make_pose, rotation_exp, to_quaternion
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.limit_checks import check_limits
from kinebench_drake.models.arm import ROBOTS, load_robot, panda
from kinebench_drake.models.joint_limits import JointLimits
from kinebench_drake.models.panda.description import hand_from_tcp
from kinebench_drake.violation import ViolationKind

Write = Callable[..., Path]


@pytest.fixture(scope="module")
def fr3() -> ArmPlant:
    """The Franka Research 3."""
    return ArmPlant(load_robot("fr3"))


def test_no_limit_of_the_fr3_is_looser_than_its_table(fr3: ArmPlant) -> None:
    table = ROBOTS["fr3"]
    limits = fr3.robot.limits
    for name, stated in (
        *(("lower", table.lower_rad), ("upper", table.upper_rad), ("velocity", table.velocity_rad_s)),
        *(("acceleration", table.acceleration_rad_s2), ("jerk", table.jerk_rad_s3), ("torque", table.torque_nm)),
    ):
        np.testing.assert_array_equal(getattr(limits, name), stated)
    assert limits.unstated == ()
    np.testing.assert_array_equal(fr3.drake.GetPositionLowerLimits()[fr3.arm], limits.lower)
    np.testing.assert_array_equal(fr3.drake.GetVelocityUpperLimits()[fr3.arm_rates], limits.velocity)


def test_speeds_of_the_fr3_near_a_joint_limit_are_those_of_frankas_formula(fr3: ArmPlant) -> None:
    limits = fr3.robot.limits
    q = np.random.default_rng(0).uniform(limits.lower, limits.upper, size=(1000, 7))
    table = ROBOTS["fr3"]
    offset = np.array(table.velocity_offset_rad_s)
    deceleration = np.array(table.deceleration_rad_s2)
    for v, room in ((np.ones(7), limits.upper - q), (-np.ones(7), q - limits.lower)):
        expected = np.minimum(limits.velocity, np.maximum(0.0, np.sqrt(2.0 * deceleration * room) - offset))
        np.testing.assert_allclose(limits.speeds(q, np.tile(v, (1000, 1))), expected, atol=1e-6)
        assert (expected < limits.velocity).any(axis=0).all()


def test_the_speed_limits_of_the_panda_do_not_depend_on_its_position() -> None:
    limits = panda().limits
    np.testing.assert_array_equal(
        limits.speeds(np.stack([limits.lower, limits.upper]), np.ones((2, 7)))[0], limits.velocity
    )


def test_the_fr3_moves_as_the_panda_does_and_weighs_what_franka_publishes(fr3: ArmPlant) -> None:
    plant = ArmPlant()
    for q in np.random.default_rng(1).uniform(fr3.lower, fr3.upper, size=(5, 7)):
        np.testing.assert_allclose(fr3.forward(q), plant.forward(q), atol=1e-12)
    masses = [fr3.drake.GetBodyByName(f"panda_link{i}").default_mass() for i in range(1, 8)]
    np.testing.assert_allclose(
        masses, [2.9274653, 2.9355370, 2.2449014, 2.6155956, 2.3271208, 1.8170377, 0.6271433], atol=1e-7
    )


def test_speed_beyond_the_limit_of_its_position_is_a_violation_only_towards_the_joint_limit(fr3: ArmPlant) -> None:
    """Joint 2 within 0.12 rad of its limit: 0.54 rad/s are allowed towards it, 2.62 rad/s elsewhere."""
    t_s = 0.02 * np.arange(5)
    q = np.tile(fr3.robot.rest_q, (5, 1))
    for direction, expected in ((1.0, {"panda_joint2"}), (-1.0, set[str]())):
        q[:, 1] = fr3.upper[1] - 0.12 + 1.0 * direction * t_s
        checks = check_limits(fr3, t_s, q, np.zeros(7))
        broken = [v for v in checks.violations if v.kind is ViolationKind.VELOCITY]
        assert {v.joint for v in broken} == expected
        assert all(v.value == pytest.approx(1.0) and v.limit < 0.55 for v in broken)


def test_noise_that_explains_the_speed_near_a_joint_limit_is_no_violation(fr3: ArmPlant) -> None:
    rng = np.random.default_rng(2)
    sigma = np.full(7, 2e-3)
    false_alarms = 0
    limits = fr3.robot.limits
    t_s = np.linspace(0.0, 2.0, 41)
    for _ in range(50):
        q = np.tile(fr3.robot.rest_q, (41, 1))
        q[:, 1] = limits.upper[1] - 0.3 + 0.05 * (1.0 - np.cos(1.5 * t_s))
        assert (np.gradient(q[:, 1], t_s) <= limits.speeds(q, np.ones_like(q))[:, 1]).all()
        found = check_limits(fr3, t_s, q + rng.normal(0.0, 2e-3, q.shape), sigma).violations
        false_alarms += any(v.kind is ViolationKind.VELOCITY for v in found)
    assert false_alarms == 0


@pytest.mark.parametrize("name", ["panda", "fr3"])
def test_a_tool_pose_is_the_tcp_in_the_flange(name: str) -> None:
    rng = np.random.default_rng(3)
    for w in (rng.normal(size=3), [0.0, np.pi / 2, 0.0], [0.0, -np.pi / 2, 0.3]):  # upright: roll and yaw coincide
        X_FG = make_pose(rotation_exp(np.asarray(w)), [0.03, -0.02, 0.15])
        text = ",".join(map(repr, map(float, [*X_FG[:3, 3], *to_quaternion(X_FG[:3, :3])])))
        plant = ArmPlant(load_robot(name, text))
        q = plant.robot.rest_q
        np.testing.assert_allclose(invert(plant.link_poses(q)["panda_link8"]) @ plant.forward(q), X_FG, atol=1e-9)
        np.testing.assert_allclose(plant.chain.poses(q[None], plant.robot.tcp_link)[0], plant.forward(q), atol=1e-12)


def test_the_default_tool_of_the_panda_as_a_pose_gives_the_same_robot() -> None:
    yaw = from_quaternion([np.cos(np.pi / 8), 0.0, 0.0, -np.sin(np.pi / 8)], [0.0, 0.0, 0.0])
    X_FG = yaw @ hand_from_tcp()
    plant = ArmPlant(load_robot("panda", ",".join(map(str, [*X_FG[:3, 3], *to_quaternion(X_FG[:3, :3])]))))
    hand = ArmPlant(load_robot("panda", "panda_hand:0,0,0.1034,1,0,0,0"))
    q = plant.robot.rest_q
    for own in (plant, hand):
        np.testing.assert_allclose(own.forward(q), ArmPlant().forward(q), atol=1e-12)


def test_a_payload_adds_its_weight_at_the_tcp_to_the_torques() -> None:
    loaded = ArmPlant(load_robot(payload_kg=2.0))
    plant = ArmPlant()
    still = np.zeros(7)
    rng = np.random.default_rng(4)
    for q in rng.uniform(plant.lower, plant.upper, size=(5, 7)):
        added = loaded.torque(q, still, still) - plant.torque(q, still, still)
        np.testing.assert_allclose(added, plant.jacobian(q)[3:].T @ [0.0, 0.0, 2.0 * 9.81], atol=1e-9)
        v, a = rng.normal(size=(2, 7))
        np.testing.assert_allclose(
            loaded.chain.torques(q[None], v[None], a[None])[0], loaded.torque(q, v, a), atol=1e-9
        )


def test_a_limits_file_replaces_what_it_states_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({"source": "a data sheet", "velocity_rad_s": [1, 1, 1, 1, 2, 2, 2]}))
    own = panda().limits
    table = load_robot("panda", limits=path).limits
    np.testing.assert_array_equal(table.velocity, [1, 1, 1, 1, 2, 2, 2])
    for field in fields(JointLimits):
        if field.name != "velocity":
            np.testing.assert_array_equal(getattr(table, field.name), getattr(own, field.name))


def test_limits_that_a_urdf_lacks_are_checked_once_a_file_states_them(write_arm: Write, tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({"acceleration_rad_s2": [5] * 7, "jerk_rad_s3": [100] * 7}))
    urdf = write_arm()
    assert load_robot(urdf, "tool").limits.unstated == ("acceleration", "jerk")
    assert load_robot(urdf, "tool", limits=path).limits.unstated == ()
    stated = '<limit lower="-1" upper="2" velocity="1.5" effort="20" acceleration="4" jerk="90"/>'
    limits = load_robot(write_arm(limits=dict.fromkeys(range(1, 8), stated)), "tool").limits
    assert limits.unstated == ()
    np.testing.assert_array_equal(limits.acceleration, np.full(7, 4.0))
    some = load_robot(write_arm(limits=dict.fromkeys(range(1, 7), stated)), "tool").limits
    assert some.unstated == ("acceleration", "jerk")
    np.testing.assert_array_equal(some.acceleration, [4.0] * 6 + [np.inf])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no json", "cannot be read as JSON"),
        ("{}", "states no limit; valid keys are lower_rad, "),
        ('{"torque": [1, 2, 3, 4, 5, 6, 7]}', r"has no key 'torque' .did you mean torque_nm.*valid are source, lower_"),
        ('{"torque_nm": [1, 2, 3]}', "torque_nm is not valid"),
        ('{"torque_nm": [1, 2, 3, 4, 5, 6, NaN]}', "torque_nm is not valid"),
        ("[1, 2]", "its content is not valid"),
    ],
)
def test_an_invalid_limits_file_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "limits.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=message) as caught:
        load_robot("panda", limits=path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("$limits limits.json")


def test_limits_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({"lower_rad": [3] * 7}))
    with pytest.raises(InputError, match="expected lower < upper"):
        load_robot("panda", limits=path)
    path.write_text(json.dumps({"deceleration_rad_s2": [3] * 7}))
    with pytest.raises(InputError, match="need both attributes"):
        load_robot("panda", limits=path)


@pytest.mark.parametrize("name", ["ur5", "xarm8", "panda.urdf"])
def test_an_unknown_robot_is_refused_with_the_choices(name: str) -> None:
    with pytest.raises(UsageError, match=r"expected panda, fr3, xarm7, ") as caught:
        load_robot(name)
    assert "\n" not in str(caught.value)


def test_packages_are_found_below_the_package_path(write_arm: Write, tmp_path: Path) -> None:
    import trimesh

    urdf = write_arm(shapes={1: '<mesh filename="package://far/meshes/part.stl"/>'})
    with pytest.raises(InputError, match=r"does not exist; name the folder of its packages with \$package_path"):
        load_robot(urdf, "tool")
    mesh = tmp_path / "elsewhere" / "src" / "far" / "meshes" / "part.stl"
    mesh.parent.mkdir(parents=True)
    trimesh.creation.icosphere(subdivisions=1, radius=0.1).export(mesh)
    for folder in (mesh.parents[2], mesh.parents[1]):
        assert (load_robot(urdf, "tool", package_path=folder).urdf.parent / "collision_part.obj").is_file()


def test_the_id_of_a_robot_changes_with_all_that_defines_it(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    path.write_text(json.dumps({"torque_nm": [50] * 7}))
    robots = [
        load_robot(),
        load_robot("fr3"),
        load_robot("panda", "panda_hand"),
        load_robot("panda", "0,0,0.2,1,0,0,0"),
        load_robot(limits=path),
        load_robot(payload_kg=1.0),
    ]
    assert len({robot.id for robot in robots}) == len(robots)
    assert load_robot().id == replace(panda()).id
