"""Whether a confidence means what it says: the reliability curve and the expected calibration error.

Bins of equal width; the error is the mean distance between confidence and share of good frames, weighted by the frames
of each bin (Guo et al., On Calibration of Modern Neural Networks, ICML 2017).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.confidence import GOOD_M, GOOD_RAD
from kinebench_drake.grounding.evaluation.errors import ClipErrors
from kinebench_drake.stats import wilson

BINS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Bin:
    """The frames whose confidence lies in one interval."""

    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""
    frames: int
    confidence: float
    """Mean confidence."""
    good: float
    """Share of frames within 10 mm and 5 degrees."""
    good_low: float
    """Lower end of the share's 95 % interval (Wilson 1927), frames taken as independent."""
    good_high: float
    """Upper end likewise."""

    def to_json(self) -> dict[str, Any]:
        """A JSON object of it."""
        return {name: round(value, 5) for name, value in asdict(self).items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Reliability:
    """The reliability curve over the tracked frames: only these come with a pose to be judged."""

    bins: tuple[Bin, ...]
    """Bins that hold frames, in increasing order."""
    error: float
    """Expected calibration error, 0..1; NaN without a frame."""


def judged_frames(results: Sequence[ClipErrors]) -> tuple[Array, NDArray[np.bool_]]:
    """Confidence (n,) of all tracked frames and whether they are good; a gripper seen where none is, never is."""
    confidence = [e.confidence[e.tracked] for e in results]
    good = [((e.position_m <= GOOD_M) & (e.rotation_rad <= GOOD_RAD))[e.tracked] for e in results]
    return np.concatenate(confidence), np.concatenate(good)


def reliability(confidence: Array, good: NDArray[np.bool_]) -> Reliability:
    """The curve of frames with `confidence` (n,) in 0..1, of which `good` (n,) are right."""
    number = np.minimum((confidence * BINS).astype(int), BINS - 1)
    bins = []
    for i in range(BINS):
        inside = number == i
        n = int(inside.sum())
        if n:
            share = float(good[inside].mean())
            low, high = wilson(int(good[inside].sum()), n)
            mean = float(confidence[inside].mean())
            bins.append(
                Bin(low=i / BINS, high=(i + 1) / BINS, frames=n, confidence=mean, good=share, good_low=low,
                    good_high=high)
            )  # fmt: skip
    total = sum(b.frames for b in bins)
    error = sum(b.frames * abs(b.confidence - b.good) for b in bins) / total if total else float("nan")
    return Reliability(bins=tuple(bins), error=error)
