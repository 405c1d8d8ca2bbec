"""What a detector says."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import grey_opening

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.segments import segments
from kinebench_drake.types import Anomaly, AnomalyKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """One kind of anomaly in one video."""

    kind: AnomalyKind
    score: Array
    """(T,) how strongly each frame speaks for it, over the threshold: from 1 on it is an anomaly. 0 where nothing can
    be said."""
    anomalies: tuple[Anomaly, ...] = ()
    """Where it is one."""

    @property
    def peak(self) -> float:
        """The video's score: that of its worst frame."""
        return float(self.score.max(initial=0.0))

    def within(self, start: int, end: int) -> float:
        """The score of the frames from `start` to `end`, both included."""
        return float(self.score[start : end + 1].max(initial=0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class AnomalyDetections:
    """All kinds of anomalies in one video."""

    findings: Mapping[AnomalyKind, Detection]

    def __post_init__(self) -> None:
        """Check that all kinds are there and that their scores are finite.

        Raises:
            InputError: one is missing, or its score is not a number.
        """
        for kind in AnomalyKind:
            if kind not in self.findings or not np.isfinite(self.findings[kind].score).all():
                raise InputError(f"no finite score of {kind.value}; expected one for each kind of anomaly")

    @property
    def anomalies(self) -> tuple[Anomaly, ...]:
        """All of them, in the order of their frames."""
        found = [anomaly for finding in self.findings.values() for anomaly in finding.anomalies]
        return tuple(sorted(found, key=lambda a: (a.frame_start, a.frame_end, a.kind.value)))

    @property
    def scores(self) -> dict[AnomalyKind, float]:
        """The video's score of each kind: its worst frame's, 1 at the threshold."""
        return {kind: finding.peak for kind, finding in self.findings.items()}


def detection_segments(flags: ArrayLike) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true values."""
    yield from ((run.start, run.stop - 1) for run in segments(np.asarray(flags, dtype=bool)))


def sustained(values: ArrayLike, frames: int) -> Array:
    """(T,) at each frame the largest value that some `frames` frames in a row around it all reach; unknown ones are 0.

    A grey opening (Serra 1982): peaks shorter than that are levelled, longer ones stay.
    """
    values = np.nan_to_num(np.asarray(values, dtype=np.float64), nan=0.0)
    if len(values) < frames:
        return np.zeros(len(values))
    padded = np.pad(values, frames)
    return np.asarray(grey_opening(padded, size=frames)[frames:-frames])


def finite_median(values: ArrayLike, window: int) -> Array:
    """(T,) running median of what is known in `window` frames around each; NaN where less than half of them is."""
    values = np.asarray(values, dtype=np.float64)
    half = window // 2
    smoothed = np.full(len(values), np.nan)
    for i in range(len(values)):
        near = values[max(0, i - half) : i + half + 1]
        near = near[np.isfinite(near)]
        if len(near) > half:
            smoothed[i] = np.median(near)
    return smoothed


def is_known(values: ArrayLike) -> NDArray[np.bool_]:
    """(T,) whether all of a frame's values (T,) or (T, n) are there."""
    finite = np.isfinite(np.asarray(values, dtype=np.float64))
    return np.asarray(finite if finite.ndim == 1 else finite.all(axis=1))
