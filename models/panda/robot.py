"""Franka Panda for Drake: the URDF of the installed mani_skill package and Franka's limits.

ManiSkill executes the tasks with `panda_v2.urdf`; its collision meshes are .stl and its visual meshes .glb, which
Drake's collision engine does not support: they are converted (`models.urdf`).
"""

import importlib.util
from enum import Enum, IntEnum
from functools import cache
from pathlib import Path

import numpy as np

from kinebench_drake.errors import InputError, SetupError
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.models.robot import Robot
from kinebench_drake.models.urdf import convert_urdf, read_allowed_pairs, read_effort_limits

BASE_LINK = "panda_link0"
"""Frame B."""
HAND_LINK = "panda_hand"
"""Frame H."""
TCP_LINK = "panda_hand_tcp"
"""Frame G."""
ARM_LINKS = tuple(f"panda_link{i}" for i in range(9))
FINGER_LINKS = ("panda_leftfinger", "panda_rightfinger")
LINKS = (*ARM_LINKS, HAND_LINK, TCP_LINK, *FINGER_LINKS)
"""Links of arm and hand, base first."""

ARM_JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))
FINGER_JOINTS = ("panda_finger_joint1", "panda_finger_joint2")
"""Prismatic joints, 0..0.04 m each; the gap between the pads is twice the position of one."""

HAND_TO_TCP_M = 0.1034
"""Distance of panda_hand_tcp from panda_hand along z [m]."""

ACCELERATION_LIMITS = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""Joint acceleration limits [rad/s^2]: Franka Control Interface documentation, "Robot and interface specifications"
(Panda), as in libfranka's rate_limiting.h."""
JERK_LIMITS = (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0)
"""Joint jerk limits [rad/s^3], from the same source."""

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


@cache
def panda_urdf() -> Path:
    """Return the path of the Panda's URDF with meshes that Drake can load, converted on first use.

    Raises:
        SetupError: mani_skill is missing or damaged, or the cache folder cannot be written.
    """
    try:
        return convert_urdf(source_urdf(), "panda")
    except InputError as error:
        raise SetupError(f"mani_skill's Panda is damaged, reinstall mani-skill 3.0.x ({error})") from None


def panda() -> Robot:
    """Return the Panda with its gripper, as in ManiSkill.

    Raises:
        SetupError: mani_skill is missing or damaged, or the cache folder cannot be written.
    """
    return Robot(
        name="panda",
        urdf=panda_urdf(),
        base_link=BASE_LINK,
        tcp_link=TCP_LINK,
        hand_link=HAND_LINK,
        joints=ARM_JOINTS,
        finger_joints=FINGER_JOINTS,
        links=LINKS,
        rest_q=rest_q(),
        effort_limits=read_effort_limits(source_urdf(), ARM_JOINTS),
        acceleration_limits=np.array(ACCELERATION_LIMITS),
        jerk_limits=np.array(JERK_LIMITS),
        allowed_pairs=read_allowed_pairs(source_urdf().with_suffix(".srdf")),
    )


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
