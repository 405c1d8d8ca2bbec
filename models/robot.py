"""A seven-joint arm as the rest of the program knows it: where its files lie, what its parts are called, its limits."""

from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array

N_JOINTS = 7
"""Moving joints between base and tool of every arm that can be judged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Robot:
    """Names, files and limits; those of positions and speeds are the URDF's and left to Drake."""

    name: str
    urdf: Path
    """A URDF that Drake can load: meshes are .obj."""
    base_link: str
    """Frame B."""
    tcp_link: str
    """Frame G."""
    hand_link: str
    """Frame H, the link the gripper's body belongs to."""
    joints: tuple[str, ...]
    """The seven moving joints from base to tool, base first."""
    finger_joints: tuple[str, ...]
    """Joints beyond them, such as the fingers'; each opens by half of the gap between the pads."""
    links: tuple[str, ...]
    """Links of interest, base first."""
    rest_q: Array
    """(7,) posture [rad] to start from where there is a choice."""
    effort_limits: Array
    """(7,) greatest joint torques [N m]."""
    acceleration_limits: Array | None
    """(7,) greatest joint accelerations [rad/s^2]; None where unpublished."""
    jerk_limits: Array | None
    """(7,) greatest joint jerks [rad/s^3]; None where unpublished."""
    allowed_pairs: frozenset[frozenset[str]] | None
    """Pairs of links whose contact is not looked for, as the robot's SRDF has them.

    Links that a joint connects are never looked at, nor are links without an arm joint between them, such as two
    fingers. None: nor are those that touch with every joint in the middle of its range."""
    remarks: tuple[str, ...] = ()
    """What was assumed or left out when the robot was read, a line each, for the user to see."""

    def __post_init__(self) -> None:
        """Check the number of joints."""
        if len(self.joints) != N_JOINTS:
            raise InputError(
                f"{self.name}: {len(self.joints)} moving joints between {self.base_link} and {self.tcp_link}, "
                f"expected {N_JOINTS}"
            )
