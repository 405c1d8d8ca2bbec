"""The grounding of one video: frames in, gripper track and anomalies out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array, pose_difference, transform_points
from kinebench_drake.grounding.anomalies import find_anomalies
from kinebench_drake.grounding.confidence import Confidence
from kinebench_drake.grounding.crop import GRIPPER_CENTRE_H
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.motion import camera_motion_px
from kinebench_drake.grounding.reading import settle
from kinebench_drake.grounding.smoothing import smooth_track
from kinebench_drake.grounding.tracker import CadTracker, FramePose, PoseTracker
from kinebench_drake.grounding.view import Frames
from kinebench_drake.models.panda.robot import hand_from_tcp
from kinebench_drake.models.perception.weights import load_network
from kinebench_drake.products import Anomaly, AnomalyKind, GripperTrack

SURE_CONFIDENCE = 0.3
"""From here on a pose is tracked whatever its neighbours say."""
FAIR_CONFIDENCE = 0.1
"""From here on a position counts when jumps are looked for."""
MIN_CONFIDENCE = 0.02
"""From here on what was found is a gripper: tracked if its neighbours agree."""
AGREE_M, AGREE_RAD = 0.03, np.deg2rad(20.0)
"""How near to what its neighbours say a doubtful pose must lie to be tracked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grounding:
    """What a video shows."""

    track: GripperTrack
    anomalies: tuple[Anomaly, ...]
    camera_motion_px: float | None
    """Largest displacement of the background [px]; None where it has too few features to tell."""


class GroundingPipeline:
    """Tracker, confidence, smoothing, anomalies; one instance serves any number of videos."""

    def __init__(self, tracker: PoseTracker, confidence: Confidence) -> None:
        """Compose the stages."""
        self._tracker, self.confidence = tracker, confidence

    @classmethod
    def create(cls, device: str | None = None) -> "GroundingPipeline":
        """The pipeline with the shipped weights.

        Raises:
            SetupError: weights, calibration, meshes or native libraries are missing.
        """
        return cls(CadTracker(NetworkEstimator(load_network(), device)), Confidence.load())

    def warm_up(self) -> None:
        """Run once on a blank picture: the first use of the network and of the ray caster is slow."""
        camera = benchmark_camera()
        blank = np.zeros((2, camera.height, camera.width, 3), np.uint8)
        self.ground(blank, camera, np.array([0.0, 1.0]))

    def ground(self, frames: Frames, camera: Camera, t_s: Array) -> Grounding:
        """Track the gripper through `frames` (T, H, W, 3) taken by `camera` at task times `t_s` (T,) [s]."""
        camera = camera.resized(frames.shape[2], frames.shape[1])
        tracking = self._tracker.track(frames, camera)
        poses = settle(tracking.poses)
        confidence = np.array([self.confidence.probability(p) if p is not None else 0.0 for p in poses])
        X_CH = _stack(poses)
        p_C = _centres(X_CH)
        seen, sure = confidence >= MIN_CONFIDENCE, confidence >= FAIR_CONFIDENCE
        anomalies = find_anomalies(frames=frames, t_s=t_s, p_C=p_C, seen=seen, sure=sure, camera=camera)
        breaks = _breaks(anomalies)
        X_CH[~seen] = np.nan
        distance, angle = pose_difference(X_CH, smooth_track(X_CH, confidence, breaks, leave_out=True))
        tracked = (confidence >= SURE_CONFIDENCE) | ((distance <= AGREE_M) & (angle <= AGREE_RAD))
        X_CH[~tracked] = np.nan
        X_CH = smooth_track(X_CH, confidence, breaks)
        track = GripperTrack(
            t_s=t_s,
            X_CH=X_CH,
            X_BG=camera.X_BC @ X_CH @ hand_from_tcp(),
            tracked=tracked,
            confidence=confidence,
            finger_width_m=np.array(
                [2 * p.finger_m if p and ok else np.nan for p, ok in zip(poses, tracked, strict=True)]
            ),
        )
        return Grounding(track=track, anomalies=anomalies, camera_motion_px=camera_motion_px(frames, tracking.robot))


def _stack(poses: Sequence[FramePose | None]) -> Array:
    unknown = np.full((4, 4), np.nan)
    return np.stack([p.X_CH if p is not None else unknown for p in poses])


def _centres(X_CH: Array) -> Array:
    """(T, 3) centre of the gripper in the camera frame [m]."""
    return np.asarray(transform_points(X_CH, GRIPPER_CENTRE_H[None])[:, 0])


def _breaks(anomalies: tuple[Anomaly, ...]) -> list[int]:
    """Frames that begin after a jump."""
    frames: list[int] = []
    for anomaly in anomalies:
        if anomaly.kind is AnomalyKind.TELEPORT:
            frames.append(anomaly.frame_start)
        else:
            frames += [anomaly.frame_start, anomaly.frame_end + 1]
    return sorted(frames)
