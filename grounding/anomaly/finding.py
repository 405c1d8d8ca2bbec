"""What a detector says."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.products import Anomaly, AnomalyKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
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
class Findings:
    """All kinds of anomalies in one video."""

    findings: Mapping[AnomalyKind, Finding]

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
