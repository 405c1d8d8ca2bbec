"""Calibration of the confidence on held-out videos (`python -m training calibrate`)."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.perception.clip import TruthClip, TruthClipFile, find_clips
from benchmarks.perception.store import MeasurementStore, Stored, fingerprint
from benchmarks.perception.summary import OFF_M
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import Executor, Observer
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.detect import AnomalyEvidence
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.tracking.pose import (
    FRAME_FEATURES,
    Confidence,
    LogisticRegression,
    frame_features,
    load_confidence,
)
from kinebench_drake.grounding.tracking.smoothing import RawTrack
from kinebench_drake.grounding.tracking.tracker import Tracking
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.track import Domain
from training.augment import degrade, occlude

_Stored = Annotated[Array, Stored(".7g")]
_PENALTY = 1.0
"""Ridge penalty of the logistic regressions."""
_NEAR_PX = 40.0
"""Greatest distance of occluders from the path of the gripper [px]."""
_REMOVED_PX = 9
"""Width of the strip around a removed gripper that is painted over, too [px]."""
_FOCAL_ERROR = (0.05, 0.3)
"""Range of the logarithm of the factor by which a wrong focal length is off."""


class VideoDegradation(Enum):
    """Degradation of held-out videos."""

    NONE = "none"
    DEGRADED = "degraded"
    """Degraded like training images, with the same draw for all frames."""
    OCCLUDED = "occluded"
    """Static occluders on the path of the gripper."""
    ABSENT = "absent"
    """Gripper painted over with its surroundings: every pose is wrong."""
    CAMERA = "camera"
    """Wrong focal length. The confidence presupposes a right camera and is not fitted to these videos: hand and arm fit
    many a wrong camera, at wrong distances. They are measured to show that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationItem:
    """Held-out video under a degradation."""

    clip: TruthClipFile
    degradation: VideoDegradation
    number: int
    """Number of the video, which seeds the degradation; odd and even ones are the halves of the validation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPoses:
    """Poses of the T frames of a video before confidence and smoothing; NaN where no gripper was detected."""

    domain: Domain
    features: _Stored
    """(T, n) FRAME_FEATURES of the domain."""
    X_AH: _Stored
    """(T, 4, 4) poses in the camera frame of the first frame [m]."""
    covariance: _Stored
    """(T, 6, 6) covariances: rotation about the axes of A [rad], then position [m]."""
    X_true: _Stored
    """(T, 4, 4) true poses; NaN without a gripper."""

    @classmethod
    def from_tracking(cls, tracking: Tracking, evidence: AnomalyEvidence, X_true: Array) -> "MeasuredPoses":
        """Collect what the confidence is fitted to."""
        n = len(X_true)
        domain = tracking.domain
        features = np.full((n, len(FRAME_FEATURES[domain])), np.nan)
        X_AH = np.full((n, 4, 4), np.nan)
        covariance = np.zeros((n, 6, 6))
        for i, pose in enumerate(tracking.poses):
            if pose is not None and not evidence.motion.lost[i]:
                features[i] = frame_features(pose, domain)
                X_AH[i] = pose.X_CH
                covariance[i] = pose.covariance
        return cls(domain=domain, features=features, X_AH=X_AH, covariance=covariance, X_true=X_true)

    @property
    def detected(self) -> NDArray[np.bool_]:
        """(T,) frames with a pose."""
        return np.asarray(np.isfinite(self.X_AH).all(axis=(1, 2)))

    def good(self, X: Array) -> NDArray[np.bool_]:
        """Return which poses X (T, 4, 4) are as accurate as the confidence states."""
        distance, angle = pose_difference(self.X_true, X)
        return np.asarray((distance <= bounds.GOOD_M) & (angle <= bounds.GOOD_RAD))

    def track(self, frame: LogisticRegression) -> RawTrack:
        """Return the raw track with the confidence `frame` of each frame by itself."""
        confidence = np.where(self.detected, frame.probability(np.nan_to_num(self.features)), 0.0)
        return RawTrack(
            X_AH=np.where((confidence >= bounds.MIN_CONFIDENCE)[:, None, None], self.X_AH, np.nan),
            covariance=self.covariance,
            confidence=confidence,
            from_prior=np.zeros(len(confidence), dtype=bool),
            breaks=(),
            place=np.arange(len(confidence), dtype=np.float64),
        )


def degrade_video(frames: Frames, clip: TruthClip, degradation: VideoDegradation, seed: Sequence[int]) -> Frames:
    """Return the degraded frames (T, H, W, 3) of a clip; the same `seed` gives the same frames."""
    if degradation in (VideoDegradation.NONE, VideoDegradation.CAMERA):
        return frames
    if degradation is VideoDegradation.DEGRADED:
        return np.stack([degrade(frame, np.random.default_rng(seed)) for frame in frames])
    if degradation is VideoDegradation.ABSENT:
        masks = clip.masks(GripperCad())
        strip = np.ones((_REMOVED_PX, _REMOVED_PX), np.uint8)
        widened = [np.asarray(cv2.dilate(mask.astype(np.uint8), strip)) for mask in masks]
        return np.stack([cv2.inpaint(f, m, 3.0, cv2.INPAINT_TELEA) for f, m in zip(frames, widened, strict=True)])
    rng = np.random.default_rng(seed)
    shown = np.flatnonzero(np.isfinite(clip.X_CH).all(axis=(1, 2)))
    places = clip.camera.resized(frames.shape[2], frames.shape[1]).project(clip.X_CH[rng.choice(shown, 3), :3, 3])
    y, x = np.mgrid[0 : frames.shape[1], 0 : frames.shape[2]]
    near = np.min([np.hypot(x - p[0], y - p[1]) for p in places], axis=0) <= _NEAR_PX
    occluded = np.array(frames)
    draw = int(rng.integers(2**32))
    for image in occluded:
        occlude(image, near.astype(np.uint8), frames[0], np.random.default_rng(draw))
    return occluded


def wrong_camera(camera: Camera, seed: Sequence[int]) -> Camera:
    """Return a camera whose focal length is off by 5 to 35 %."""
    rng = np.random.default_rng(seed)
    factor = float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(*_FOCAL_ERROR)))
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


class CalibrationWorker:
    """Measures videos."""

    def __init__(self, weights: Path | None) -> None:
        """Load the pipeline; `weights` in place of those shipped.

        Raises:
            SetupError: weights, CAD model or native libraries are missing.
        """
        self._pipeline = GroundingPipeline.create(weights=weights)

    def __call__(self, item: CalibrationItem) -> MeasuredPoses:
        """Measure one item."""
        clip = item.clip.load()
        frames = read_video(item.clip.video).frames
        video = degrade_video(frames, clip, item.degradation, [0, item.number])
        camera = clip.camera.resized(frames.shape[2], frames.shape[1])
        if item.degradation is VideoDegradation.CAMERA:
            camera = wrong_camera(camera, [0, item.number])
        absent = item.degradation is VideoDegradation.ABSENT
        X_true = np.full_like(clip.X_CH, np.nan) if absent else clip.X_CH
        return MeasuredPoses.from_tracking(*self._pipeline.observe(video, camera, clip.t_s), X_true)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfidenceCalibration:
    """Inputs of a calibration."""

    videos: tuple[Path, ...]
    """Folders of held-out videos with ground truth."""
    weights: Path | None = None
    """Weights in place of those shipped."""
    limit: int | None = None
    """Number of videos of each folder; all if None."""
    keep: Path | None = None
    """File of finished measurements."""

    def items(self) -> list[CalibrationItem]:
        """Return every video as it is, and under one of the degradations in turn."""
        clips = [clip for folder in self.videos for clip in find_clips(folder)[: self.limit]]
        others = [d for d in VideoDegradation if d is not VideoDegradation.NONE]
        return [
            CalibrationItem(clip=clip, degradation=degradation, number=number)
            for number, clip in enumerate(clips)
            # Two videos in turn under each, so that both halves have all of them.
            for degradation in (VideoDegradation.NONE, others[number // 2 % len(others)])
        ]


def calibrate_confidence(
    config: ConfidenceCalibration, executor: Executor, observer: Observer
) -> tuple[dict[Domain, Confidence], list[str]]:
    """Measure held-out videos and fit the confidence; return it with the lines of a report.

    The reported reliability is that of a fit to half of the videos, measured on the other half. The calibration that is
    returned is fitted to all but those with a wrong camera.

    Raises:
        UsageError: a folder holds no videos with ground truth, or the videos of a domain do not suffice.
        SetupError: weights or libraries are missing, or a worker died.
    """
    items = config.items()
    weights = [config.weights] if config.weights else []
    base = fingerprint(modules=[CalibrationWorker.__module__], files=weights)
    digests = {item.clip.id: item.clip.digest() for item in items}
    store = MeasurementStore(config.keep, MeasuredPoses)
    measured = store.complete(
        items,
        lambda item: f"{base}-{digests[item.clip.id]}-{item.number}-{item.degradation.value}",
        executor,
        partial(CalibrationWorker, config.weights),
        observer,
        lambda item: f"{item.clip.id}  {item.degradation.value}",
    )
    confidence = {Domain.ARM: load_confidence()[Domain.ARM]}
    lines = list[str]()
    for domain in (Domain.FAMILIAR, Domain.UNFAMILIAR):
        chosen = [(i, m) for i, m in zip(items, measured, strict=True) if m.domain is domain]
        fitted = [(i, m) for i, m in chosen if i.degradation is not VideoDegradation.CAMERA]
        halves = [[m for i, m in fitted if i.number % 2 == odd] for odd in (0, 1)]
        if any(len({bool(g) for m in half for g in m.good(m.X_AH)[m.detected]}) < 2 for half in halves):
            raise UsageError(f"{len(chosen)} videos of the domain {domain.value} do not suffice; add some")
        confidence[domain] = fit_confidence([m for _, m in fitted])
        tested = [(i, m) for i, m in chosen if i.number % 2 == 1]
        lines += _reliability(domain, tested, fit_confidence(halves[0]))
    return confidence, lines


def fit_confidence(videos: Sequence[MeasuredPoses]) -> Confidence:
    """Fit the confidence of frames by themselves, then that within their track, to videos of one domain."""
    detected = [m.detected for m in videos]
    frame = fit_logistic(
        np.concatenate([m.features[d] for m, d in zip(videos, detected, strict=True)]),
        np.concatenate([m.good(m.X_AH)[d] for m, d in zip(videos, detected, strict=True)]),
    )
    tracks = [m.track(frame) for m in videos]
    features = np.concatenate([t.features()[t.has_pose] for t in tracks])
    good = [m.good(t.smooth(t.has_pose, t.confidence))[t.has_pose] for m, t in zip(videos, tracks, strict=True)]
    return Confidence(frame=frame, track=fit_logistic(features, np.concatenate(good)))


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


def _reliability(
    domain: Domain, tested: Sequence[tuple[CalibrationItem, MeasuredPoses]], confidence: Confidence
) -> Iterator[str]:
    """Yield how well `confidence` holds on videos that it was not fitted to, by folder and degradation."""
    kinds: dict[str, list[tuple[Array, NDArray[np.bool_], Array]]] = {}
    for item, m in tested:
        raw = m.track(confidence.frame)
        probability = np.where(raw.has_pose, confidence.track.probability(np.nan_to_num(raw.features())), 0.0)
        X_AH = raw.smooth(probability >= bounds.TRACKED_CONFIDENCE, probability)
        distance = pose_difference(m.X_true, X_AH)[0]
        row = probability, m.good(X_AH), np.where(np.isfinite(distance), distance, np.inf)
        wrong = item.degradation is VideoDegradation.CAMERA
        for kind in (item.degradation.value, *([] if wrong else [item.clip.video.parent.name])):
            kinds.setdefault(kind, []).append(row)
    for kind, rows in kinds.items():
        probability, good, distance = (np.concatenate(values) for values in zip(*rows, strict=True))
        tracked = probability >= bounds.TRACKED_CONFIDENCE
        off = float((distance[tracked] > OFF_M).mean()) if tracked.any() else 0.0
        yield (
            f"{domain.value}, {kind}: {tracked.mean():.1%} of {len(tracked)} frames are tracked, of these {off:.2%} "
            f"are off by more than {1e2 * OFF_M:.0f} cm"
        )
        for mean, share, n in calibration_bins(probability[tracked], good[tracked]):
            yield f"  confidence {mean:.2f}: within 10 mm and 5 degrees in {share:.2f} of {n} frames"
