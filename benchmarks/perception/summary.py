"""Figures of a set of clips, with intervals over the clips.

Frames are pooled over all clips. Intervals are 95 % percentile intervals of a bootstrap that draws whole clips: errors
of frames of one clip are correlated (Efron 1979; Field and Welsh 2007, the cluster bootstrap).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.bootstrap import cluster_bootstrap
from benchmarks.perception.errors import LASTING_FRAMES, ClipErrors
from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.stats import IntervalEstimate, wilson

OFF_M = 0.03
"""Position error beyond which a tracked frame is a false track [m]."""
VISIBLE_SHARE = 0.3
"""Visible share of the gripper from which a frame is expected to be tracked."""
CLIP_FRAMES = 49
"""Frames that times are scaled to."""
MARGIN_M = 0.008
"""Distance from the open/closed threshold within which true gaps are not evaluated [m]."""
HALFWAY_M = 0.04
"""Half of the gripper's range, 0..0.08 [m]."""
BINS = 10
"""Bins of equal width of the reliability curve."""

Results = Sequence[ClipErrors]
Statistic = Callable[[Results], float]


def open_threshold(true_width_m: Array) -> float:
    """Return the gap between closed and open [m] of an episode with true gaps (T,), of which NaN are ignored."""
    finite = true_width_m[np.isfinite(true_width_m)]
    if not finite.size or finite.max() - finite.min() < 2 * MARGIN_M:
        return HALFWAY_M
    return float((finite.max() + finite.min()) / 2)


def open_is_correct(width_m: Array, true_width_m: Array) -> NDArray[np.bool_]:
    """Return whether open or closed is correct, for frames (n,) with an estimated gap and off the threshold."""
    middle = open_threshold(true_width_m)
    far = np.isfinite(width_m) & (np.abs(true_width_m - middle) > MARGIN_M)
    return np.asarray((width_m[far] > middle) == (true_width_m[far] > middle))


@dataclass(frozen=True, slots=True, kw_only=True)
class ReliabilityBin:
    """Frames whose confidence lies in one interval."""

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
    """Upper end of the same interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reliability:
    """Reliability curve of the confidence (Guo et al., On Calibration of Modern Neural Networks, ICML 2017)."""

    bins: tuple[ReliabilityBin, ...]
    """Bins that hold frames, in increasing order."""
    error: float
    """Expected calibration error, 0..1: mean of |confidence - share of good frames| weighted by the frames of a bin;
    NaN without a frame."""


def reliability(results: Results) -> Reliability:
    """Return the reliability curve of the tracked frames of clips: only these come with a pose."""
    return reliability_curve(*confidence_samples(results))


def confidence_samples(results: Results) -> tuple[Array, NDArray[np.bool_]]:
    """Return the confidence (n,) of all tracked frames and whether they are good; false tracks are not."""
    confidence = [e.confidence[e.tracked] for e in results]
    good = [((e.position_m <= bounds.GOOD_M) & (e.rotation_rad <= bounds.GOOD_RAD))[e.tracked] for e in results]
    return np.concatenate(confidence), np.concatenate(good)


def reliability_curve(confidence: Array, good: NDArray[np.bool_]) -> Reliability:
    """Return the reliability curve of frames with `confidence` (n,) in 0..1, of which `good` (n,) are right."""
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
                ReliabilityBin(low=i / BINS, high=(i + 1) / BINS, frames=n, confidence=mean, good=share, good_low=low,
                               good_high=high)
            )  # fmt: skip
    total = sum(b.frames for b in bins)
    error = sum(b.frames * abs(b.confidence - b.good) for b in bins) / total if total else float("nan")
    return Reliability(bins=tuple(bins), error=error)


def _pooled(results: Results, values: Callable[[ClipErrors], Array]) -> Array:
    """Return the finite values of all frames of all clips."""
    pooled = np.concatenate([values(e) for e in results]) if results else np.empty(0)
    return np.asarray(pooled[np.isfinite(pooled)])


def percentile(values: Array, q: float) -> float:
    """Return a percentile; NaN without values."""
    return float(np.percentile(values, q)) if values.size else float("nan")


def _spread(values: Callable[[ClipErrors], Array], q: float) -> Statistic:
    """Return the percentile of values (T,) over the tracked frames with a gripper."""
    return lambda results: percentile(_pooled(results, lambda e: values(e)[e.tracked & e.visible]), q)


def _mean(values: Callable[[ClipErrors], NDArray[np.bool_]]) -> Statistic:
    def statistic(results: Results) -> float:
        pooled = _pooled(results, lambda e: values(e).astype(float))
        return float(pooled.mean()) if pooled.size else float("nan")

    return statistic


def _false_tracks(results: Results) -> float:
    """Return the share of tracked frames that are off by more than 3 cm or show no gripper."""
    tracked = sum(int(e.tracked.sum()) for e in results)
    near = sum(int((e.position_m[e.tracked] <= OFF_M).sum()) for e in results)
    return 1.0 - near / tracked if tracked else float("nan")


def _tracked_fraction(results: Results) -> float:
    fractions = [e.tracked_fraction for e in results if e.visible.any()]
    return float(np.mean(fractions)) if fractions else float("nan")


ACCURACY: Mapping[str, Statistic] = {
    "tracked_fraction": _tracked_fraction,
    "tracked_when_seen": _mean(lambda e: e.tracked[e.share >= VISIBLE_SHARE]),
    "position_median_mm": _spread(lambda e: e.position_m * 1e3, 50),
    "position_p95_mm": _spread(lambda e: e.position_m * 1e3, 95),
    "rotation_median_deg": _spread(lambda e: np.rad2deg(e.rotation_rad), 50),
    "rotation_p95_deg": _spread(lambda e: np.rad2deg(e.rotation_rad), 95),
    "tracked_frames_off_by_3_cm": _false_tracks,
}
"""Figures of every comparison."""

MORE: Mapping[str, Statistic] = {
    "position_max_mm": _spread(lambda e: e.position_m * 1e3, 100),
    "rotation_max_deg": _spread(lambda e: np.rad2deg(e.rotation_rad), 100),
    "finger_width_median_mm": _spread(lambda e: e.finger_m * 1e3, 50),
    "finger_width_p95_mm": _spread(lambda e: e.finger_m * 1e3, 95),
    "finger_width_known": _mean(lambda e: np.isfinite(e.width_m[e.tracked & e.visible])),
    "open_or_closed_right": _mean(lambda e: open_is_correct(e.width_m[e.tracked], e.true_width_m[e.tracked])),
    "lasting_flips": lambda results: float(sum(length >= LASTING_FRAMES for e in results for length in e.flips)),
    "calibration_error": lambda results: reliability(results).error,
}
"""Further figures of a single pipeline."""


def intervals(
    results: Results, statistics: Mapping[str, Statistic] = ACCURACY, seed: int = 0
) -> dict[str, IntervalEstimate]:
    """Return each statistic with its interval; the same clips and seed give the same numbers.

    The interval is NaN for fewer than two clips.
    """
    return {name: cluster_bootstrap(results, statistic, seed) for name, statistic in statistics.items()}


def summarize(results: Results) -> dict[str, float]:
    """Return all figures of a set of clips, NaN where there is nothing to measure."""
    planted = [(e, fault) for e in results for fault in e.planted]
    tracked = [e.tracked_fraction for e in results if e.visible.any()]
    return {
        "videos": len(results),
        **{name: statistic(results) for name, statistic in {**ACCURACY, **MORE}.items()},
        "tracked_fraction_worst": min(tracked, default=float("nan")),
        "longest_flip_frames": max((e.longest_flip for e in results), default=0),
        "faults_planted": len(planted),
        "faults_found": sum(any(matches(fault, a) for a in e.detected) for e, fault in planted),
        "anomalies_not_planted": sum(not any(matches(f, a) for f in e.planted) for e in results for a in e.detected),
        "cpu_median_s": float(np.median([e.cpu_s * CLIP_FRAMES / len(e.tracked) for e in results])),
    }


def matches(planted: Anomaly, detected: Anomaly) -> bool:
    """Return whether a detected anomaly is the planted one: same kind, range equal within one frame.

    A teleport is detected at its jump, whereas its planted range covers all frames in which the gripper is displaced.
    """
    starts = abs(planted.frame_start - detected.frame_start)
    ends = abs(planted.frame_end - detected.frame_end)
    return planted.kind is detected.kind and starts <= 1 and (ends <= 1 or planted.kind is AnomalyKind.TELEPORT)
