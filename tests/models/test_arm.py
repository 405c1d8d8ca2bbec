import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import pose_difference, rotation_exp
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.manipulability import compute_manipulability
from kinebench_drake.kinematics.newton import solve_newton
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.timing import time_scale
from kinebench_drake.kinematics.track_ik import settle_free_turns
from kinebench_drake.models.arm import load_robot, panda
from kinebench_drake.models.panda.description import TCP_LINK, source_urdf
from kinebench_drake.models.robot import Robot
from kinebench_drake.track import IkStatus

Write = Callable[..., Path]
ROBOTS = source_urdf().parent.parent
FINGERS = "".join(
    f'<link name="f{i}"><collision><origin xyz="0 0 0.15"/><geometry><box size="0.02 0.02 0.04"/></geometry>'
    f'</collision></link><joint name="slide{i}" type="prismatic"><parent link="l7"/><child link="f{i}"/>'
    f'<axis xyz="0 {axis} 0"/>'
    '<limit lower="0" upper="0.03" velocity="1" effort="1"/></joint>'
    for i, axis in ((1, 1), (2, -1))
)


def _chain(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Pose of the made-up arm's tool, written out: 0.2 m up, then a turn about z or y, seven times."""
    X = np.eye(4)
    for i, angle in enumerate(q):
        c = np.cos(angle)
        s = np.sin(angle)
        R = [[c, -s, 0], [s, c, 0], [0, 0, 1]] if i % 2 == 0 else [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        step = np.eye(4)
        step[:3, :3] = R
        step[2, 3] = 0.2
        X = X @ step
    tool = np.eye(4)
    tool[2, 3] = 0.1
    return np.asarray(X @ tool)


def test_loading_the_pandas_urdf_gives_the_panda_without_its_published_limits() -> None:
    loaded = load_robot(source_urdf(), TCP_LINK)
    own = panda()
    for name in ("base_link", "tcp_link", "hand_link", "joints", "finger_joints", "links", "allowed_pairs"):
        assert getattr(loaded, name) == getattr(own, name)
    np.testing.assert_array_equal(loaded.rest_q, own.rest_q)
    for name in ("lower", "upper", "velocity", "torque"):
        np.testing.assert_array_equal(getattr(loaded.limits, name), getattr(own.limits, name))
    assert loaded.limits.unstated == ("acceleration", "jerk")
    assert any("acceleration and jerk, which are not checked" in remark for remark in loaded.remarks)
    assert (own.limits.unstated, own.remarks) == ((), ())


def test_a_custom_arm_moves_as_its_urdf_describes(write_arm: Write) -> None:
    plant = ArmPlant(load_robot(write_arm(), "tool"))
    robot = plant.robot
    assert (robot.name, robot.base_link, robot.tcp_link) == ("small", "l0", "tool")
    assert robot.joints == tuple(f"j{i}" for i in range(1, 8))
    assert robot.finger_joints == ()
    assert robot.links == (*(f"l{i}" for i in range(8)), "tool")
    np.testing.assert_array_equal(robot.rest_q, np.full(7, 0.5))  # the middle of -1 .. 2
    np.testing.assert_array_equal(robot.limits.torque, np.full(7, 20.0))
    np.testing.assert_array_equal([plant.lower, plant.upper, plant.velocity_limits], [[-1.0] * 7, [2.0] * 7, [1.5] * 7])
    for q in np.random.default_rng(0).uniform(plant.lower, plant.upper, size=(5, 7)):
        np.testing.assert_allclose(plant.forward(q), _chain(robot, q), atol=1e-12)


def test_arm_joints_need_not_come_first_in_drakes_order(write_arm: Write) -> None:
    """A slide and a wheel hang on the base, before the arm's joints: the arm must not notice."""
    more = (
        '<link name="wheel"/><joint name="a_wheel" type="revolute"><parent link="l0"/><child link="wheel"/>'
        '<axis xyz="1 0 0"/><limit lower="0.3" upper="1" velocity="1" effort="1"/></joint>'
        '<link name="box"/><joint name="a_slide" type="prismatic"><parent link="wheel"/><child link="box"/>'
        '<axis xyz="1 0 0"/><limit lower="0" upper="0.01" velocity="1" effort="1"/></joint>'
    )
    strong = dict.fromkeys(range(1, 8), '<limit lower="-1" upper="2" velocity="1.5" effort="200"/>')
    urdf = write_arm(more=more, limits=strong)
    joints = urdf.read_text().split("\n")
    urdf.write_text(
        "\n".join([joints[0], joints[-1].split("</joint>", 1)[1].removesuffix("</robot>"), *joints[1:-1]])
        + joints[-1].split("</joint>", 1)[0]
        + "</joint></robot>"
    )
    plant = ArmPlant(load_robot(urdf, "tool"))
    plain = ArmPlant(load_robot(write_arm(limits=strong), "tool"))
    assert plant.robot.finger_joints == ()
    rng = np.random.default_rng(1)
    q, v, a = rng.uniform(plant.lower, plant.upper, size=(3, 7))
    np.testing.assert_allclose(plant.forward(q), plain.forward(q), atol=1e-12)
    np.testing.assert_allclose(plant.jacobian(q), plain.jacobian(q), atol=1e-12)
    np.testing.assert_allclose(plant.chain.jacobians(q[None])[0], plain.jacobian(q), atol=1e-12)
    np.testing.assert_allclose(plant.torque(q, v, a), plain.torque(q, v, a), atol=1e-9)
    np.testing.assert_allclose(plant.chain.torques(q[None], v[None], a[None])[0], plain.torque(q, v, a), atol=1e-9)
    np.testing.assert_allclose(plant.mass_matrix(q), plain.mass_matrix(q), atol=1e-9)
    assert np.abs(plant.forward(solve_newton(plant, plant.forward(q), q - 0.1)[0]) - plant.forward(q)).max() < 1e-5
    t = np.linspace(0.0, 4.0, 30)
    path = plant.robot.rest_q + 0.4 * np.sin(t)[:, None] * np.array([1.0, 0.2, -1.0, 0.3, 1.0, -0.2, 1.0])
    scale = time_scale(plant, t, path)
    expected = time_scale(plain, t, path)
    assert expected.value is not None
    assert scale.value == pytest.approx(expected.value, rel=1e-3)
    assert (scale.constraint, scale.joint) == (expected.constraint, expected.joint)
    wheel = plant.link_poses(q)["wheel"]
    assert wheel[2, 1] == pytest.approx(np.sin(0.3))  # held at its limit nearest to 0


def test_each_finger_opens_by_half_the_width_and_closed_fingers_may_touch(write_arm: Write) -> None:
    plant = ArmPlant(load_robot(write_arm(more=FINGERS), "tool"))
    assert plant.robot.finger_joints == ("slide1", "slide2")
    assert plant.robot.hand_link == "l7"
    q = plant.robot.rest_q[None]
    for width, apart in ((0.0, 0.0), (0.05, 0.05), (0.2, 0.06)):
        M = plant.chain.motions(q, [width])[0]
        chain = plant.chain
        left, right = ((M[chain.stage[link]] @ chain.home[link])[:3, 3] for link in ("f1", "f2"))
        assert np.linalg.norm(left - right) == pytest.approx(apart)
    model = CollisionModel(plant)
    closed = model.near_pairs(plant.robot.rest_q, 10.0, 0.0)
    assert not any({p.link_a, p.link_b} == {"f1", "f2"} for p in closed)
    assert any("f1" in (p.link_a, p.link_b) for p in closed)


def test_links_in_contact_at_mid_range_are_allowed_pairs_only_without_an_srdf(write_arm: Write) -> None:
    big = {3: '<sphere radius="0.21"/>', 5: '<sphere radius="0.21"/>'}
    urdf = write_arm(shapes=big)
    robot = load_robot(urdf, "tool")
    assert robot.allowed_pairs is None
    assert any("small.srdf" in remark for remark in robot.remarks)
    plant = ArmPlant(robot)
    assert frozenset({"l3", "l5"}) in plant.allowed_pairs
    near = CollisionModel(plant).near_pairs(robot.rest_q, 1.0)
    assert not any((p.link_a, p.link_b) == ("l3", "l5") for p in near)
    urdf.with_suffix(".srdf").write_text('<robot><disable_collisions link1="l0" link2="l2"/></robot>')
    given = ArmPlant(load_robot(urdf, "tool"))
    assert given.allowed_pairs == {frozenset({"l0", "l2"})}
    near = CollisionModel(given).near_pairs(robot.rest_q, 0.0)
    assert any((p.link_a, p.link_b) == ("l3", "l5") for p in near)
    assert CollisionModel(given).self_distance(robot.rest_q[None]).distance_m[0] < 0.0


def test_table_distances_of_primitive_shapes_are_exact(write_arm: Write) -> None:
    """Arm upright (q = 0), then its last part turned by 0.5 rad about y: each shape's lowest point in closed form."""
    shapes = {
        6: '<sphere radius="0.03"/>',
        7: '<cylinder radius="0.03" length="0.1"/>',
    }
    plant = ArmPlant(load_robot(write_arm(shapes=shapes), "tool"))
    q = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0])
    lowest = {p.link_a: p.distance_m for p in CollisionModel(plant).near_pairs(q, 10.0) if p.link_b == "table"}
    c = np.cos(0.5)
    s = np.sin(0.5)
    assert lowest["l1"] == pytest.approx(0.2 + 0.1 - 0.05)  # a box 0.1 m high
    assert lowest["l6"] == pytest.approx(1.2 + 0.1 * c - 0.03)
    assert lowest["l7"] == pytest.approx(1.2 + 0.3 * c - 0.05 * c - 0.03 * s)
    assert "l0" not in lowest
    table = CollisionModel(plant, table_height_m=0.5).table_distance(q[None])
    assert table.distance_m[0] == pytest.approx(0.25 - 0.5)
    assert table.pair == (("l1", "table"),)


def test_round_shapes_have_exact_distances_and_gradients(write_arm: Write) -> None:
    shapes = {2: '<sphere radius="0.04"/>', 5: '<cylinder radius="0.03" length="0.1"/>', 7: '<sphere radius="0.05"/>'}
    plant = ArmPlant(load_robot(write_arm(shapes=shapes), "tool"))
    model = CollisionModel(plant)
    q = np.array([0.2, 1.9, 0.4, 1.8, -0.3, 1.5, 0.1])

    def distances(q: np.ndarray) -> dict[tuple[str, str], float]:
        return {(p.link_a, p.link_b): p.distance_m for p in model.near_pairs(q, 10.0)}

    centers = {link: plant.link_poses(q)[link] @ [0.0, 0.0, 0.1, 1.0] for link in ("l2", "l7")}
    expected = np.linalg.norm(centers["l2"] - centers["l7"]) - 0.09
    assert distances(q)["l2", "l7"] == pytest.approx(expected, abs=1e-9)
    checked = set()
    for p in model.near_pairs(q, 10.0):
        pair = (p.link_a, p.link_b)
        rounded = "l5" in pair and "table" not in pair  # cylinders: Drake iterates, to about 1e-6 m
        h, atol = (1e-4, 2e-2) if rounded else (1e-6, 1e-5)
        slope = [(distances(q + h * e)[pair] - distances(q - h * e)[pair]) / (2 * h) for e in np.eye(7)]
        np.testing.assert_allclose(p.gradient, slope, atol=atol, err_msg=str(pair))
        checked.add(pair)
    assert {("l2", "l7"), ("l2", "l5"), ("l5", "table"), ("l7", "table")} <= checked


def test_continuous_joints_turn_without_limits_with_a_remark(write_arm: Write) -> None:
    plant = ArmPlant(load_robot(write_arm(types={1: "continuous", 7: "continuous"}), "tool"))
    assert (plant.upper[[0, 6]] > 50.0).all()
    assert (plant.lower[[0, 6]] < -50.0).all()
    assert plant.robot.rest_q[0] == 0.0
    assert "position" not in plant.robot.limits.unstated
    assert any("j1, j7" in remark for remark in plant.robot.remarks)
    pose = plant.forward(plant.robot.rest_q + 0.3)
    assert solve_pose(plant, pose, plant.robot.rest_q).status is IkStatus.OK


def test_limits_that_a_description_lacks_are_not_checked_and_listed(write_arm: Write) -> None:
    limits = {4: "", 5: '<limit lower="0" upper="0" velocity="0" effort="0"/>', 6: '<limit lower="-1" upper="1"/>'}
    robot = load_robot(write_arm(limits=limits), "tool")
    assert robot.limits.unlimited == ("j4", "j5")
    assert robot.limits.unstated == ("position", "velocity", "acceleration", "jerk", "torque")
    assert np.isinf(robot.limits.velocity).tolist() == [False] * 3 + [True] * 3 + [False]
    [remark] = [text for text in robot.remarks if "states no limits" in text]
    assert "position and velocity" in remark


@pytest.mark.parametrize("joints", [5, 6, 7])
@pytest.mark.parametrize("types", [{}, {2: "prismatic"}])
def test_arms_of_five_to_seven_joints_obey_drakes_kinematics_and_dynamics(
    write_arm: Write, joints: int, types: dict[int, str]
) -> None:
    plant = ArmPlant(load_robot(write_arm(joints=joints, types=types), "tool"))
    rng = np.random.default_rng(joints)
    q, v, a = rng.uniform(plant.lower, plant.upper, size=(3, joints))
    J = plant.jacobian(q)
    assert J.shape == (6, joints)
    np.testing.assert_allclose(plant.chain.jacobians(q[None])[0], J, atol=1e-12)
    np.testing.assert_allclose(plant.chain.torques(q[None], v[None], a[None])[0], plant.torque(q, v, a), atol=1e-9)
    w = compute_manipulability(plant, q[None]).full[0]
    assert w == pytest.approx(np.prod(np.linalg.svd(J, compute_uv=False)))
    for near in CollisionModel(plant).near_pairs(q, 1.0):
        assert near.gradient.shape == (joints,)
    solved, error = solve_newton(plant, plant.forward(q), np.clip(q + 0.05, plant.lower, plant.upper))
    assert error < 1e-9
    np.testing.assert_allclose(plant.forward(solved)[:3, 3], plant.forward(q)[:3, 3], atol=1e-9)


def test_five_joints_follow_position_and_axis_and_six_the_whole_pose(write_arm: Write) -> None:
    """A turn about the axis that five joints cannot turn about does not count; six joints have to follow it."""
    for joints in (5, 6):
        plant = ArmPlant(load_robot(write_arm(joints=joints), "tool"))
        q = plant.robot.rest_q + 0.2 * np.linspace(-1.0, 1.0, joints)
        X = plant.forward(q)
        J = plant.jacobian(q)
        missing = np.linalg.svd(J)[0][:, -1]
        turned = X.copy()
        turned[:3, :3] = rotation_exp(0.2 * missing[:3] / np.linalg.norm(missing[:3])) @ X[:3, :3]
        settled = settle_free_turns(plant, turned[None])[0]
        if joints == 5:
            np.testing.assert_allclose(settled, X, atol=1e-6)
        else:
            np.testing.assert_array_equal(settled, turned)


def test_a_motion_of_five_joints_that_starts_near_a_singularity_keeps_its_turns() -> None:
    """Poses next to a singularity, at which the search misses the whole pose, get it from the poses after them."""
    plant = ArmPlant(load_robot("g1_left"))
    ends = np.array([[2.157, 1.801, -1.370, 0.929, 1.877], [2.120, 1.313, 0.562, 1.161, 0.129]])
    s = np.linspace(0.0, 1.0, 49)[:, None]
    X_BG = plant.forward_path(ends[0] + (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5) * (ends[1] - ends[0]))
    assert pose_difference(settle_free_turns(plant, X_BG), X_BG)[1].max() < 1e-6


def test_a_floating_joint_is_fixed_and_fingers_open_either_way(write_arm: Write) -> None:
    mimic = FINGERS.replace('lower="0" upper="0.03"', 'lower="-0.03" upper="0"', 1)
    robot = load_robot(write_arm(types={1: "floating"}, more=mimic), "tool")
    assert len(robot.joints) == 6
    assert any("floating joints are taken as fixed" in remark for remark in robot.remarks)
    assert robot.finger_signs == (-1.0, 1.0)
    plant = ArmPlant(robot)
    moved = plant.positions(robot.rest_q[None], [0.04])[0]
    assert sorted(set(moved.tolist()) - set(robot.rest_q.tolist())) == [-0.02, 0.02]


def test_of_a_body_with_two_arms_the_joints_beyond_the_shoulder_are_the_arm(write_arm: Write) -> None:
    """A torso turns below the arm, and another arm of five joints begins where this one does."""
    other = "".join(
        f'<link name="o{i}"/><joint name="k{i}" type="revolute"><parent link="{"l2" if i == 1 else f"o{i - 1}"}"/>'
        f'<child link="o{i}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for i in range(1, 6)
    )
    robot = load_robot(write_arm(more=other), "tool")
    assert robot.joints == ("j3", "j4", "j5", "j6", "j7")
    assert any("are fixed: j1, j2" in remark for remark in robot.remarks)


def test_without_shapes_for_contact_visual_meshes_give_them(write_arm: Write, tmp_path: Path) -> None:
    urdf = write_arm(visuals={3: '<mesh filename="ball.obj"/>', 4: '<mesh filename="gone.obj"/>'})
    urdf.write_text(re.sub(r"<collision>.*?</collision>", "", urdf.read_text()))
    bare = load_robot(urdf, "tool")
    assert any("no link has a shape for contact: collisions are not checked" in remark for remark in bare.remarks)
    assert not CollisionModel(ArmPlant(bare)).movable
    trimesh.creation.icosphere(radius=0.05).export(urdf.parent / "ball.obj")
    robot = load_robot(urdf, "tool")
    assert any("convex hulls of the visual meshes of 1 links" in remark for remark in robot.remarks)
    assert [solid.link for solid in CollisionModel(ArmPlant(robot)).movable] == ["l3"]


def test_unreadable_visuals_are_skipped_with_a_remark(write_arm: Write) -> None:
    robot = load_robot(write_arm(visuals={2: '<mesh filename="no.dae"/>'}), "tool")
    assert any("not drawn: those of l2" in remark for remark in robot.remarks)
    ArmPlant(robot)


@pytest.mark.parametrize(
    ("arm", "tcp", "error", "message"),
    [
        ({}, "hand", UsageError, "no link 'hand'.*; the links of small.urdf are l0, l1, "),
        ({}, None, UsageError, "names no TCP frame of .*; the links of small.urdf are l0, l1, "),
        ({}, "0,0,0,1,0,0,0", UsageError, "expected LINK:x,y,z,qw,qx,qy,qz"),
        ({}, "l7:0,0,0,1,1,0,0", UsageError, "a unit quaternion"),
        ({}, "l7:0,0,0,1,0,0", UsageError, "a unit quaternion"),
        (
            {"limits": {2: '<limit lower="0" upper="1" velocity="1" effort="-3"/>'}},
            "tool",
            InputError,
            "joint j2 has the effort limit -3",
        ),
        (
            {"limits": {2: '<limit lower="0" upper="1" velocity="1" jerk="0"/>'}},
            "tool",
            InputError,
            "joint j2 has the jerk limit 0",
        ),
        ({"joints": 4}, "tool", InputError, "4 moving joints between l0 and tool .*j4.*, expected 5 to 7"),
        ({"joints": 8}, "tool", InputError, "8 moving joints"),
        ({}, "l0", InputError, "0 moving joints between l0 and l0 .none."),
        ({"types": {2: "planar"}}, "tool", InputError, "joint j2 is planar, expected revolute"),
        (
            {"limits": {4: '<limit lower="0" upper="1" velocity="-2"/>'}},
            "tool",
            InputError,
            "j4 has the velocity",
        ),
        ({"limits": {4: '<limit lower="1" upper="0" velocity="1"/>'}}, "tool", InputError, "joint j4 has the limits 1"),
        (
            {"limits": {4: '<limit lower="a" upper="1" velocity="1"/>'}},
            "tool",
            InputError,
            "joint j4 has the limits nan",
        ),
        ({"more": '<link name="loose"/>'}, "tool", InputError, "2 links hang on no joint .l0, loose."),
        (
            {"more": '<joint name="x" type="fixed"><parent link="l1"/><child link="l3"/></joint>'},
            "tool",
            InputError,
            "link l3 hangs on two joints, j3 and x",
        ),
        (
            {"more": '<joint name="x" type="fixed"><parent link="l1"/><child link="gone"/></joint>'},
            "tool",
            InputError,
            "joint x names the link 'gone'",
        ),
        (
            {
                "more": '<link name="a"/><link name="b"/>'
                '<joint name="x" type="fixed"><parent link="a"/><child link="b"/></joint>'
                '<joint name="y" type="fixed"><parent link="b"/><child link="a"/></joint>'
            },
            "tool",
            InputError,
            "the joints of a, b form a loop",
        ),
    ],
)
def test_an_unsupported_arm_is_refused_in_one_line(
    write_arm: Write, arm: dict[str, object], tcp: str, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message) as caught:
        load_robot(write_arm(**arm), tcp)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("small.urdf" if error is InputError else "$tool")


def test_a_missing_urdf_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no\.urdf: there is no such file.*expected panda, fr3, xarm7, "):
        load_robot(tmp_path / "no.urdf", "tool")


def test_an_error_of_drake_is_reported_in_one_line(write_arm: Write) -> None:
    robot = load_robot(write_arm(shapes={2: '<box size="a b"/>'}), "tool")
    with pytest.raises(InputError, match="small: Drake cannot load this robot") as caught:
        ArmPlant(robot)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "tcp", "fingers"),
    [
        ("panda/panda_v3.urdf", "camera_link", 2),
        ("panda/panda_stick.urdf", "panda_hand_tcp", 0),
        ("panda/panda_pinch.urdf", "panda_hand_tcp", 2),
        ("xarm7/xarm7.urdf", "link_eef", 0),
        ("xarm7/xarm7_ability_right_hand.urdf", "link7", 0),
    ],
)
def test_seven_joint_arms_of_maniskill_are_loaded(file: str, tcp: str, fingers: int) -> None:
    plant = ArmPlant(load_robot(ROBOTS / file, tcp))
    assert len(plant.robot.finger_joints) == fingers
    model = CollisionModel(plant)
    rest = plant.robot.rest_q
    assert ((plant.lower <= rest) & (rest <= plant.upper)).all()
    assert model.self_distance(rest[None]).distance_m[0] > 0.0
    assert model.table_distance(rest[None]).distance_m[0] > 0.0
    np.testing.assert_allclose(plant.chain.jacobians(rest[None])[0], plant.jacobian(rest), atol=1e-12)
    assert np.isfinite(plant.torque(rest, np.zeros(7), np.zeros(7))).all()
