"""Violations: limits of the robot that a track breaks."""

from dataclasses import dataclass
from enum import Enum

from kinebench_drake.types import Json


class ViolationKind(Enum):
    """Kind of limit that a track breaks."""

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
    """Joint, such as panda_joint4; None if no single joint is at fault."""
    value: float
    """Worst value: remaining distance to the pose [m] (unreachable), angle [rad] (joint_limit), and so on by kind."""
    limit: float
    """Greatest allowed value (for a lower joint limit: the least), in the unit of `value`."""

    def to_json(self) -> dict[str, Json]:
        """Serialize into an entry of `violations` of samples.jsonl."""
        return {
            "kind": self.kind.value,
            "frame_start": int(self.frame_start),
            "frame_end": int(self.frame_end),
            "joint": self.joint,
            "value": float(self.value),
            "limit": float(self.limit),
        }

    def __getitem__(self, key: str) -> Json:
        """Return a field by its key in samples.jsonl, so that results and rows are read alike."""
        return self.to_json()[key]
