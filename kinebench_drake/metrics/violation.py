"""What a track asks of the robot that it cannot do."""

from dataclasses import dataclass
from enum import Enum


class ViolationKind(Enum):
    """What a track asks of the robot that it cannot do."""

    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    SELF_COLLISION = "self_collision"
    TABLE_COLLISION = "table_collision"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    TORQUE = "torque"
    DISCONTINUITY = "discontinuity"


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """One limit broken over a range of frames."""

    kind: ViolationKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    joint: str | None
    """Name of the joint, such as panda_joint4; None if no single joint is at fault."""
    value: float
    """The worst value: distance left to the pose [m] (unreachable), angle [rad] (joint_limit), and so on by kind."""
    limit: float
    """What the value may be at most, or at least for a lower joint limit; in the value's unit."""
