"""What a row says of each frame of its track: the state to colour it by, and how near every joint is to its limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.types import IkStatus, Json

N_JOINTS = 7

SURE = 0.5
"""Confidence below which a pose is doubtful."""


class FrameState(Enum):
    """How a frame of a track is judged, by rising precedence."""

    OK = "ok"
    DOUBT = "doubt"
    """A limit is exceeded, or the pose missed, by no more than noise explains; or the pose itself is doubtful."""
    UNTRACKED = "untracked"
    BROKEN = "broken"
    """A violation covers it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointLimits:
    """The limits that a track was held against, in the order of its joints; None where a row names none."""

    joints: tuple[str, ...]
    position: tuple[Array, Array] | None
    """(7,) lower and upper limits [rad]."""
    rates: Mapping[str, Array]
    """(7,) greatest magnitudes by curve: `velocity` [rad/s], `acceleration` [rad/s^2], `jerk` [rad/s^3], `torque`
    [N m]."""


def joint_limits(row: SampleRow) -> JointLimits:
    """The limits of a row's `details`."""
    found = row.details.get("limits")
    limits = found if isinstance(found, Mapping) else {}
    position = limits.get("position")
    ends = [_seven(position.get(end)) if isinstance(position, Mapping) else None for end in ("lower", "upper")]
    names = limits.get("joints", row.details.get("joints"))
    if not isinstance(names, Sequence) or isinstance(names, str) or len(names) != N_JOINTS:
        names = [f"joint {k + 1}" for k in range(N_JOINTS)]
    rates = {name: _seven(limits.get(name)) for name in ("velocity", "acceleration", "jerk", "torque")}
    return JointLimits(
        joints=tuple(str(name) for name in names),
        position=(ends[0], ends[1]) if ends[0] is not None and ends[1] is not None else None,
        rates={name: limit for name, limit in rates.items() if limit is not None},
    )


def limit_ratios(file: TrackFile, limits: JointLimits) -> dict[str, Array]:
    """Each joint's magnitude over its limit (T, 7) by curve, of the curves that have one; NaN where unknown."""
    return {
        name: np.abs(file.curves[name]) / limit
        for name, limit in limits.rates.items()
        if name in file.curves and file.curves[name].ndim == 2
    }


def frames_of(marks: Sequence[Mapping[str, Json]], n: int) -> NDArray[np.bool_]:
    """Frames (n,) that any of some violations or anomalies covers."""
    covered = np.zeros(n, dtype=bool)
    for mark in marks:
        start, end = mark.get("frame_start"), mark.get("frame_end")
        if isinstance(start, int) and isinstance(end, int):
            covered[max(start, 0) : max(end + 1, 0)] = True
    return covered


def anomalies_of(row: SampleRow) -> list[Mapping[str, Json]]:
    """The row's visual anomalies."""
    found = row.metrics.get("anomalies")
    if not isinstance(found, Sequence) or isinstance(found, str):
        return []
    return [a for a in found if isinstance(a, Mapping) and _is_anomaly(a)]


def _is_anomaly(found: Mapping[str, Json]) -> bool:
    """Whether an object has what pages show of anomalies."""
    frames = (found.get("frame_start"), found.get("frame_end"))
    severity = found.get("severity")
    return (
        isinstance(found.get("kind"), str)
        and all(isinstance(frame, int) for frame in frames)
        and (severity is None or isinstance(severity, int | float))
    )


def frame_states(row: SampleRow, file: TrackFile) -> tuple[FrameState, ...]:
    """State of each of the T frames."""
    track, n = file.track, len(file.track.t_s)
    doubt = frames_of(anomalies_of(row), n) | (track.confidence < SURE)
    for ratio in limit_ratios(file, joint_limits(row)).values():
        doubt |= (np.nan_to_num(ratio) > 1.0).any(axis=-1)
    for name in ("joint_margin", "self_distance_m", "table_distance_m"):
        if name in file.curves:
            doubt |= np.nan_to_num(file.curves[name]) < 0.0
    if file.status is not None:
        doubt |= np.array([s not in (IkStatus.OK, IkStatus.NOT_TRACKED) for s in file.status], dtype=bool)
    broken = frames_of(row.violations, n)
    states = np.full(n, FrameState.OK, dtype=object)
    for mask, state in ((doubt, FrameState.DOUBT), (~track.tracked, FrameState.UNTRACKED), (broken, FrameState.BROKEN)):
        states[mask] = state
    return tuple(states)


def _seven(value: Json) -> Array | None:
    """Seven numbers, infinite where null; None if it is anything else."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != N_JOINTS:
        return None
    if not all(v is None or isinstance(v, int | float) for v in value):
        return None
    return np.array([np.inf if v is None else v for v in value], dtype=np.float64)
