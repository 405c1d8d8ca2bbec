"""Violations of the robot's limits by a motion."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum


class ViolationKind(Enum):
    """Limit of the robot that a motion breaks, causes before what follows from them."""

    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    SELF_COLLISION = "self_collision"
    TABLE_COLLISION = "table_collision"
    OBSTACLE_COLLISION = "obstacle_collision"
    DISCONTINUITY = "discontinuity"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    TORQUE = "torque"


COLLISIONS = (ViolationKind.SELF_COLLISION, ViolationKind.TABLE_COLLISION)
RATES = (ViolationKind.VELOCITY, ViolationKind.ACCELERATION, ViolationKind.JERK)
"""Limits of the first, second and third derivative of the joint angles (`ArmPlant.rate_limits`)."""
UNITS = {
    ViolationKind.UNREACHABLE: "m",
    ViolationKind.JOINT_LIMIT: "rad",
    ViolationKind.SELF_COLLISION: "m",
    ViolationKind.TABLE_COLLISION: "m",
    ViolationKind.OBSTACLE_COLLISION: "m",
    ViolationKind.DISCONTINUITY: "m",
    ViolationKind.VELOCITY: "rad/s",
    ViolationKind.ACCELERATION: "rad/s^2",
    ViolationKind.JERK: "rad/s^3",
    ViolationKind.TORQUE: "N m",
}
"""Unit of value and limit; of a discontinuity that is no jump of a position it is rad."""
_CAUSES = list(ViolationKind)


@dataclass(frozen=True, slots=True, kw_only=True)
class Violation:
    """One limit broken over a range of frames; an entry of `violations` of samples.jsonl."""

    kind: ViolationKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    joint: str | None
    """Name of the joint, such as panda_joint4; None if it concerns no single joint."""
    value: float
    """Worst value in `unit`: position error (unreachable), angle (joint_limit), ...; NaN where a file has null."""
    limit: float
    """Greatest allowed value, or the least for a lower joint limit or a distance; in `unit`."""
    unit: str
    link: str | None = None
    """Link that meets an obstacle or the other arm; None of other kinds."""
    body: str | None = None
    """Obstacle, or link of the other arm, that the link meets; None of other kinds."""
    arm: str | None = None
    """Arm of two, left or right; None of one arm, and where both collide."""
    unknown: Mapping[str, object] = field(default_factory=dict, repr=False)
    """Keys that a newer version added to the entry."""

    @property
    def rank(self) -> tuple[int, int, int, str]:
        """Sort key: by cause, within a kind by frame."""
        parts = self.joint or f"{self.link or ''} {self.body or ''}".strip()
        return _CAUSES.index(self.kind), self.frame_start, self.frame_end, f"{self.arm or ''}{parts}"

    @classmethod
    def at(cls, kind: ViolationKind, frame: int, joint: str | None, value: float, limit: float) -> "Violation":
        """Return the violation at one frame."""
        return cls.of_run(kind, slice(frame, frame + 1), joint, value, limit)

    @classmethod
    def of_run(
        cls,
        kind: ViolationKind,
        run: slice,
        joint: str | None,
        value: float,
        limit: float,
        unit: str | None = None,
        *,
        link: str | None = None,
        body: str | None = None,
    ) -> "Violation":
        """Return the violation over a run of frames (`segments.segments`); its unit is that of the kind if None."""
        return cls(
            kind=kind,
            frame_start=int(run.start),
            frame_end=int(run.stop) - 1,
            joint=joint,
            value=float(value),
            limit=float(limit),
            unit=unit or UNITS[kind],
            link=link,
            body=body,
        )
