"""Franka Panda: names of links and joints, and the URDF of the installed mani_skill package; Franka Research 3.

ManiSkill executes the tasks with `panda_v2.urdf`; `models.arm` loads it for Drake. The Denavit-Hartenberg parameters,
flange and hand of the Franka Research 3 are the Panda's; its bodies are approximated by the Panda's meshes. Its limits
and masses are those that Franka Robotics publishes.
"""

import importlib.util
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from enum import Enum, IntEnum
from pathlib import Path
from types import MappingProxyType

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
    """The Robotiq 2F-85, turned by eighths of a turn on any adapter."""
    NONE = "none"
    """None, or an unknown one."""
    AUTO = "auto"
    """The Franka hand; where it is not seen, the Robotiq 2F-85; without either, none."""


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


FR3_LIMITS = LimitTable(
    source='https://frankarobotics.github.io/docs/robot_specifications.html, "Limits for Franka Research 3" (2025)',
    lower_rad=(-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508),
    upper_rad=(2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508),
    velocity_rad_s=(2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    acceleration_rad_s2=(10.0,) * 7,
    jerk_rad_s3=(5000.0,) * 7,
    torque_nm=(87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0),
    torque_rate_nm_s=(1000.0,) * 7,
    velocity_offset_rad_s=(0.6599, 0.2517, 0.2000, 0.3533, 0.5757, 0.4878, 0.4628),
    deceleration_rad_s2=(6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0),
)
"""Limits of the Franka Research 3."""

INERTIALS: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "panda_link0": (2.3966, -0.0172, 0.0004, 0.0745, 0.0090, 0.0, 0.0020, 0.0115, 0.0, 0.0085),
        "panda_link1": (
            *(2.9274653454, 0.0000004128, -0.0181251324, -0.0386035970),
            *(0.0239273165, 0.0000133179, -0.0001140477, 0.0224821613, -0.0019950321, 0.0063500983),
        ),
        "panda_link2": (
            *(2.9355370338, 0.0031828864, -0.0743221644, 0.0088146084),
            *(0.0419389463, 0.0002025733, 0.0040777842, 0.0251451489, -0.0042252158, 0.0617021447),
        ),
        "panda_link3": (
            *(2.2449013699, 0.0407015686, -0.0048200565, -0.0289730823),
            *(0.0241014255, 0.0024046946, -0.0028562693, 0.0197405327, -0.0021042127, 0.0190444945),
        ),
        "panda_link4": (
            *(2.6155955791, -0.0459100965, 0.0630492960, -0.0085187868),
            *(0.0345299832, 0.0132255227, 0.0101514300, 0.0288816219, -0.0009762834, 0.0412547117),
        ),
        "panda_link5": (
            *(2.3271207594, -0.0016039605, 0.0292536262, -0.0972965990),
            *(0.0516102785, -0.0057151734, -0.0035673168, 0.0478772971, 0.0106739851, 0.0164236256),
        ),
        "panda_link6": (
            *(1.8170376524, 0.0597131221, -0.0410294666, -0.0101692726),
            *(0.0054123336, 0.0061934564, 0.0014219289, 0.0140583295, -0.0013140754, 0.0160808179),
        ),
        "panda_link7": (
            *(0.6271432862, 0.0045225817, 0.0086261921, -0.0161633251),
            *(0.0002109239, -0.0000243330, 0.0000456448, 0.0001771857, 0.0000874407, 0.0000599319),
        ),
    }
)
"""Mass [kg], centre of mass [m] and inertia xx, xy, xz, yy, yz, zz about it [kg m^2] of each link in its frame.

Source: `robots/fr3/inertials.yaml` of https://github.com/frankarobotics/franka_description, version 1.0.1."""

REMARK = (
    "the shapes of its links are the Panda's; chain, flange and hand are the same, limits and masses those that Franka "
    "publishes for the FR3"
)
"""Assumption about the Franka Research 3, for the user."""


def make_fr3(root: ElementTree.Element) -> None:
    """Give the links of the Panda's URDF the masses of the Franka Research 3."""
    for link in root.findall("link"):
        if (numbers := INERTIALS.get(str(link.get("name")))) is not None:
            for inertial in link.findall("inertial"):
                link.remove(inertial)
            add_inertial(link, *map(repr, numbers))


def add_inertial(link: ElementTree.Element, mass: str, x: str, y: str, z: str, *inertia: str) -> None:
    """Add mass [kg], centre of mass [m] and inertia xx, xy, xz, yy, yz, zz about it [kg m^2] to a link of a URDF."""
    element = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(element, "origin", xyz=f"{x} {y} {z}", rpy="0 0 0")
    ElementTree.SubElement(element, "mass", value=mass)
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    ElementTree.SubElement(element, "inertia", dict(zip(names, inertia, strict=True)))
