"""Comparison of baseline and grounding: errors on the same videos, with intervals over videos."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.baseline.fitting import Demonstration
from kinebench_drake.grounding.baseline.network import Baseline
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.reader import read_video
from kinebench_drake.stats import IntervalEstimate, percentile_interval, resampled_indices

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
    ROTATION = "rotation [degrees]"
    FINGER = "finger gap [mm]"


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseErrors:
    """Errors of a method in one video; NaN where it has no pose."""

    position_m: Array
    """(T,) of panda_hand_tcp in the base frame [m]."""
    rotation_rad: Array
    """(T,) of panda_hand_tcp [rad]."""
    finger_m: Array
    """(T,) of the gap between the finger pads [m]."""

    def in_unit(self, quantity: Quantity) -> Array:
        """Return the errors (T,) in the unit of the quantity."""
        if quantity is Quantity.ROTATION:
            return np.asarray(np.rad2deg(self.rotation_rad))
        return 1e3 * (self.position_m if quantity is Quantity.POSITION else self.finger_m)


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
    medians: Mapping[tuple[Extractor, Quantity], IntervalEstimate]
    p95s: Mapping[tuple[Extractor, Quantity], IntervalEstimate]
    """95th percentiles."""


def errors(truth: Demonstration, X_BG: Array, finger_width_m: Array) -> PoseErrors:
    """Return the errors of a track with poses (T, 4, 4) and gaps (T,) [m]."""
    position, rotation = pose_difference(truth.X_BG, X_BG)
    return PoseErrors(
        position_m=position, rotation_rad=rotation, finger_m=np.abs(finger_width_m - truth.finger_width_m)
    )


def compare(clip: Demonstration, camera: Camera, baseline: Baseline, pipeline: GroundingPipeline) -> ClipComparison:
    """Run baseline and grounding on one video.

    Raises:
        InputError: the video cannot be read, or differs from its ground truth in the number of frames.
    """
    frames = read_video(clip.path).frames
    if len(frames) != len(clip.t_s):
        raise InputError(f"{clip.path.name}: has {len(frames)} frames, its truth has {len(clip.t_s)}")
    prediction, track = baseline.predict(frames), pipeline.ground(frames, camera, clip.t_s).track
    always = errors(clip, prediction.X_BG, prediction.finger_width_m)
    untracked = np.where(track.tracked, 0.0, np.nan)
    where_tracked = PoseErrors(
        position_m=always.position_m + untracked,
        rotation_rad=always.rotation_rad + untracked,
        finger_m=always.finger_m + untracked,
    )
    return ClipComparison(
        id=clip.id,
        task=clip.task,
        trained=clip.task in baseline.tasks,
        tracked_fraction=float(track.tracked.mean()),
        errors={
            Extractor.BASELINE: always,
            Extractor.BASELINE_WHERE_TRACKED: where_tracked,
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
    values = {(m, q): [clip.errors[m].in_unit(q) for clip in clips] for m in Extractor for q in Quantity}
    figures = {key: percentiles(videos, rng) for key, videos in values.items()}
    return ComparisonGroup(
        name=name,
        trained=clips[0].trained,
        videos=len(clips),
        pooled=pooled,
        tracked_fraction=float(np.mean([clip.tracked_fraction for clip in clips])),
        medians={key: median for key, (median, _) in figures.items()},
        p95s={key: p95 for key, (_, p95) in figures.items()},
    )


def groups(clips: Sequence[ClipComparison]) -> Iterator[ComparisonGroup]:
    """Yield each task, then all tasks together: first of the trained tasks, then of the unseen ones."""
    for trained, name in ((True, "trained tasks"), (False, "unseen tasks")):
        members = [clip for clip in clips if clip.trained is trained]
        for task in sorted({clip.task for clip in members}):
            yield compare_group(task, [clip for clip in members if clip.task == task], pooled=False)
        if members:
            yield compare_group(name, members, pooled=True)
