"""Result of an anomaly detector, and operations on per-frame series that detectors share."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import grey_opening

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.segments import segments


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """Result of one detector on one video."""

    kind: AnomalyKind
    score: Array
    """(T,) evidence over its threshold: an anomaly from 1 on; 0 where there is no evidence."""
    anomalies: tuple[Anomaly, ...] = ()

    @classmethod
    def from_score(cls, kind: AnomalyKind, score: Array, size: Array) -> "Detection":
        """Return an anomaly for each run of frames whose `score` (T,) is at least 1.

        Its severity is the largest `size` (T,) of its frames.
        """
        anomalies = tuple(
            Anomaly(kind=kind, frame_start=run.start, frame_end=run.stop - 1, severity=float(size[run].max()))
            for run in segments(score >= 1.0)
        )
        return cls(kind=kind, score=score, anomalies=anomalies)

    @property
    def peak(self) -> float:
        """Largest score of a frame."""
        return float(self.score.max(initial=0.0))

    def beyond(self, spread: float) -> "Detection":
        """Return the detection with those anomalies alone whose score exceeds its bound by a relative `spread`."""
        sure = tuple(
            anomaly
            for anomaly in self.anomalies
            if self.score[anomaly.frame_start : anomaly.frame_end + 1].max() >= 1.0 + spread
        )
        return replace(self, anomalies=sure)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnomalyDetections:
    """Results of all detectors on one video."""

    by_kind: Mapping[AnomalyKind, Detection]
    """Detections with the anomalies beyond the spread."""
    spread: float = 0.0
    """Relative difference of scores between number formats."""

    def __post_init__(self) -> None:
        """Check that every kind has a finite score.

        Raises:
            InputError: a kind is missing, or its score is not finite.
        """
        for kind in AnomalyKind:
            if kind not in self.by_kind or not np.isfinite(self.by_kind[kind].score).all():
                raise InputError(f"no finite score of {kind.value}; expected one for each kind of anomaly")

    @property
    def anomalies(self) -> tuple[Anomaly, ...]:
        """All anomalies in the order of their frames."""
        anomalies = [anomaly for detection in self.by_kind.values() for anomaly in detection.anomalies]
        return tuple(sorted(anomalies, key=lambda a: (a.frame_start, a.frame_end, a.kind.value)))

    @property
    def open_kinds(self) -> tuple[AnomalyKind, ...]:
        """Kinds about which the measurements leave it open whether they occur."""
        return tuple(
            kind
            for kind, detection in self.by_kind.items()
            if not detection.anomalies and detection.peak * (1.0 + self.spread) >= 1.0
        )

    @property
    def scores(self) -> dict[AnomalyKind, float]:
        """Score of the video by kind: the largest of its frames, 1 at the threshold."""
        return {kind: detection.peak for kind, detection in self.by_kind.items()}


def sustained(values: ArrayLike, frames: int) -> Array:
    """Return for each frame (T,) the largest value that `frames` consecutive frames around it all reach; NaN is 0.

    A grey opening (Serra 1982): shorter peaks are removed, longer ones stay.
    """
    values = np.nan_to_num(np.asarray(values, dtype=np.float64), nan=0.0)
    opened = np.asarray(grey_opening(np.pad(values, frames), size=frames)[frames:-frames])
    return opened if len(values) >= frames else np.zeros(len(values))


def finite_median(values: ArrayLike, window: int) -> Array:
    """Return the running median (T,) over `window` frames; NaN where fewer than half of them are finite."""
    values = np.asarray(values, dtype=np.float64)
    half = window // 2
    smoothed = np.full(len(values), np.nan)
    for i in range(len(values)):
        near = values[max(0, i - half) : i + half + 1]
        near = near[np.isfinite(near)]
        if len(near) > half:
            smoothed[i] = np.median(near)
    return smoothed
