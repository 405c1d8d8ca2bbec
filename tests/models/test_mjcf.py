from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from kinebench_drake.errors import InputError
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import load_robot

BODY = (
    '<body name="b{k}" pos="0 0.02 0.2"><joint name="j{k}" axis="{axis}" pos="0 0 0.01" range="-60 60"/>'
    '<geom type="{shape}" size="0.03 0.05 0.02" mass="0.4"/>'
)
HEAD = (
    '<mujoco model="small"><compiler angle="degree" meshdir="meshes"/><asset><mesh name="m" file="ball.stl"/></asset>'
    '<worldbody><body name="base" pos="0.1 0.2 0.3" quat="0.6 0 0 0.8"><geom type="mesh" mesh="m" mass="1"/>'
)


@pytest.fixture
def mjcf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An arm of six joints with all kinds of shapes and a finger; the base's mesh is an .stl."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "meshes").mkdir()
    trimesh.creation.icosphere(radius=0.05).export(tmp_path / "meshes" / "ball.stl")
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "0 0 1")
    shapes = ("sphere", "capsule", "cylinder", "box", "sphere", "box")
    bodies = "".join(BODY.format(k=k, axis=a, shape=s) for k, (a, s) in enumerate(zip(axes, shapes, strict=True)))
    finger = '<body name="tip" pos="0 0.1 0"/>'
    finger += '<body name="f"><joint name="slide" type="slide" axis="0 1 0" range="-0.03 0"/><geom size="0.01"/></body>'
    motor = '<actuator><motor joint="j0" ctrllimited="true" ctrlrange="-9 9"/>'
    motor += '<position joint="j1" ctrllimited="true" ctrlrange="-1 1" forcerange="-5 5"/></actuator>'
    cube = '<body name="cube"><freejoint/><geom size="0.02"/></body>'
    path = tmp_path / "small.xml"
    path.write_text(HEAD + bodies + finger + "</body>" * 7 + f"{cube}</worldbody>{motor}</mujoco>")
    return path


def test_an_mjcf_moves_and_weighs_as_in_drake(mjcf: Path, tmp_path: Path) -> None:
    plant = ArmPlant(load_robot(mjcf, "b5"))
    robot = plant.robot
    assert "cube" not in {solid.link for solid in CollisionModel(plant).arm_solids().values()}
    assert robot.joints == tuple(f"j{k}" for k in range(6))
    assert (robot.finger_joints, robot.finger_signs) == (("slide",), (-1.0,))
    np.testing.assert_allclose(robot.limits.upper, np.pi / 3)
    np.testing.assert_array_equal(robot.limits.torque, [9.0, 5.0, *[np.inf] * 4])  # not the range of a servo's angles
    assert robot.limits.unstated == ("velocity", "acceleration", "jerk", "torque")
    drake = MultibodyPlant(0.0)
    trimesh.load(tmp_path / "meshes" / "ball.stl").export(tmp_path / "meshes" / "ball.obj")
    text = mjcf.read_text().replace("meshes", str(tmp_path / "meshes"))
    Parser(drake).AddModelsFromString(text.replace(".stl", ".obj"), "xml")
    drake.Finalize()
    context = drake.CreateDefaultContext()
    q = np.random.default_rng(0).uniform(plant.lower, plant.upper)
    for k, angle in enumerate(q):
        drake.GetJointByName(f"j{k}").set_angle(context, angle)
    drake.GetJointByName("slide").set_translation(context, -0.03)
    pose = drake.GetBodyByName("b5").EvalPoseInWorld(context).GetAsMatrix4()
    np.testing.assert_allclose(plant.forward(q), pose, atol=1e-9)
    pose = drake.GetBodyByName("tip").EvalPoseInWorld(context).GetAsMatrix4()
    np.testing.assert_allclose(plant.link_poses(q)["tip"], pose, atol=1e-9)
    gravity = -drake.CalcGravityGeneralizedForces(context)[:6]
    np.testing.assert_allclose(plant.torque(q, np.zeros(6), np.zeros(6)), gravity, atol=1e-6)
    assert {solid.link for solid in CollisionModel(plant).movable} == {*(f"b{k}" for k in range(6)), "f"}


@pytest.mark.parametrize(
    "text",
    [
        "<mujoco><worldbody><body/></worldbody",
        '<mujoco><asset><mesh file="no.stl"/></asset></mujoco>',
        '<mujoco><include file="bad.xml"/></mujoco>',
        '<mujoco><include file="no.xml"/></mujoco>',
    ],
)
def test_an_unusable_mjcf_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"^bad.xml: ") as caught:
        load_robot(path, "b0")
    assert "\n" not in str(caught.value)
