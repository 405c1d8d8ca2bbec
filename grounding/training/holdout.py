"""Held-out rendered frames: what the network gets right in single frames, and the calibration of the confidence."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from enum import Enum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.anomaly.detect import find_anomalies
from kinebench_drake.grounding.confidence import GOOD_M, GOOD_RAD, LogisticRegression, frame_features
from kinebench_drake.grounding.evaluation.clip import TruthClip, TruthClipFile
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.smoothing import RawTrack
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.training.augment import degrade, occlude
from kinebench_drake.grounding.training.dataset import Shards, frame_camera
from kinebench_drake.grounding.view import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.perception.frame import DEPTH_UNIT_M

HOLDOUT_SEED = 1_000_000
"""First seed of held-out scenes; training uses seeds from 0."""
_MIN_VISIBLE_PX = 150
_PENALTY = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrors:
    """One held-out frame on which a gripper was found."""

    scene: int
    """Number of the scene, or the demonstration, that the frame shows."""
    features: Array
    """(8,) what the confidence rests on."""
    position_m: float
    """Position error of panda_hand [m]; inf where there is no gripper."""
    rotation_rad: float
    """Rotation error [rad]; inf where there is no gripper."""
    mask_iou: float
    """Intersection over union of estimated and true gripper cells in the close view; NaN where there is none."""
    depth_error: float
    """Median relative depth error over cells that both call gripper; NaN where there are none."""

    @property
    def good(self) -> bool:
        """Whether the pose is as right as the confidence asks for."""
        return self.position_m <= GOOD_M and self.rotation_rad <= GOOD_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class Holdout:
    """The outcome over all held-out frames."""

    found: tuple[FrameErrors, ...]
    visible: int
    """Frames that show at least 150 px of the gripper."""
    missed: int
    """Of those, frames in which it was not found."""


def measure(tracker: CadTracker, shards: Shards, seed: int = 0) -> Holdout:
    """Find the gripper in every held-out frame by itself, every other frame degraded as in training."""
    rng = np.random.default_rng([seed, HOLDOUT_SEED])
    found: list[FrameErrors] = []
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
        found.append(
            FrameErrors(
                scene=shards.number(i),
                features=frame_features(pose),
                position_m=position,
                rotation_rad=rotation,
                mask_iou=iou,
                depth_error=depth_error,
            )
        )
    return Holdout(found=tuple(found), visible=visible, missed=missed)


def fit_logistic(features: Array, good: NDArray[np.bool_]) -> LogisticRegression:
    """Logistic regression of `good` (N,) on `features` (N, n), with a small ridge penalty."""
    A = np.column_stack([np.ones(len(good)), features])
    y = good.astype(np.float64)

    def loss(w: Array) -> tuple[float, Array]:
        score = A @ w
        value = np.logaddexp(0.0, score).sum() - y @ score + 0.5 * _PENALTY * (w[1:] ** 2).sum()
        return float(value), A.T @ (expit(score) - y) + _PENALTY * np.array([0.0, *w[1:]])

    w = minimize(loss, np.zeros(A.shape[1]), method="BFGS", jac=True).x
    return LogisticRegression(intercept=float(w[0]), weights=np.asarray(w[1:]))


def reliability(probability: Array, good: NDArray[np.bool_], bins: int = 5) -> Iterator[tuple[float, float, int]]:
    """Mean probability, share of good frames and number of frames in equally filled bins: equal when calibrated."""
    for part in np.array_split(np.argsort(probability), bins):
        if len(part):
            yield float(probability[part].mean()), float(good[part].mean()), len(part)


_NEAR_PX = 40.0  # things stand so near to the gripper's path


class Degradations(Enum):
    """What is done to a video."""

    NONE = "none"
    DEGRADED = "degraded"
    """As training pictures are, all frames alike."""
    OCCLUDED = "occluded"
    """Things that stand still before the gripper's path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutVideo:
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
    def join(several: "Sequence[HeldOutVideo]") -> "HeldOutVideo":
        """The frames of several videos."""
        return HeldOutVideo(
            **{f.name: np.concatenate([getattr(s, f.name) for s in several]) for f in fields(HeldOutVideo)}
        )


def measure_footage(pipeline: GroundingPipeline, file: TruthClipFile, number: int, seed: int = 0) -> HeldOutVideo:
    """Track the gripper through a clip, number `number` of several, under every trouble."""
    clip, frames = file.load(), read_video(file.video).frames
    nothing = np.full((len(frames), 4, 4), np.nan)
    features, position, good = [], [], []
    for trouble in Degradations:
        worse = spoil(frames, clip, trouble, [seed, number])
        observed = pipeline.observe(worse, clip.camera, clip.t_s)
        poses, seen = observed.poses, observed.evidence
        anomalies = find_anomalies(seen).anomalies
        raw = RawTrack.from_poses(poses, seen.confidence, anomalies, seen.motion.lost, nothing)
        distance, angle = pose_difference(clip.X_CH, raw.smooth(raw.has_pose, raw.confidence))
        features.append(raw.features()[raw.has_pose])
        position.append(np.where(np.isfinite(distance), distance, np.inf)[raw.has_pose])
        good.append(((distance <= GOOD_M) & (angle <= GOOD_RAD))[raw.has_pose])
    return HeldOutVideo(
        clip=np.full(sum(map(len, good)), number),
        features=np.concatenate(features),
        position_m=np.concatenate(position),
        good=np.concatenate(good),
    )


def spoil(frames: Frames, clip: TruthClip, trouble: Degradations, seed: Sequence[int]) -> Frames:
    """The frames (T, S, S, 3) of a clip made worse; the same `seed` gives the same frames."""
    if trouble is Degradations.NONE:
        return frames
    if trouble is Degradations.DEGRADED:
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
