"""Description of an arm: files, names of links and joints, limits."""

from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.geometry import Array
from kinebench_drake.models.joint_limits import JointLimits

N_JOINTS = 7
"""Number of joints of the Panda."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Robot:
    """Names, files and limits of an arm. Limits, tool and payload stand in its URDF, from which all of this is read."""

    name: str
    urdf: Path
    """URDF that Drake can load, with .obj meshes."""
    base_link: str
    """Frame B."""
    tcp_link: str
    """Frame G."""
    hand_link: str
    """Frame H, the link of the gripper's body."""
    joints: tuple[str, ...]
    """Moving joints from base to tool, base first."""
    finger_joints: tuple[str, ...]
    """Prismatic joints of the gripper; each opens by half the gap between the pads."""
    finger_signs: tuple[float, ...]
    """For each finger 1 if it opens towards its upper limit, -1 if towards its lower one."""
    links: tuple[str, ...]
    """Links whose poses are reported, base first."""
    rest_q: Array
    """(J,) rest posture [rad], the default start of searches."""
    limits: JointLimits
    """Limits of the joints."""
    allowed_pairs: frozenset[frozenset[str]] | None
    """Pairs of links excluded from contact checks, as in the robot's SRDF.

    Links connected by a joint, or without an arm joint between them, such as two fingers, are always excluded. None:
    also those in contact with every joint in the middle of its range."""
    columns: tuple[str, ...] = ()
    """Names of the joints in data sets; empty if they are those of `joints`."""
    remarks: tuple[str, ...] = ()
    """Assumptions and omissions when the robot was read, one line each, for the user."""

    @property
    def column_names(self) -> tuple[str, ...]:
        """Names of the joints in data sets, base first."""
        return self.columns or self.joints

    @property
    def id(self) -> str:
        """Name and hash of all that defines the robot: URDF, meshes, SRDF, limits, tool, payload."""
        return self.urdf.parent.name
