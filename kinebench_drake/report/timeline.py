"""Faults of a sample over its frames: violations, visual anomalies, frames that are not tracked or doubtful."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.row import SampleRow
from kinebench_drake.track import GripperTrack

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


def anomalies_of(row: SampleRow) -> list[Mapping[str, Json]]:
    """Return the row's visual anomalies that have kind, frames and a numeric severity (or none)."""
    anomalies = row.metrics.get("anomalies")
    if not isinstance(anomalies, Sequence) or isinstance(anomalies, str):
        return []
    return [
        a
        for a in anomalies
        if isinstance(a, Mapping)
        and isinstance(a.get("kind"), str)
        and all(isinstance(a.get(key), int) for key in ("frame_start", "frame_end"))
        and isinstance(a.get("severity"), int | float | None)
    ]


def fault_lanes(row: SampleRow, track: GripperTrack) -> list[FaultLane]:
    """List the faults of a sample, a lane per kind: violations, visual anomalies, lost frames, doubtful frames."""
    lanes = []
    for category, marks in ((VIOLATION, row.violations), (ANOMALY, anomalies_of(row))):
        for kind in dict.fromkeys(str(mark.get("kind")) for mark in marks):
            frames = _cover((mark for mark in marks if mark.get("kind") == kind), len(track.t_s))
            lanes.append(FaultLane(label=kind.replace("_", " "), category=category, frames=frames))
    tracked = track.tracked.astype(bool)
    lanes.append(FaultLane(label="not tracked", category=LOST, frames=~tracked))
    lanes.append(FaultLane(label="doubtful", category=DOUBTFUL, frames=tracked & (track.confidence < MIN_CONFIDENCE)))
    return [lane for lane in lanes if lane.frames.any()]


def _cover(marks: Iterable[Mapping[str, Json]], n: int) -> NDArray[np.bool_]:
    """Return which of n frames any of some violations or anomalies covers."""
    covered = np.zeros(n, dtype=bool)
    for mark in marks:
        start = mark.get("frame_start")
        end = mark.get("frame_end")
        if isinstance(start, int) and isinstance(end, int):
            covered[max(start, 0) : max(end + 1, 0)] = True
    return covered
