"""The track from per-frame poses: joint ordering and smoothing on SE(3)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp, rotation_log
from kinebench_drake.grounding.confidence import track_features
from kinebench_drake.grounding.frame_pose import FramePose
from kinebench_drake.types import Anomaly, AnomalyKind

HALF_WINDOW = 3
"""Frames before and after that a pose is smoothed with."""
_DEGREE = 2
_MIN_NEIGHBOURS = 4
_L1_PASSES, _TUKEY_PASSES = 4, 2
_FLOOR = np.array([1e-2] * 3 + [1e-3] * 3)  # standard deviations [rad, m] that no frame is trusted to fall below


def _local_value(offset: Array, values: Array, weight: Array, information: Array) -> Array:
    """Value (6,) at offset 0 of a polynomial fitted to `values` (n, 6) at `offset` (n,).

    Generalised least squares with `information` (n, 6, 6); least absolute deviations first, which a wild frame cannot
    bend, then Tukey's weights about that.
    """
    degree = min(_DEGREE, int((weight > 0).sum()) - 1)
    A = np.vander(offset, degree + 1, increasing=True)
    robust = np.ones(len(offset))
    coefficients: Array = np.zeros((degree + 1, 6))
    for number in range(1 + _L1_PASSES + _TUKEY_PASSES):
        weighed = (weight * robust)[:, None, None] * information
        H = np.einsum("na,nb,nij->aibj", A, A, weighed).reshape(6 * (degree + 1), -1)
        g = np.einsum("na,nij,nj->ai", A, weighed, values).reshape(-1)
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
    """Smoothed poses (T, 4, 4) [m].

    Args:
        X: (T, 4, 4) poses X_AH; NaN where there is none, and so in the result.
        covariance: (T, 6, 6) of each: rotation about the axes of A [rad], then position [m].
        weight: (T,) how far each is trusted, 0 for not at all.
        breaks: frames that begin after a jump; nothing is smoothed across them.
        leave_out: give what the neighbours alone say of each frame; NaN where there are fewer than four.
    """
    X, weight = np.asarray(X, dtype=np.float64), np.asarray(weight, dtype=np.float64)
    known = np.isfinite(X).all(axis=(1, 2))
    information = np.full((len(X), 6, 6), np.nan)
    information[known] = np.linalg.inv(np.asarray(covariance)[known] + np.diag(_FLOOR**2))
    segment = np.zeros(len(X), dtype=int)
    for frame in breaks:
        segment[frame:] += 1
    smoothed = np.full_like(X, np.nan) if leave_out else X.copy()
    for i in np.flatnonzero(known).tolist():
        near = np.arange(max(0, i - HALF_WINDOW), min(len(X), i + HALF_WINDOW + 1))
        near = near[known[near] & (segment[near] == segment[i]) & ~(leave_out & (near == i))]
        if len(near) < _MIN_NEIGHBOURS:
            continue
        offset = (near - i).astype(np.float64)
        w = (1.0 - np.abs(offset / (HALF_WINDOW + 1)) ** 3) ** 3 * np.maximum(weight[near], 1e-3)
        turn = rotation_log(X[near, :3, :3] @ X[i, :3, :3].T)
        value = _local_value(offset, np.hstack([turn, X[near, :3, 3]]), w, information[near])
        smoothed[i] = make_pose(rotation_exp(value[:3]) @ X[i, :3, :3], value[3:])
    return smoothed


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
