"""Held-out videos, as they are and made worse: what the calibration of confidences along a video rests on."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.anomaly.find import find_anomalies
from kinebench_drake.grounding.confidence import GOOD_M, GOOD_RAD
from kinebench_drake.grounding.evaluation.clip import Clip, ClipFile
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.rawtrack import RawTrack
from kinebench_drake.grounding.training.augment import degrade, occlude
from kinebench_drake.grounding.video import read_video
from kinebench_drake.grounding.view import Frames

_NEAR_PX = 40.0  # things stand so near to the gripper's path


class Trouble(Enum):
    """What is done to a video."""

    NONE = "none"
    DEGRADED = "degraded"
    """As training pictures are, all frames alike."""
    OCCLUDED = "occluded"
    """Things that stand still before the gripper's path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Footage:
    """N frames in which a gripper was found."""

    clip: NDArray[np.int64]
    """(N,) number of the video."""
    features: Array
    """(N, 4) what the confidence of a frame among others rests on."""
    position_m: Array
    """(N,) error of the smoothed position [m]; inf where there is no gripper."""
    good: NDArray[np.bool_]
    """(N,) whether the smoothed pose is within 10 mm and 5 degrees."""

    @staticmethod
    def join(several: "Sequence[Footage]") -> "Footage":
        """The frames of several videos."""
        return Footage(**{f.name: np.concatenate([getattr(s, f.name) for s in several]) for f in fields(Footage)})


def measure_footage(pipeline: GroundingPipeline, file: ClipFile, number: int, seed: int = 0) -> Footage:
    """Track the gripper through a clip, number `number` of several, under every trouble."""
    clip, frames = file.load(), read_video(file.video).frames
    nothing = np.full((len(frames), 4, 4), np.nan)
    features, position, good = [], [], []
    for trouble in Trouble:
        worse = spoil(frames, clip, trouble, [seed, number])
        observed = pipeline.observe(worse, clip.camera, clip.t_s)
        poses, seen = observed.poses, observed.evidence
        anomalies = find_anomalies(seen).anomalies
        raw = RawTrack.of(poses, seen.confidence, anomalies, seen.motion.lost, nothing)
        distance, angle = pose_difference(clip.X_CH, raw.smoothed(raw.found, raw.confidence))
        features.append(raw.features()[raw.found])
        position.append(np.where(np.isfinite(distance), distance, np.inf)[raw.found])
        good.append(((distance <= GOOD_M) & (angle <= GOOD_RAD))[raw.found])
    return Footage(
        clip=np.full(sum(map(len, good)), number),
        features=np.concatenate(features),
        position_m=np.concatenate(position),
        good=np.concatenate(good),
    )


def spoil(frames: Frames, clip: Clip, trouble: Trouble, seed: Sequence[int]) -> Frames:
    """The frames (T, S, S, 3) of a clip made worse; the same `seed` gives the same frames."""
    if trouble is Trouble.NONE:
        return frames
    if trouble is Trouble.DEGRADED:
        return np.stack([degrade(frame, np.random.default_rng(seed)) for frame in frames])
    rng = np.random.default_rng(seed)
    shown = np.flatnonzero(np.isfinite(clip.X_CH).all(axis=(1, 2)))
    places = clip.camera.resized(frames.shape[2], frames.shape[1]).project(clip.X_CH[rng.choice(shown, 3), :3, 3])
    y, x = np.mgrid[0 : frames.shape[1], 0 : frames.shape[2]]
    near = np.min([np.hypot(x - p[0], y - p[1]) for p in places], axis=0) <= _NEAR_PX
    worse, draw = frames.copy(), int(rng.integers(2**32))
    for image in worse:
        occlude(image, near.astype(np.uint8), frames[0], np.random.default_rng(draw))
    return worse
