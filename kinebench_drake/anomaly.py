"""Anomalies of a video: what no real gripper shows."""

from dataclasses import dataclass
from enum import Enum


class AnomalyKind(Enum):
    """Kind of anomaly: something in a video that no real gripper shows."""

    VANISH = "vanish"
    DUPLICATE = "duplicate_gripper"
    TELEPORT = "teleport"
    FREEZE = "freeze"
    DEFORMATION = "deformation"
    CAMERA = "camera_motion"
    FINGERS = "finger_opening"


@dataclass(frozen=True, slots=True, kw_only=True)
class Anomaly:
    """One anomaly over a range of frames."""

    kind: AnomalyKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    severity: float
    """Measure of the kind: frames without a gripper (vanish) or frozen (freeze), share of a gripper seen twice
    (duplicate_gripper), metres jumped (teleport) or beyond what fingers can do (finger_opening), relative misfit of the
    shape (deformation), pixels moved (camera_motion)."""

    def to_json(self, first_frame: int = 0) -> dict[str, str | int | float]:
        """Serialize into an entry of `anomalies`, frames counted from `first_frame`."""
        return {
            "kind": self.kind.value,
            "frame_start": first_frame + int(self.frame_start),
            "frame_end": first_frame + int(self.frame_end),
            "severity": float(self.severity),
        }
