"""Comparison of baseline and grounding: errors on the same videos, with intervals over videos."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.reader import read_video
from kinebench_drake.stats import IntervalEstimate, percentile_interval, resampled_indices
from training.baseline.fitting import Demonstration
from training.baseline.network import Baseline

_RESAMPLES = 1000
_PERCENTILES = (50, 95)


class Extractor(Enum):
    """Methods whose errors are compared."""

    BASELINE = "baseline"
    BASELINE_WHERE_TRACKED = "baseline where tracked"
    """The baseline in the frames that the grounding tracks."""
    GROUNDING = "grounding"


class Quantity(Enum):
    """Error quantities with their unit."""

    POSITION = "position [mm]"
    """Of panda_hand_tcp in the base frame."""
    ROTATION = "rotation [degrees]"
    """Of panda_hand_tcp."""
    FINGER = "finger gap [mm]"
    """Of the gap between the finger pads."""


PoseErrors = Mapping[Quantity, Array]
"""Errors (T,) of a method in one video, in the units of `Quantity`; NaN where it has no pose."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClipComparison:
    """Errors of all methods in one video."""

    id: str
    task: str
    trained: bool
    """True if the baseline was trained on the task."""
    tracked_fraction: float
    """Share of frames that the grounding tracks."""
    errors: Mapping[Extractor, PoseErrors]


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonGroup:
    """Errors on a task, or on all trained or all unseen tasks."""

    name: str
    trained: bool
    videos: int
    pooled: bool
    """True for several tasks together."""
    tracked_fraction: float
    figures: Mapping[tuple[Extractor, Quantity], tuple[IntervalEstimate, IntervalEstimate]]
    """Median and 95th percentile of the errors."""
    medians: Mapping[tuple[Extractor, Quantity], Sequence[float]]
    """Median error of each video; NaN without a pose."""


def errors(truth: Demonstration, X_BG: Array, finger_width_m: Array) -> PoseErrors:
    """Return the errors of a track with poses (T, 4, 4) and gaps (T,) [m]."""
    position, rotation = pose_difference(truth.X_BG, X_BG)
    return {
        Quantity.POSITION: 1e3 * position,
        Quantity.ROTATION: np.rad2deg(rotation),
        Quantity.FINGER: 1e3 * np.abs(finger_width_m - truth.finger_width_m),
    }


def compare(clip: Demonstration, camera: Camera, baseline: Baseline, pipeline: GroundingPipeline) -> ClipComparison:
    """Run baseline and grounding on one video.

    Raises:
        InputError: the video cannot be read, or differs from its ground truth in the number of frames.
    """
    frames = read_video(clip.path).frames
    if len(frames) != len(clip.t_s):
        raise InputError(f"{clip.path.name}: has {len(frames)} frames, its truth has {len(clip.t_s)}")
    always = errors(clip, *baseline.predict(frames))
    track = pipeline.ground(frames, camera, clip.t_s).track
    return ClipComparison(
        id=clip.id,
        task=clip.task,
        trained=clip.task in baseline.tasks,
        tracked_fraction=float(track.tracked.mean()),
        errors={
            Extractor.BASELINE: always,
            Extractor.BASELINE_WHERE_TRACKED: {q: np.where(track.tracked, e, np.nan) for q, e in always.items()},
            Extractor.GROUNDING: errors(clip, track.X_BG, track.finger_width_m),
        },
    )


def percentiles(videos: Sequence[Array], rng: np.random.Generator) -> tuple[IntervalEstimate, IntervalEstimate]:
    """Return median and 95th percentile over all frames of `videos` (T,) each, without NaN, with bootstrap intervals.

    The bootstrap draws whole videos: errors of frames of one video are correlated (Efron and Tibshirani 1993, chapter
    8).
    """
    finite = [v[np.isfinite(v)] for v in videos]
    finite = [v for v in finite if len(v)]
    low = high = values = np.full(2, np.nan)
    if finite:
        values = np.percentile(np.concatenate(finite), _PERCENTILES)
    if len(finite) > 1:
        draws = [
            np.percentile(np.concatenate([finite[i] for i in drawn]), _PERCENTILES)
            for part in resampled_indices(len(finite), rng, _RESAMPLES)
            for drawn in part
        ]
        low, high = np.transpose([percentile_interval(column) for column in np.transpose(draws)])
    median, p95 = (
        IntervalEstimate(value=float(v), low=float(a), high=float(b)) for v, a, b in zip(values, low, high, strict=True)
    )
    return median, p95


def compare_group(name: str, clips: Sequence[ClipComparison], *, pooled: bool, seed: int = 0) -> ComparisonGroup:
    """Return the errors of a group of videos; the same videos and seed give the same numbers."""
    rng = np.random.default_rng(seed)
    values = {(m, q): [clip.errors[m][q] for clip in clips] for m in Extractor for q in Quantity}
    return ComparisonGroup(
        name=name,
        trained=clips[0].trained,
        videos=len(clips),
        pooled=pooled,
        tracked_fraction=float(np.mean([clip.tracked_fraction for clip in clips])),
        figures={key: percentiles(videos, rng) for key, videos in values.items()},
        medians={key: [_median(video) for video in videos] for key, videos in values.items()},
    )


def _median(errors: Array) -> float:
    finite = errors[np.isfinite(errors)]
    return float(np.median(finite)) if len(finite) else float("nan")


def groups(clips: Sequence[ClipComparison]) -> Iterator[ComparisonGroup]:
    """Yield each task, then all tasks together: first of the trained tasks, then of the unseen ones."""
    for trained, name in ((True, "trained tasks"), (False, "unseen tasks")):
        members = [clip for clip in clips if clip.trained is trained]
        for task in sorted({clip.task for clip in members}):
            yield compare_group(task, [clip for clip in members if clip.task == task], pooled=False)
        if members:
            yield compare_group(name, members, pooled=True)
