"""The measurements as lines of text: what `kinebench-drake perception calibrate` prints."""

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
from kinebench_drake.grounding.training.dataset import Shards
from kinebench_drake.grounding.training.holdout import (
    HOLDOUT_SEED,
    HeldOutVideo,
    fit_logistic,
    measure,
    measure_footage,
    reliability,
)
from kinebench_drake.grounding.training.render import render
from kinebench_drake.models.perception.weights import WEIGHTS, load_network


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfidenceCalibration:
    """What to calibrate on."""

    scenes: Path
    """Folder of frames of held-out scenes; missing ones are rendered into it."""
    count: int
    """Scenes of 20 frames."""
    demos: tuple[Path, ...]
    """Folders of frames of held-out demonstrations."""
    videos: Path | None
    """Folder of held-out videos with truth; None leaves the frames' confidence among others as it is."""
    weights: Path | None
    """Weights in place of those shipped."""
    out: Path | None
    """Where to write the calibration."""
    jobs: int
    """Rendering processes."""


def calibration_lines(order: ConfidenceCalibration) -> Iterator[str]:
    """Measure single held-out frames, then held-out videos; fit the confidence, tell how well it is calibrated.

    Half of the scenes, demonstrations and videos fit the confidence that is told of, the others test it. The one that
    is written is fitted to all.
    """
    messages: list[str] = []
    render(order.scenes, range(HOLDOUT_SEED, HOLDOUT_SEED + order.count), order.jobs, messages.append)
    yield from messages
    tracker = CadTracker(NetworkEstimator(load_network(order.weights or WEIGHTS)))
    holdout = measure(tracker, Shards([order.scenes, *order.demos]))
    good = [f for f in holdout.found if np.isfinite(f.position_m)]
    position, rotation = np.array([f.position_m for f in good]) * 1e3, np.rad2deg([f.rotation_rad for f in good])
    yield f"frames with a gripper {holdout.visible}, missed {holdout.missed}, found {len(holdout.found)}"
    yield f"mask IoU          median {np.nanmedian([f.mask_iou for f in good]):.3f}"
    yield f"depth error       median {100 * np.nanmedian([f.depth_error for f in good]):.2f} %"
    yield f"position error    {_spread(position)} mm (median, 90 %, 95 %)"
    yield f"rotation error    {_spread(rotation)} degrees (median, 90 %, 95 %)"
    scene = np.array([f.scene for f in holdout.found])
    features = np.stack([f.features for f in holdout.found])
    frame, lines = _fitted("single frames", scene, features, np.array([f.good for f in holdout.found]))
    yield from lines
    if order.videos is None:
        track = Confidence.load().track
    else:
        before = Confidence(frame=frame, track=LogisticRegression(intercept=0.0, weights=np.zeros(len(TRACK_FEATURES))))
        pipeline, clips, parts = GroundingPipeline(tracker, before), find_clips(order.videos), []
        for number, clip in enumerate(clips):
            parts.append(measure_footage(pipeline, clip, number))
            yield f"[{number + 1}/{len(clips)}] {clip.id}"
        footage = HeldOutVideo.join(parts)
        track, lines = _fitted("videos", footage.clip, footage.features, footage.good)
        yield from lines
        tracked = track.probability(footage.features) >= TRACKED_CONFIDENCE
        off = float((footage.position_m[tracked] > OFF_M).mean())
        yield f"{tracked.mean():.1%} of the frames of videos are tracked, of these {off:.2%} are off by more than 3 cm"
    if order.out is not None:
        Confidence(frame=frame, track=track).save(order.out)
        yield f"calibration of all frames written to {order.out.name}"


def _fitted(
    name: str, group: NDArray[np.int64], features: Array, good: NDArray[np.bool_]
) -> tuple[LogisticRegression, list[str]]:
    """A regression fitted to all frames, and what one fitted to the even groups says of the odd ones."""
    odd = group % 2 == 1
    probability = fit_logistic(features[~odd], good[~odd]).probability(features[odd])
    lines = [
        f"confidence {mean:.2f} of {name}: within 10 mm and 5 degrees in {share:.2f} of {n} frames"
        for mean, share, n in reliability(probability, good[odd])
    ]
    return fit_logistic(features, good), lines


def _spread(values: Array) -> str:
    return " ".join(f"{v:.2f}" for v in np.percentile(values, [50, 90, 95]))
