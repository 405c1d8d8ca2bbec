"""Calibration of the confidence on held-out frames and videos (`kinebench-drake perception calibrate`)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.confidence import TRACK_FEATURES, Confidence, LogisticRegression
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.evaluation.clip import find_clips
from kinebench_drake.grounding.evaluation.summary import OFF_M
from kinebench_drake.grounding.pipeline import TRACKED_CONFIDENCE, GroundingPipeline
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.training.crops import Shards
from kinebench_drake.grounding.training.holdout import (
    HOLDOUT_SEED,
    PosedFrames,
    calibration_bins,
    fit_logistic,
    measure_frames,
    measure_video,
)
from kinebench_drake.grounding.training.render import render
from kinebench_drake.models.perception.weights import WEIGHTS, load_network


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfidenceCalibration:
    """Inputs and output of a calibration."""

    scenes: Path
    """Folder of held-out scenes; missing ones are rendered into it."""
    count: int
    """Number of scenes of 20 frames each."""
    demos: tuple[Path, ...]
    """Folders of rendered frames of held-out demonstrations."""
    videos: Path | None
    """Folder of held-out videos with ground truth; None keeps the shipped confidence within a track."""
    weights: Path | None
    """Weights in place of those shipped."""
    out: Path | None
    """File for the calibration."""
    jobs: int
    """Rendering processes."""


def calibrate_confidence(config: ConfidenceCalibration) -> Iterator[str]:
    """Measure held-out frames and videos, fit the confidence and yield the lines of a report.

    The reported reliability is that of a fit to half of the scenes, demonstrations and videos, measured on the other
    half. The calibration that is written is fitted to all.
    """
    messages: list[str] = []
    render(config.scenes, range(HOLDOUT_SEED, HOLDOUT_SEED + config.count), config.jobs, messages.append)
    yield from messages
    tracker = CadTracker(NetworkEstimator(load_network(config.weights or WEIGHTS)))
    holdout = measure_frames(tracker, Shards([config.scenes, *config.demos]))
    good = [f for f in holdout.errors if np.isfinite(f.position_m)]
    position, rotation = np.array([f.position_m for f in good]) * 1e3, np.rad2deg([f.rotation_rad for f in good])
    yield f"frames with a gripper {holdout.visible}, missed {holdout.missed}, detected {len(holdout.errors)}"
    yield f"mask IoU          median {np.nanmedian([f.mask_iou for f in good]):.3f}"
    yield f"depth error       median {100 * np.nanmedian([f.depth_error for f in good]):.2f} %"
    yield f"position error    {_spread(position)} mm (median, 90 %, 95 %)"
    yield f"rotation error    {_spread(rotation)} degrees (median, 90 %, 95 %)"
    scene = np.array([f.scene for f in holdout.errors])
    features = np.stack([f.features for f in holdout.errors])
    frame, lines = _fit("single frames", scene, features, np.array([f.good for f in holdout.errors]))
    yield from lines
    if config.videos is None:
        track = Confidence.load().track
    else:
        initial = Confidence(
            frame=frame, track=LogisticRegression(intercept=0.0, weights=np.zeros(len(TRACK_FEATURES)))
        )
        pipeline, clips, parts = GroundingPipeline(tracker, initial), find_clips(config.videos), []
        for number, clip in enumerate(clips):
            parts.append(measure_video(pipeline, clip, number))
            yield f"[{number + 1}/{len(clips)}] {clip.id}"
        videos = PosedFrames.join(parts)
        track, lines = _fit("videos", videos.clip, videos.features, videos.good)
        yield from lines
        tracked = track.probability(videos.features) >= TRACKED_CONFIDENCE
        off = float((videos.position_m[tracked] > OFF_M).mean())
        yield f"{tracked.mean():.1%} of the frames of videos are tracked, of these {off:.2%} are off by more than 3 cm"
    if config.out is not None:
        Confidence(frame=frame, track=track).save(config.out)
        yield f"calibration of all frames written to {config.out.name}"


def _fit(
    name: str, group: NDArray[np.int64], features: Array, good: NDArray[np.bool_]
) -> tuple[LogisticRegression, list[str]]:
    """Fit a regression to all frames; report the reliability on odd groups of one fitted to even groups."""
    odd = group % 2 == 1
    probability = fit_logistic(features[~odd], good[~odd]).probability(features[odd])
    lines = [
        f"confidence {mean:.2f} of {name}: within 10 mm and 5 degrees in {share:.2f} of {n} frames"
        for mean, share, n in calibration_bins(probability, good[odd])
    ]
    return fit_logistic(features, good), lines


def _spread(values: Array) -> str:
    return " ".join(f"{v:.2f}" for v in np.percentile(values, [50, 90, 95]))
