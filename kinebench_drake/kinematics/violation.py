"""Violations of the robot's limits by a motion."""

from dataclasses import dataclass
from enum import Enum

from kinebench_drake.io.jsonl import Json


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
    """One limit broken over a range of frames."""

    kind: ViolationKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    joint: str | None
    """Name of the joint, such as panda_joint4; None if it concerns no single joint."""
    value: float
    """Worst value in `unit`: position error (unreachable), angle (joint_limit), ..."""
    limit: float
    """Greatest allowed value, or the least for a lower joint limit or a distance; in `unit`."""
    unit: str
    pair: tuple[str, str] | None = None
    """Link, and the obstacle that it meets; None of other kinds."""

    @property
    def rank(self) -> tuple[int, int, int, str]:
        """Sort key: by cause, within a kind by frame."""
        return _CAUSES.index(self.kind), self.frame_start, self.frame_end, self.joint or " ".join(self.pair or ())

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
        pair: tuple[str, str] | None = None,
    ) -> "Violation":
        """Return the violation over a run of frames (`segments.segments`); its unit is that of the kind if None."""
        return cls(
            kind=kind,
            frame_start=run.start,
            frame_end=run.stop - 1,
            joint=joint,
            value=value,
            limit=limit,
            unit=unit or UNITS[kind],
            pair=pair,
        )

    def to_json(self) -> dict[str, Json]:
        """Serialize into an entry of `violations` of samples.jsonl."""
        return {
            "kind": self.kind.value,
            "frame_start": int(self.frame_start),
            "frame_end": int(self.frame_end),
            "joint": self.joint,
            "value": float(self.value),
            "limit": float(self.limit),
            "unit": self.unit,
            **({} if self.pair is None else {"link": self.pair[0], "body": self.pair[1]}),
        }

    def __getitem__(self, key: str) -> Json:
        """Return a field by its key in samples.jsonl, so that results and rows are read alike."""
        return self.to_json()[key]
