"""The poses of a video's frames put in a row, before it is decided which of them to rely upon."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.confidence import track_features
from kinebench_drake.grounding.framepose import FramePose
from kinebench_drake.grounding.smoothing import smooth_track
from kinebench_drake.products import Anomaly, AnomalyKind

MIN_CONFIDENCE = 0.02
"""From here on what was found in a frame is taken for a gripper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RawTrack:
    """T poses as measured, against the camera A of the first frame."""

    X_AH: Array
    """(T, 4, 4) poses of panda_hand [m]; NaN where none was found."""
    covariance: Array
    """(T, 6, 6) of each: rotation about the axes of A [rad], then position [m]."""
    confidence: Array
    """(T,) of each frame by itself, 0..1."""
    given: NDArray[np.bool_]
    """(T,) frames whose pose was known beforehand."""
    breaks: tuple[int, ...]
    """Frames that begin after a jump."""

    @classmethod
    def of(
        cls,
        poses: Sequence[FramePose | None],
        confidence: Array,
        anomalies: Sequence[Anomaly],
        lost: NDArray[np.bool_],
        X_given: Array,
    ) -> "RawTrack":
        """Leave out what is no gripper: doubtful from the start, where it has vanished, where the camera is lost.

        Args:
            poses: (T,) as measured, those given among them.
            confidence: (T,) of each frame by itself.
            anomalies: of the video.
            lost: (T,) frames whose camera is not known.
            X_given: (T, 4, 4) poses that are known beforehand [m], NaN elsewhere; these are certain.
        """
        X_AH = np.stack([np.full((4, 4), np.nan) if p is None else p.X_CH for p in poses])
        X_AH[(confidence < MIN_CONFIDENCE) | lost | _vanished(anomalies, len(poses))] = np.nan
        given = np.asarray(np.isfinite(X_given).all(axis=(1, 2)))
        X_AH[given] = X_given[given]
        return cls(
            X_AH=X_AH,
            covariance=np.stack([np.zeros((6, 6)) if p is None else p.covariance for p in poses]),
            confidence=np.where(given, 1.0, confidence),
            given=given,
            breaks=_breaks(anomalies),
        )

    @property
    def found(self) -> NDArray[np.bool_]:
        """(T,) frames with a pose."""
        return np.asarray(np.isfinite(self.X_AH).all(axis=(1, 2)))

    def features(self) -> Array:
        """(T, 4) what the confidence of frames among others rests on (`confidence.TRACK_FEATURES`)."""
        told = smooth_track(self.X_AH, self.covariance, self.confidence, self.breaks, leave_out=True)
        return track_features(self.confidence, *pose_difference(self.X_AH, told))

    def smoothed(self, tracked: NDArray[np.bool_], weight: Array) -> Array:
        """(T, 4, 4) poses of the `tracked` (T,) frames [m], each trusted as `weight` (T,) says; those given stay."""
        X_AH = np.where(tracked[:, None, None], self.X_AH, np.nan)
        smooth = smooth_track(X_AH, self.covariance, weight, self.breaks)
        return np.where(self.given[:, None, None], X_AH, smooth)


def _vanished(anomalies: Sequence[Anomaly], frames: int) -> NDArray[np.bool_]:
    """(T,) frames in which the gripper is gone, whatever else may look a little like one."""
    gone = np.zeros(frames, dtype=bool)
    for anomaly in anomalies:
        if anomaly.kind is AnomalyKind.VANISH:
            gone[anomaly.frame_start : anomaly.frame_end + 1] = True
    return gone


def _breaks(anomalies: Sequence[Anomaly]) -> tuple[int, ...]:
    frames: list[int] = []
    for anomaly in anomalies:
        if anomaly.kind is AnomalyKind.TELEPORT:
            frames.append(anomaly.frame_start)
        elif anomaly.kind in (AnomalyKind.VANISH, AnomalyKind.FREEZE):
            frames += [anomaly.frame_start, anomaly.frame_end + 1]
    return tuple(sorted(frames))
