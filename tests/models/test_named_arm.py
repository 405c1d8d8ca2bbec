from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.errors import SetupError
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import arm_limits, list_arms, load_robot
from kinebench_drake.models.named_arm import UNNAMED, NamedArm, find_arm, named_arms
from kinebench_drake.runs.resources import RobotOptions

INSTALLED = [str(arm["name"]) for arm in list_arms() if "missing" not in arm]


def test_arms_of_dependencies_are_installed_and_every_limit_has_a_source() -> None:
    assert {"panda", "fr3", "xarm7", "so100", "koch", "g1_left", "g1_right"} <= set(INSTALLED)
    for arm in list_arms():
        assert arm["source"]
        if "missing" not in arm:
            assert "position" in arm["checked"]
            assert not set(arm["checked"]) & set(arm["unchecked"])


@pytest.mark.parametrize("name", [name for name in INSTALLED if named_arms()[name].package])
def test_an_arm_by_name_has_its_limits_and_only_those_that_its_maker_publishes(name: str) -> None:
    robot = load_robot(name)
    joints, limits = arm_limits(name)
    assert robot.joints == joints
    assert len(robot.column_names) == len(joints)
    assert set(robot.limits.unstated) == set(limits.unstated) >= {"acceleration", "jerk"}
    plant = ArmPlant(robot)
    q = robot.rest_q + 0.01
    np.testing.assert_allclose(plant.chain.poses(q[None], robot.tcp_link)[0], plant.forward(q), atol=1e-9)


def test_data_sets_name_arms_by_their_robot_type() -> None:
    names = ("Panda", "xarm7", "so100_follower", "koch", "ur5", "aloha")
    assert [find_arm(name) for name in names] == ["panda", "xarm7", "so100", "koch", None, "aloha"]
    types = [kind for arm in named_arms().values() for kind in arm.types]
    assert len(types) == len(set(types))


def test_an_arm_whose_package_is_missing_says_how_to_install_it(tmp_path: Path) -> None:
    arm = NamedArm(title="Arm", types=(), package="no_such_package", requirement="no-such-package", file="a.urdf")
    with pytest.raises(SetupError, match=r"^Arm is described in no-such-package; pip install 'no-such-package'$"):
        arm.path()


def test_an_arm_that_nobody_names_is_the_panda() -> None:
    assert RobotOptions(robot=UNNAMED).robot == "panda"
