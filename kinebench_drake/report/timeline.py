"""Faults of a sample over its frames: violations, visual anomalies, frames that are not tracked or doubtful."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.results.row import SampleRow
from kinebench_drake.track import GripperTrack
from kinebench_drake.violation import Violation

MIN_CONFIDENCE = 0.5
"""Confidence below which a pose is doubtful."""
SEVERITY_UNITS = {
    AnomalyKind.VANISH.value: "frames",
    AnomalyKind.DUPLICATE.value: "of a gripper",
    AnomalyKind.TELEPORT.value: "m",
    AnomalyKind.FREEZE.value: "frames",
    AnomalyKind.CAMERA.value: "px",
    AnomalyKind.FINGERS.value: "m",
}
"""Unit of the severity by kind of anomaly; that of the others is relative."""
VIOLATION = "violation"
ANOMALY = "anomaly"
LOST = "lost"
DOUBTFUL = "doubtful"


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultLane:
    """All frames of one fault."""

    label: str
    category: str
    """VIOLATION, ANOMALY, LOST or DOUBTFUL."""
    frames: NDArray[np.bool_]
    """(T,) True at frames with the fault."""


def fault_lanes(row: SampleRow, track: GripperTrack) -> list[FaultLane]:
    """List the faults of a sample, a lane per kind: violations, visual anomalies, lost frames, doubtful frames."""
    lanes = []
    faults: tuple[tuple[str, Sequence[Violation | Anomaly]], ...] = (
        (VIOLATION, row.violations),
        (ANOMALY, row.anomalies),
    )
    for category, marks in faults:
        for kind, own in group_by(marks, lambda mark: mark.kind.value).items():
            lanes.append(
                FaultLane(label=kind.replace("_", " "), category=category, frames=covered(own, len(track.t_s)))
            )
    tracked = track.tracked.astype(bool)
    lanes.append(FaultLane(label="not tracked", category=LOST, frames=~tracked))
    lanes.append(FaultLane(label="doubtful", category=DOUBTFUL, frames=tracked & (track.confidence < MIN_CONFIDENCE)))
    return [lane for lane in lanes if lane.frames.any()]


def covered(marks: Iterable[Violation | Anomaly], n: int, margin: int = 0) -> NDArray[np.bool_]:
    """Return which of n frames are in, or at most `margin` frames from, any of some violations or anomalies."""
    frames = np.zeros(n, dtype=bool)
    for mark in marks:
        frames[max(mark.frame_start - margin, 0) : max(mark.frame_end + 1 + margin, 0)] = True
    return frames
