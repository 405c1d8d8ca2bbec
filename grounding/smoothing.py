"""Smoothing of per-frame poses on SE(3)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp, rotation_log
from kinebench_drake.grounding.confidence import track_features
from kinebench_drake.grounding.pose import FramePose
from kinebench_drake.types import Anomaly, AnomalyKind

HALF_WINDOW = 3
"""Number of frames before and after a frame that its pose is smoothed with."""
MIN_CONFIDENCE = 0.02
"""Least confidence at which a detection counts as a gripper."""
_DEGREE = 2
_MIN_NEIGHBOURS = 4
_L1_PASSES, _TUKEY_PASSES = 4, 2
_FLOOR = np.array([1e-2] * 3 + [1e-3] * 3)  # least standard deviations of a frame [rad, m]


def _local_value(offset: Array, values: Array, weight: Array, information: Array) -> Array:
    """Return the value (6,) at offset 0 of a polynomial fitted to `values` (n, 6) at `offset` (n,).

    Generalised least squares with `information` (n, 6, 6): least absolute deviations first, robust to outliers, then
    Tukey's weights about that fit.
    """
    degree = min(_DEGREE, int((weight > 0).sum()) - 1)
    A = np.vander(offset, degree + 1, increasing=True)
    robust = np.ones(len(offset))
    coefficients: Array = np.zeros((degree + 1, 6))
    for number in range(1 + _L1_PASSES + _TUKEY_PASSES):
        weighted = (weight * robust)[:, None, None] * information
        H = np.einsum("na,nb,nij->aibj", A, A, weighted).reshape(6 * (degree + 1), -1)
        g = np.einsum("na,nij,nj->ai", A, weighted, values).reshape(-1)
        coefficients = np.linalg.solve(H, g).reshape(degree + 1, 6)
        error = values - A @ coefficients
        residual = np.sqrt(np.einsum("ni,nij,nj->n", error, information, error) / 6)
        if number < _L1_PASSES:
            robust = 1.0 / np.maximum(residual, 0.1)
        else:
            cut = max(6.0 * float(np.median(residual)), 3.0)
            robust = np.clip(1.0 - (residual / cut) ** 2, 0.0, 1.0) ** 2 + 1e-9
    return np.asarray(coefficients[0])


def smooth_track(
    X: ArrayLike, covariance: ArrayLike, weight: ArrayLike, breaks: Iterable[int] = (), *, leave_out: bool = False
) -> Array:
    """Return poses (T, 4, 4) smoothed by local regression [m].

    Args:
        X: (T, 4, 4) poses X_AH [m]; NaN where there is none, and so in the result.
        covariance: (T, 6, 6) covariances: rotation about the axes of A [rad], then position [m].
        weight: (T,) weights >= 0.
        breaks: first frames after a jump; poses are not smoothed across them.
        leave_out: predict each frame from its neighbours alone; NaN where there are fewer than four.
    """
    X, weight = np.asarray(X, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    has_pose = np.isfinite(X).all(axis=(1, 2))
    information = np.full((len(X), 6, 6), np.nan)
    information[has_pose] = np.linalg.inv(np.asarray(covariance)[has_pose] + np.diag(_FLOOR**2))
    segment = np.zeros(len(X), dtype=int)
    for frame in breaks:
        segment[frame:] += 1
    smoothed = np.full_like(X, np.nan) if leave_out else X.copy()
    for i in np.flatnonzero(has_pose).tolist():
        near = np.arange(max(0, i - HALF_WINDOW), min(len(X), i + HALF_WINDOW + 1))
        near = near[has_pose[near] & (segment[near] == segment[i]) & ~(leave_out & (near == i))]
        if len(near) < _MIN_NEIGHBOURS:
            continue
        offset = (near - i).astype(np.float64)
        w = (1.0 - np.abs(offset / (HALF_WINDOW + 1)) ** 3) ** 3 * np.maximum(weight[near], 1e-3)
        rotation = rotation_log(X[near, :3, :3] @ X[i, :3, :3].T)
        value = _local_value(offset, np.hstack([rotation, X[near, :3, 3]]), w, information[near])
        smoothed[i] = make_pose(rotation_exp(value[:3]) @ X[i, :3, :3], value[3:])
    return smoothed


@dataclass(frozen=True, slots=True, kw_only=True)
class RawTrack:
    """Poses of T frames before smoothing, in the camera frame A of the first frame."""

    X_AH: Array
    """(T, 4, 4) poses of panda_hand [m]; NaN where there is none."""
    covariance: Array
    """(T, 6, 6) covariances: rotation about the axes of A [rad], then position [m]."""
    confidence: Array
    """(T,) confidence 0..1 of each frame by itself."""
    from_prior: NDArray[np.bool_]
    """(T,) frames whose pose was taken from priors."""
    breaks: tuple[int, ...]
    """First frames after a jump."""

    @classmethod
    def from_poses(
        cls,
        poses: Sequence[FramePose | None],
        confidence: Array,
        anomalies: Sequence[Anomaly],
        lost: NDArray[np.bool_],
        X_prior: Array,
    ) -> "RawTrack":
        """Collect poses, without false detections, vanished grippers and frames whose camera pose is lost.

        Args:
            poses: (T,) measurements, including those from priors.
            confidence: (T,) confidence of each frame by itself.
            anomalies: anomalies of the video.
            lost: (T,) frames whose camera pose is unknown.
            X_prior: (T, 4, 4) poses from priors [m], NaN elsewhere; their confidence is 1.
        """
        X_AH = np.stack([np.full((4, 4), np.nan) if p is None else p.X_CH for p in poses])
        X_AH[(confidence < MIN_CONFIDENCE) | lost | _vanished(anomalies, len(poses))] = np.nan
        from_prior = np.asarray(np.isfinite(X_prior).all(axis=(1, 2)))
        X_AH[from_prior] = X_prior[from_prior]
        return cls(
            X_AH=X_AH,
            covariance=np.stack([np.zeros((6, 6)) if p is None else p.covariance for p in poses]),
            confidence=np.where(from_prior, 1.0, confidence),
            from_prior=from_prior,
            breaks=_breaks(anomalies),
        )

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(T,) frames with a pose."""
        return np.asarray(np.isfinite(self.X_AH).all(axis=(1, 2)))

    def features(self) -> Array:
        """Return the features (T, 4) of `confidence.TRACK_FEATURES`."""
        predicted = smooth_track(self.X_AH, self.covariance, self.confidence, self.breaks, leave_out=True)
        return track_features(self.confidence, *pose_difference(self.X_AH, predicted))

    def smooth(self, tracked: NDArray[np.bool_], weight: Array) -> Array:
        """Return poses (T, 4, 4) of the `tracked` (T,) frames [m], weighted by `weight` (T,); priors are unchanged."""
        X_AH = np.where(tracked[:, None, None], self.X_AH, np.nan)
        smoothed = smooth_track(X_AH, self.covariance, weight, self.breaks)
        return np.where(self.from_prior[:, None, None], X_AH, smoothed)


def _vanished(anomalies: Sequence[Anomaly], frames: int) -> NDArray[np.bool_]:
    """Return the frames (T,) in which the gripper has vanished: a detection there is false."""
    vanished = np.zeros(frames, dtype=bool)
    for anomaly in anomalies:
        if anomaly.kind is AnomalyKind.VANISH:
            vanished[anomaly.frame_start : anomaly.frame_end + 1] = True
    return vanished


def _breaks(anomalies: Sequence[Anomaly]) -> tuple[int, ...]:
    frames: list[int] = []
    for anomaly in anomalies:
        if anomaly.kind is AnomalyKind.TELEPORT:
            frames.append(anomaly.frame_start)
        elif anomaly.kind in (AnomalyKind.VANISH, AnomalyKind.FREEZE):
            frames += [anomaly.frame_start, anomaly.frame_end + 1]
    return tuple(sorted(frames))
