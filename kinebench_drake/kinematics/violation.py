"""Violations of the robot's limits by a motion."""

from dataclasses import dataclass
from enum import Enum

from kinebench_drake.io.jsonl import Json


class ViolationKind(Enum):
    """Limit of the robot that a motion breaks."""

    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    SELF_COLLISION = "self_collision"
    TABLE_COLLISION = "table_collision"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    TORQUE = "torque"
    DISCONTINUITY = "discontinuity"


COLLISIONS = (ViolationKind.SELF_COLLISION, ViolationKind.TABLE_COLLISION)
RATES = (ViolationKind.VELOCITY, ViolationKind.ACCELERATION, ViolationKind.JERK)
"""Limits of the first, second and third derivative of the joint angles (`ArmPlant.rate_limits`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """One limit broken over a range of frames."""

    kind: ViolationKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    joint: str | None
    """Name of the joint, such as panda_joint4; None if it concerns no single joint."""
    value: float
    """Worst value in the unit of the kind: position error [m] (unreachable), angle [rad] (joint_limit), ..."""
    limit: float
    """Greatest allowed value, or the least for a lower joint limit or a distance; in the unit of the value."""

    @classmethod
    def at(cls, kind: ViolationKind, frame: int, joint: str | None, value: float, limit: float) -> "Violation":
        """Return the violation at one frame."""
        return cls.of_run(kind, slice(frame, frame + 1), joint, value, limit)

    @classmethod
    def of_run(cls, kind: ViolationKind, run: slice, joint: str | None, value: float, limit: float) -> "Violation":
        """Return the violation over a run of frames (`segments.segments`)."""
        return cls(kind=kind, frame_start=run.start, frame_end=run.stop - 1, joint=joint, value=value, limit=limit)

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
