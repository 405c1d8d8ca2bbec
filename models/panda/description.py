"""Franka Panda: names of links and joints, and the URDF of the installed mani_skill package.

ManiSkill executes the tasks with `panda_v2.urdf`; `models.arm` loads it for Drake.
"""

import importlib.util
from enum import Enum, IntEnum
from pathlib import Path

import numpy as np

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.models.joint_limits import LimitTable

FLANGE_LINK = "panda_link8"
"""Frame F, of the tool pose of `--tool`."""
HAND_LINK = "panda_hand"
"""Frame H."""
TCP_LINK = "panda_hand_tcp"
"""Frame G."""
ARM_LINKS = tuple(f"panda_link{i}" for i in range(9))
FINGER_LINKS = ("panda_leftfinger", "panda_rightfinger")

ARM_JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))

HAND_TO_TCP_M = 0.1034
"""Distance of panda_hand_tcp from panda_hand along z [m]."""

PANDA_LIMITS = LimitTable(
    source='https://frankarobotics.github.io/docs/robot_specifications.html, "Limits for Franka Emika Robot"',
    acceleration_rad_s2=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
    jerk_rad_s3=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
    torque_rate_nm_s=(1000.0,) * 7,
)
"""Limits that the URDF of mani_skill lacks; those that it has are Franka's."""

_URDF = Path("assets/robots/panda/panda_v2.urdf")


def hand_from_tcp() -> Array:
    """Return the pose X_HG (4, 4) of panda_hand_tcp in panda_hand [m]."""
    return make_pose(np.eye(3), [0.0, 0.0, HAND_TO_TCP_M])


def rest_q() -> Array:
    """Return ManiSkill's rest posture (7,) [rad]: arm in front of the base, gripper pointing down."""
    return np.pi * np.array([0.0, 1 / 8, 0.0, -5 / 8, 0.0, 3 / 4, 1 / 4])


def source_urdf() -> Path:
    """Return the URDF of the installed mani_skill package, without importing it (which loads torch and sapien).

    Raises:
        SetupError: mani_skill is not installed, or does not contain the Panda.
    """
    spec = importlib.util.find_spec("mani_skill")
    if spec is None or not spec.submodule_search_locations:
        raise SetupError(
            "mani_skill is not installed, but the Panda's URDF comes from it; pip install 'mani-skill~=3.0'"
        )
    path = Path(spec.submodule_search_locations[0]) / _URDF
    if not path.is_file():
        raise SetupError(f"mani_skill contains no {_URDF}; expected mani-skill 3.0.x, reinstall it")
    return path


class GripperKind(Enum):
    """Gripper of a Panda."""

    FRANKA = "franka"
    """The Franka hand."""
    ROBOTIQ_2F85 = "robotiq-2f85"
    """The Robotiq 2F-85: links and contours of the gripper give the flange, the opening is unknown."""
    NONE = "none"
    """None, or an unknown one."""
    AUTO = "auto"
    """The Franka hand; where the arm is seen without it, none, else the Robotiq 2F-85."""


class RobotPart(IntEnum):
    """Part of the robot that a pixel shows; hand and fingers form the gripper."""

    BACKGROUND = 0
    HAND = 1
    LEFT_FINGER = 2
    RIGHT_FINGER = 3
    LINK0 = 4
    LINK1 = 5
    LINK2 = 6
    LINK3 = 7
    LINK4 = 8
    LINK5 = 9
    LINK6 = 10
    LINK7 = 11


GRIPPER = (RobotPart.HAND, RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER)
"""Parts of the gripper."""

ARM = tuple(part for part in RobotPart if part >= RobotPart.LINK0)
"""Parts of the arm, base first; the eighth link has no body."""

LINK_OF = dict(zip((*GRIPPER, *ARM), (HAND_LINK, *FINGER_LINKS, *ARM_LINKS[:-1]), strict=True))
"""Link name in the URDF of each part."""

OPENING_SIGN = {RobotPart.HAND: 0.0, RobotPart.LEFT_FINGER: 1.0, RobotPart.RIGHT_FINGER: -1.0}
"""Direction along the y axis of the hand in which a part moves as the gripper opens."""
