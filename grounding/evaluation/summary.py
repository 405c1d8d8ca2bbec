"""The figures of a set of clips, with intervals over the clips.

Frames are pooled over all clips. Intervals are 95 % percentile intervals of a bootstrap that draws whole clips: frames
of one clip err alike and are no independent measurements (Efron 1979; Field and Welsh 2007, the cluster bootstrap).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.errors import LASTING_FRAMES, ClipErrors
from kinebench_drake.grounding.evaluation.reliability import judged_frames, reliability
from kinebench_drake.stats import percentile_interval, resampled_indices
from kinebench_drake.types import Anomaly, AnomalyKind


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency:
    """Reaction to one stretch of frames without a gripper."""

    loss: int
    """Frames still called tracked from the first one without a gripper on; all of them if the loss goes unnoticed."""
    recovery: int | None
    """Frames not tracked from the first one with the gripper back on; None where the clip ends before."""
    phantoms: int
    """Frames called tracked although there is no gripper."""


def vanish_latencies(errors: ClipErrors) -> list[Latency]:
    """The reaction to each planted vanishing of a clip."""
    return [
        latency(errors.tracked, fault.frame_start, fault.frame_end)
        for fault in errors.planted
        if fault.kind is AnomalyKind.VANISH
    ]


def latency(tracked: NDArray[np.bool_], start: int, end: int) -> Latency:
    """The reaction of a track (T,) to a gripper gone from frame `start` to `end`, inclusive."""
    gone, back = tracked[start : end + 1], tracked[end + 1 :]
    return Latency(
        loss=len(gone) if gone.all() else int(np.argmin(gone)),
        recovery=int(np.argmax(back)) if back.any() else (len(back) if len(back) else None),
        phantoms=int(gone.sum()),
    )


MARGIN_M = 0.008
"""True gaps nearer than this to the boundary are not judged [m]."""
HALFWAY_M = 0.04
"""Halfway of the gripper's range, 0..0.08 [m]."""


def boundary(true_width_m: Array) -> float:
    """The gap between closed and open in an episode with true gaps (T,), NaN left out [m]."""
    known = true_width_m[np.isfinite(true_width_m)]
    if not known.size or known.max() - known.min() < 2 * MARGIN_M:
        return HALFWAY_M
    return float((known.max() + known.min()) / 2)


def judged(width_m: Array, true_width_m: Array) -> NDArray[np.bool_]:
    """Whether open or closed was read right, in each frame (n,) that is judged and in which a gap was read at all."""
    middle = boundary(true_width_m)
    far = np.isfinite(width_m) & (np.abs(true_width_m - middle) > MARGIN_M)
    return np.asarray((width_m[far] > middle) == (true_width_m[far] > middle))


OFF_M = 0.03
"""A frame called tracked that is off by more than this is a falsehood [m]."""
SEEN_SHARE = 0.3
"""A frame that shows this part of the gripper or more ought to be tracked."""
CLIP_FRAMES = 49
"""Times are given for so many frames."""
RESAMPLES = 400

Results = Sequence[ClipErrors]
Statistic = Callable[[Results], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PercentileInterval:
    """A figure and its 95 % interval over clips."""

    value: float
    low: float
    high: float


def _pooled(results: Results, values: Callable[[ClipErrors], Array]) -> Array:
    """Finite values of all frames of all clips."""
    pooled = np.concatenate([values(e) for e in results]) if results else np.empty(0)
    return np.asarray(pooled[np.isfinite(pooled)])


def _mm(e: ClipErrors) -> Array:
    return np.asarray(e.position_m[e.tracked & e.visible] * 1e3)


def _degrees(e: ClipErrors) -> Array:
    return np.asarray(np.rad2deg(e.rotation_rad[e.tracked & e.visible]))


def _width_mm(e: ClipErrors) -> Array:
    return np.asarray(e.finger_m[e.tracked & e.visible] * 1e3)


def percentile(values: Array, q: float) -> float:
    """A percentile; NaN of nothing."""
    return float(np.percentile(values, q)) if values.size else float("nan")


def _spread(values: Callable[[ClipErrors], Array], q: float) -> Statistic:
    return lambda results: percentile(_pooled(results, values), q)


def tracked_when_seen(results: Results) -> float:
    """Tracked frames over those that show at least 30 % of the gripper; NaN where that was not measured."""
    seen = _pooled(results, lambda e: e.tracked[e.share >= SEEN_SHARE].astype(float))
    return float(seen.mean()) if seen.size else float("nan")


def falsehoods(results: Results) -> float:
    """Part of the frames called tracked that is off by more than 3 cm, or shows no gripper at all."""
    tracked = sum(int(e.tracked.sum()) for e in results)
    near = sum(int((e.position_m[e.tracked] <= OFF_M).sum()) for e in results)
    return 1.0 - near / tracked if tracked else float("nan")


def _tracked_fraction(results: Results) -> float:
    fractions = [e.tracked_fraction for e in results if e.visible.any()]
    return float(np.mean(fractions)) if fractions else float("nan")


def _opening_right(results: Results) -> float:
    right = _pooled(results, lambda e: judged(e.width_m[e.tracked], e.true_width_m[e.tracked]).astype(float))
    return float(right.mean()) if right.size else float("nan")


def _opening_known(results: Results) -> float:
    known = _pooled(results, lambda e: np.isfinite(e.width_m[e.tracked & e.visible]).astype(float))
    return float(known.mean()) if known.size else float("nan")


def _lasting_flips(results: Results) -> float:
    return float(sum(length >= LASTING_FRAMES for e in results for length in e.flips))


def _calibration_error(results: Results) -> float:
    return reliability(*judged_frames(results)).error


ACCURACY: Mapping[str, Statistic] = {
    "tracked_fraction": _tracked_fraction,
    "tracked_when_seen": tracked_when_seen,
    "position_median_mm": _spread(_mm, 50),
    "position_p95_mm": _spread(_mm, 95),
    "rotation_median_deg": _spread(_degrees, 50),
    "rotation_p95_deg": _spread(_degrees, 95),
    "tracked_frames_off_by_3_cm": falsehoods,
}
"""Figures that every comparison shows."""

MORE: Mapping[str, Statistic] = {
    "position_max_mm": _spread(_mm, 100),
    "rotation_max_deg": _spread(_degrees, 100),
    "finger_width_median_mm": _spread(_width_mm, 50),
    "finger_width_p95_mm": _spread(_width_mm, 95),
    "finger_width_known": _opening_known,
    "open_or_closed_right": _opening_right,
    "lasting_flips": _lasting_flips,
    "calibration_error": _calibration_error,
}
"""Figures of one pipeline on one set of clips."""


def intervals(
    results: Results, statistics: Mapping[str, Statistic] = ACCURACY, seed: int = 0
) -> dict[str, PercentileInterval]:
    """Each statistic with its interval; the same clips and seed give the same numbers.

    The interval is NaN of fewer than two clips.
    """
    rng = np.random.default_rng(seed)
    parts = resampled_indices(len(results), rng, RESAMPLES if len(results) > 1 else 0)
    samples = [[results[i] for i in drawn] for part in parts for drawn in part]
    table = {}
    for name, statistic in statistics.items():
        low, high = percentile_interval([statistic(sample) for sample in samples], (2.5, 97.5))
        table[name] = PercentileInterval(value=statistic(results), low=low, high=high)
    return table


def summarize(results: Results) -> dict[str, float]:
    """All figures of a set of clips, NaN where there is nothing to measure."""
    latencies = [latency for e in results for latency in vanish_latencies(e)]
    planted = [(e, fault) for e in results for fault in e.planted]
    tracked = [e.tracked_fraction for e in results if e.visible.any()]
    wall = [e.expense.wall_s * CLIP_FRAMES / len(e.tracked) for e in results]
    cpu = [e.expense.cpu_s * CLIP_FRAMES / len(e.tracked) for e in results]
    return {
        "videos": len(results),
        **{name: statistic(results) for name, statistic in {**ACCURACY, **MORE}.items()},
        "tracked_fraction_worst": min(tracked, default=float("nan")),
        "longest_flip_frames": max((e.longest_flip for e in results), default=0),
        "vanish_loss_max_frames": max((v.loss for v in latencies), default=float("nan")),
        "vanish_recovery_max_frames": max(
            (v.recovery for v in latencies if v.recovery is not None), default=float("nan")
        ),
        "vanish_phantom_frames": sum(v.phantoms for v in latencies) if latencies else float("nan"),
        "faults_planted": len(planted),
        "faults_found": sum(any(same(fault, a) for a in e.found) for e, fault in planted),
        "anomalies_not_planted": sum(not any(same(f, a) for f in e.planted) for e in results for a in e.found),
        "wall_median_s": float(np.median(wall)),
        "wall_max_s": max(wall),
        "cpu_median_s": float(np.median(cpu)),
        "peak_memory_mb": max(e.expense.peak_mb for e in results),
    }


def same(planted: Anomaly, found: Anomaly) -> bool:
    """Whether a found anomaly is the planted one: its kind, within a frame.

    A teleport is found at its jump; the planted range tells how long the gripper stays displaced.
    """
    starts, ends = abs(planted.frame_start - found.frame_start), abs(planted.frame_end - found.frame_end)
    return planted.kind is found.kind and starts <= 1 and (ends <= 1 or planted.kind is AnomalyKind.TELEPORT)
