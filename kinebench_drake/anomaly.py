"""Anomalies of a video: what no real gripper shows."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
    """One anomaly over a range of frames; an entry of `anomalies` of samples.jsonl."""

    kind: AnomalyKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    severity: float
    """Measure of the kind: frames without a gripper (vanish) or frozen (freeze), share of a gripper seen twice
    (duplicate_gripper), metres jumped (teleport) or beyond what fingers can do (finger_opening), relative misfit of the
    shape (deformation), pixels moved (camera_motion)."""

    unknown: Mapping[str, object] = field(default_factory=dict, repr=False)
    """Keys that a newer version added to the entry."""

    def after(self, frames: int) -> "Anomaly":
        """Return the anomaly with its frames counted from so many frames earlier."""
        return replace(self, frame_start=frames + self.frame_start, frame_end=frames + self.frame_end)
