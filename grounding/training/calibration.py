"""Calibration of the confidence on held-out frames and videos (`kinebench-drake perception calibrate`)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.anomaly.detect import find_anomalies
from kinebench_drake.grounding.confidence import (
    GOOD_M,
    GOOD_RAD,
    TRACK_FEATURES,
    Confidence,
    LogisticRegression,
    frame_features,
)
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.evaluation.clip import TruthClip, TruthClipFile, find_clips
from kinebench_drake.grounding.evaluation.summary import OFF_M
from kinebench_drake.grounding.pipeline import TRACKED_CONFIDENCE, GroundingPipeline
from kinebench_drake.grounding.smoothing import RawTrack
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.training.augment import degrade, occlude
from kinebench_drake.grounding.training.crops import Shards, frame_camera
from kinebench_drake.grounding.training.render import render
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.perception.frame import DEPTH_UNIT_M
from kinebench_drake.models.perception.network import WEIGHTS, load_network

HOLDOUT_SEED = 1_000_000
"""First seed of held-out scenes; training uses seeds from 0."""
_MIN_VISIBLE_PX = 150
_PENALTY = 1.0  # ridge
_NEAR_PX = 40.0  # distance of occluders to the path of the gripper


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrors:
    """Errors of one held-out frame in which a gripper was detected."""

    kind: str
    """Name of the folder that holds it."""
    scene: int
    """Number of the scene or the demonstration."""
    features: Array
    """(8,) features of the confidence."""
    position_m: float
    """Position error of panda_hand [m]; inf where there is no gripper."""
    rotation_rad: float
    """Rotation error [rad]; inf where there is no gripper."""
    mask_iou: float
    """Intersection over union of estimated and true gripper cells in the close crop; NaN if there is no gripper."""
    depth_error: float
    """Median relative depth error over cells that are gripper in estimate and truth; NaN if there are none."""

    @property
    def good(self) -> bool:
        """True if the pose is as accurate as the confidence states."""
        return self.position_m <= GOOD_M and self.rotation_rad <= GOOD_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class Holdout:
    """Errors of all held-out frames."""

    errors: tuple[FrameErrors, ...]
    visible: int
    """Frames that show at least 150 px of the gripper."""
    missed: int
    """Those of them in which it was not detected."""


def measure_frames(tracker: CadTracker, shards: Shards, seed: int = 0) -> Holdout:
    """Detect the gripper in every held-out frame separately; every other frame is degraded as in training."""
    rng = np.random.default_rng([seed, HOLDOUT_SEED])
    errors: list[FrameErrors] = []
    visible = missed = 0
    for i in range(len(shards)):
        frame = shards[i]
        rgb = degrade(frame.rgb, rng) if i % 2 else frame.rgb
        gripper = frame.gripper
        shown = bool(gripper.sum() >= _MIN_VISIBLE_PX)
        visible += shown
        pose = tracker.track(rgb[None], frame_camera(frame)).poses[0]
        if pose is None:
            missed += shown
            continue
        position, rotation, iou, depth_error = np.inf, np.inf, np.nan, np.nan
        if gripper.any():
            d, a = pose_difference(frame.X_CH, pose.X_CH)
            view, camera = pose.view, frame_camera(frame)
            true = np.asarray(view.crop.warp(gripper.astype(np.uint8), camera, view.stride, nearest=True)) > 0
            both = true & view.gripper
            depth_C = np.asarray(view.crop.warp(frame.depth, camera, view.stride, nearest=True), dtype=np.float64)
            z = depth_C * DEPTH_UNIT_M / (view.rays() @ view.crop.R_CV.T)[..., 2]
            position, rotation = float(d), float(a)
            iou = float(both.sum() / max(1, (true | view.gripper).sum()))
            if both.any():
                depth_error = float(np.median(np.abs(view.depth_m[both] / z[both] - 1.0)))
        errors.append(
            FrameErrors(
                kind=shards.folder(i),
                scene=shards.number(i),
                features=frame_features(pose),
                position_m=position,
                rotation_rad=rotation,
                mask_iou=iou,
                depth_error=depth_error,
            )
        )
    return Holdout(errors=tuple(errors), visible=visible, missed=missed)


def fit_logistic(features: Array, good: NDArray[np.bool_]) -> LogisticRegression:
    """Fit a logistic regression of `good` (N,) on `features` (N, n), with a small ridge penalty."""
    A = np.column_stack([np.ones(len(good)), features])
    y = good.astype(np.float64)

    def loss(w: Array) -> tuple[float, Array]:
        score = A @ w
        value = np.logaddexp(0.0, score).sum() - y @ score + 0.5 * _PENALTY * (w[1:] ** 2).sum()
        return float(value), A.T @ (expit(score) - y) + _PENALTY * np.array([0.0, *w[1:]])

    w = minimize(loss, np.zeros(A.shape[1]), method="BFGS", jac=True).x
    return LogisticRegression(intercept=float(w[0]), weights=np.asarray(w[1:]))


def calibration_bins(probability: Array, good: NDArray[np.bool_], bins: int = 5) -> Iterator[tuple[float, float, int]]:
    """Yield mean probability, share of good frames and number of frames of equally filled bins."""
    for part in np.array_split(np.argsort(probability), bins):
        if len(part):
            yield float(probability[part].mean()), float(good[part].mean()), len(part)


class VideoDegradation(Enum):
    """Degradation of held-out videos."""

    NONE = "none"
    DEGRADED = "degraded"
    """Degraded like training images, with the same draw for all frames."""
    OCCLUDED = "occluded"
    """Static occluders on the path of the gripper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PosedFrames:
    """N frames of held-out videos in which a gripper was detected."""

    clip: NDArray[np.int64]
    """(N,) number of the video."""
    kind: NDArray[np.str_]
    """(N,) name of the folder that holds the video."""
    features: Array
    """(N, 4) features of the confidence within a track."""
    position_m: Array
    """(N,) position error of the smoothed track [m]; inf where there is no gripper."""
    good: NDArray[np.bool_]
    """(N,) True if the smoothed pose is within 10 mm and 5 degrees."""

    @staticmethod
    def join(videos: "Sequence[PosedFrames]") -> "PosedFrames":
        """Concatenate the frames of several videos."""
        return PosedFrames(
            **{f.name: np.concatenate([getattr(v, f.name) for v in videos]) for f in fields(PosedFrames)}
        )


def measure_video(pipeline: GroundingPipeline, file: TruthClipFile, number: int, seed: int = 0) -> PosedFrames:
    """Track the gripper in a clip under every degradation; `number` identifies the clip among others."""
    clip, frames = file.load(), read_video(file.video).frames
    nothing = np.full((len(frames), 4, 4), np.nan)
    features, position, good = [], [], []
    for degradation in VideoDegradation:
        video = degrade_video(frames, clip, degradation, [seed, number])
        observation = pipeline.observe(video, clip.camera, clip.t_s)
        poses, evidence = observation.poses, observation.evidence
        anomalies = find_anomalies(evidence).anomalies
        raw = RawTrack.from_poses(poses, evidence.confidence, anomalies, evidence.motion.lost, nothing)
        distance, angle = pose_difference(clip.X_CH, raw.smooth(raw.has_pose, raw.confidence))
        features.append(raw.features()[raw.has_pose])
        position.append(np.where(np.isfinite(distance), distance, np.inf)[raw.has_pose])
        good.append(((distance <= GOOD_M) & (angle <= GOOD_RAD))[raw.has_pose])
    n = sum(map(len, good))
    return PosedFrames(
        clip=np.full(n, number),
        kind=np.full(n, file.video.parent.name),
        features=np.concatenate(features),
        position_m=np.concatenate(position),
        good=np.concatenate(good),
    )


def degrade_video(frames: Frames, clip: TruthClip, degradation: VideoDegradation, seed: Sequence[int]) -> Frames:
    """Return the degraded frames (T, S, S, 3) of a clip; the same `seed` gives the same frames."""
    if degradation is VideoDegradation.NONE:
        return frames
    if degradation is VideoDegradation.DEGRADED:
        return np.stack([degrade(frame, np.random.default_rng(seed)) for frame in frames])
    rng = np.random.default_rng(seed)
    shown = np.flatnonzero(np.isfinite(clip.X_CH).all(axis=(1, 2)))
    places = clip.camera.resized(frames.shape[2], frames.shape[1]).project(clip.X_CH[rng.choice(shown, 3), :3, 3])
    y, x = np.mgrid[0 : frames.shape[1], 0 : frames.shape[2]]
    near = np.min([np.hypot(x - p[0], y - p[1]) for p in places], axis=0) <= _NEAR_PX
    occluded, draw = frames.copy(), int(rng.integers(2**32))
    for image in occluded:
        occlude(image, near.astype(np.uint8), frames[0], np.random.default_rng(draw))
    return occluded


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfidenceCalibration:
    """Inputs and output of a calibration."""

    scenes: Path
    """Folder of held-out scenes; missing ones are rendered into it."""
    count: int
    """Number of scenes of 20 frames each."""
    demos: tuple[Path, ...]
    """Folders of rendered frames of held-out demonstrations and of other renderers."""
    videos: tuple[Path, ...]
    """Folders of held-out videos with ground truth; without any the shipped confidence within a track is kept."""
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
    kind = np.array([f.kind for f in holdout.errors])
    frame, lines = _fit("single frames", kind, scene, features, np.array([f.good for f in holdout.errors]))
    yield from lines
    if not config.videos:
        track = Confidence.load().track
    else:
        initial = Confidence(
            frame=frame, track=LogisticRegression(intercept=0.0, weights=np.zeros(len(TRACK_FEATURES)))
        )
        pipeline, parts = GroundingPipeline(tracker, initial), list[PosedFrames]()
        clips = [clip for folder in config.videos for clip in find_clips(folder)]
        for number, clip in enumerate(clips):
            parts.append(measure_video(pipeline, clip, number))
            yield f"[{number + 1}/{len(clips)}] {clip.id}"
        videos = PosedFrames.join(parts)
        track, lines = _fit("videos", videos.kind, videos.clip, videos.features, videos.good)
        yield from lines
        tracked = track.probability(videos.features) >= TRACKED_CONFIDENCE
        off = float((videos.position_m[tracked] > OFF_M).mean())
        yield f"{tracked.mean():.1%} of the frames of videos are tracked, of these {off:.2%} are off by more than 3 cm"
    if config.out is not None:
        Confidence(frame=frame, track=track).save(config.out)
        yield f"calibration of all frames written to {config.out.name}"


def _fit(
    name: str, kind: NDArray[np.str_], group: NDArray[np.int64], features: Array, good: NDArray[np.bool_]
) -> tuple[LogisticRegression, list[str]]:
    """Fit a regression to all frames; report the reliability on odd groups of one fitted to even groups, by kind."""
    odd = group % 2 == 1
    half, lines = fit_logistic(features[~odd], good[~odd]), []
    for value in np.unique(kind):
        tested = odd & (kind == value)
        lines += [
            f"confidence {mean:.2f} of {name} in {value}: within 10 mm and 5 degrees in {share:.2f} of {n} frames"
            for mean, share, n in calibration_bins(half.probability(features[tested]), good[tested])
        ]
    return fit_logistic(features, good), lines


def _spread(values: Array) -> str:
    return " ".join(f"{v:.2f}" for v in np.percentile(values, [50, 90, 95]))
