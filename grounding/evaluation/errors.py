"""How the grounding of one clip differs from its truth, frame by frame."""

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.evaluation.clip import TruthClip
from kinebench_drake.grounding.pipeline import GroundingResult
from kinebench_drake.types import Anomaly, AnomalyKind

Value = TypeVar("Value")
_RSS_UNIT_MB = 2**20 if sys.platform == "darwin" else 2**10  # of ru_maxrss in a megabyte


@dataclass(frozen=True, slots=True, kw_only=True)
class Expense:
    """What the grounding of one clip cost."""

    wall_s: float
    """Time on the clock, decoding included [s]."""
    cpu_s: float
    """Time of the processor, all threads together [s]: tells more than the clock on a busy machine."""
    peak_mb: float
    """Most memory that the process has held so far [MiB]."""

    def to_json(self) -> dict[str, float]:
        """A JSON object of it."""
        return {name: round(value, 3) for name, value in asdict(self).items()}


def metered(work: Callable[[], Value]) -> tuple[Value, Expense]:
    """What `work` returns, and what it cost."""
    wall, cpu = time.perf_counter(), time.process_time()
    value = work()
    return value, Expense(
        wall_s=time.perf_counter() - wall,
        cpu_s=time.process_time() - cpu,
        peak_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _RSS_UNIT_MB,
    )


FLIP_RAD = np.pi / 2
"""A rotation error beyond this is the other reading of the gripper."""
LASTING_FRAMES = 3
"""Tracked frames in a row in the other reading that make a lasting flip."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipErrors:
    """How the grounding of one clip differs from its truth."""

    id: str
    task: str
    """Plain task id; empty where unknown."""
    position_m: Array
    """(T,) position error of panda_hand [m]; NaN where not tracked or not there."""
    rotation_rad: Array
    """(T,) rotation error [rad]; NaN likewise."""
    width_m: Array
    """(T,) gap between the pads as seen [m]; NaN where unknown."""
    true_width_m: Array
    """(T,) the true gap [m]; NaN where the gripper is not there."""
    tracked: NDArray[np.bool_]
    """(T,)."""
    confidence: Array
    """(T,) 0..1."""
    visible: NDArray[np.bool_]
    """(T,) frames in which the gripper is there."""
    share: Array
    """(T,) part of the gripper's outline that the picture shows, 0..1; NaN where not measured."""
    found: tuple[Anomaly, ...]
    planted: tuple[Anomaly, ...]
    expense: Expense

    @property
    def finger_m(self) -> Array:
        """(T,) error of the finger opening [m]; NaN where it or the truth is unknown."""
        return np.asarray(np.abs(self.width_m - self.true_width_m))

    @property
    def tracked_fraction(self) -> float:
        """Tracked frames over frames with a gripper; NaN without any."""
        return float(self.tracked[self.visible].mean()) if self.visible.any() else float("nan")

    @property
    def wall_s(self) -> float:
        """Time of the grounding, decoding included [s]."""
        return self.expense.wall_s

    @property
    def flips(self) -> list[int]:
        """Lengths of the runs of tracked frames in the other reading; frames not tracked neither end nor lengthen one.

        Rotations are told apart at 90 degrees: the readings are 180 degrees apart.
        """
        runs, run = [], 0
        for angle in self.rotation_rad[np.isfinite(self.rotation_rad)]:
            if angle > FLIP_RAD:
                run += 1
            elif run:
                runs.append(run)
                run = 0
        return [*runs, run] if run else runs

    @property
    def longest_flip(self) -> int:
        """Longest run of tracked frames in the other reading."""
        return max(self.flips, default=0)

    def to_json(self) -> dict[str, Any]:
        """A JSON object of it, numbers rounded to what a measurement can tell."""
        return {
            "id": self.id,
            "task": self.task,
            "position_m": _numbers(self.position_m, 7),
            "rotation_rad": _numbers(self.rotation_rad, 6),
            "width_m": _numbers(self.width_m, 6),
            "true_width_m": _numbers(self.true_width_m, 6),
            "tracked": self.tracked.astype(int).tolist(),
            "confidence": _numbers(self.confidence, 4),
            "visible": self.visible.astype(int).tolist(),
            "share": _numbers(self.share, 3),
            "found": [_anomaly(a) for a in self.found],
            "planted": [_anomaly(a) for a in self.planted],
            "expense": self.expense.to_json(),
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "ClipErrors":
        """The inverse of `to_json`.

        Raises:
            KeyError: something is missing.
        """
        names = ("position_m", "rotation_rad", "width_m", "true_width_m", "confidence", "share")
        return cls(
            id=data["id"],
            task=data["task"],
            **{name: np.array(data[name], dtype=np.float64) for name in names},
            tracked=np.array(data["tracked"], dtype=bool),
            visible=np.array(data["visible"], dtype=bool),
            found=tuple(_read_anomaly(a) for a in data["found"]),
            planted=tuple(_read_anomaly(a) for a in data["planted"]),
            expense=Expense(**data["expense"]),
        )


def compare(clip: TruthClip, grounding: GroundingResult, expense: Expense, share: Array | None = None) -> ClipErrors:
    """Hold a grounding against the truth; `share` (T,) is the part of the gripper that each frame shows.

    Frames whose pose was given are nobody's merit: they are left out, as if nothing were there to be seen.
    """
    given = grounding.from_prior
    position, rotation = pose_difference(clip.X_CH, grounding.track.X_CH)
    return ClipErrors(
        id=clip.id,
        task=clip.task,
        position_m=np.where(given, np.nan, position),
        rotation_rad=np.where(given, np.nan, rotation),
        width_m=grounding.track.finger_width_m,
        true_width_m=clip.finger_width_m,
        tracked=grounding.track.tracked & ~given,
        confidence=grounding.track.confidence,
        visible=np.asarray(np.isfinite(clip.X_CH).all(axis=(1, 2)) & ~given),
        share=np.full(len(clip.t_s), np.nan) if share is None else np.where(given, np.nan, share),
        found=grounding.anomalies,
        planted=clip.faults,
        expense=expense,
    )


def _numbers(values: Array, digits: int) -> list[float | None]:
    return [round(v, digits) if np.isfinite(v) else None for v in values.tolist()]


def _anomaly(anomaly: Anomaly) -> dict[str, Any]:
    return {
        "kind": anomaly.kind.value,
        "frame_start": anomaly.frame_start,
        "frame_end": anomaly.frame_end,
        "severity": float(anomaly.severity),
    }


def _read_anomaly(data: dict[str, Any]) -> Anomaly:
    return Anomaly(**{**data, "kind": AnomalyKind(data["kind"])})
