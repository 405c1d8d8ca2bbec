"""Smoothing of per-frame poses on SE(3)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp, rotation_log
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.tracking.confidence import track_features
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.segments import frame_periods

HALF_WINDOW = 3
"""Number of frames before and after a frame that its pose is smoothed with."""
_DEGREE = 2
_MIN_NEIGHBOURS = 4
_L1_PASSES = 4
_TUKEY_PASSES = 2
_FLOOR = np.array([1e-2] * 3 + [1e-3] * 3)
"""Least standard deviations of a frame [rad, m]."""


def _local_values(offset: Array, values: Array, weight: Array, information: Array) -> Array:
    """Return the values (M, 6) at offset 0 of polynomials fitted to `values` (M, n, 6) at `offset` (n,) or (M, n).

    Generalised least squares with `information` (M, n, 6, 6): least absolute deviations first, robust to outliers, then
    Tukey's weights about that fit. Points of weight 0 in `weight` (M, n) do not count; at least four of each row do.
    """
    A = offset[..., None] ** np.arange(_DEGREE + 1)
    axes = "n" if A.ndim == 2 else "mn"
    count = len(values)
    size = 6 * (_DEGREE + 1)
    robust = np.ones_like(weight)
    coefficients = np.zeros((count, _DEGREE + 1, 6))
    for number in range(1 + _L1_PASSES + _TUKEY_PASSES):
        weighted = (weight * robust)[..., None, None] * information
        H = np.einsum(f"{axes}a,{axes}b,mnij->maibj", A, A, weighted, optimize=True).reshape(count, size, size)
        g = np.einsum(f"{axes}a,mni->mai", A, (weighted @ values[..., None])[..., 0]).reshape(count, size, 1)
        coefficients = np.linalg.solve(H, g).reshape(count, _DEGREE + 1, 6)
        error = values - A @ coefficients
        residual = np.sqrt(np.einsum("mni,mnij,mnj->mn", error, information, error, optimize=True) / 6)
        if number < _L1_PASSES:
            robust = 1.0 / np.maximum(residual, 0.1)
        else:
            median = np.nanmedian(np.where(weight > 0, residual, np.nan), axis=1, keepdims=True)
            robust = np.clip(1.0 - (residual / np.maximum(6.0 * median, 3.0)) ** 2, 0.0, 1.0) ** 2 + 1e-9
    return np.asarray(coefficients[:, 0])


def smooth_track(
    X: ArrayLike,
    covariance: ArrayLike,
    weight: ArrayLike,
    breaks: Iterable[int] = (),
    *,
    place: Array | None = None,
    leave_out: bool = False,
) -> Array:
    """Return poses (T, 4, 4) smoothed by local regression [m].

    Args:
        X: (T, 4, 4) poses X_AH [m]; NaN where there is none, and so in the result.
        covariance: (T, 6, 6) covariances: rotation about the axes of A [rad], then position [m].
        weight: (T,) weights >= 0.
        breaks: first frames after a jump; poses are not smoothed across them.
        place: (T,) times in frame periods (`frame_periods`); None: the frames are evenly spaced.
        leave_out: predict each frame from its neighbours alone; NaN where there are fewer than four.
    """
    X = np.asarray(X, dtype=np.float64)
    weight = np.asarray(weight, dtype=np.float64)
    has_pose = np.isfinite(X).all(axis=(1, 2))
    information = np.full((len(X), 6, 6), np.nan)
    information[has_pose] = np.linalg.inv(np.asarray(covariance)[has_pose] + np.diag(_FLOOR**2))
    segment = np.zeros(len(X), dtype=int)
    for frame in breaks:
        segment[frame:] += 1
    smoothed = np.full_like(X, np.nan) if leave_out else X.copy()
    offset = np.arange(-HALF_WINDOW, HALF_WINDOW + 1)
    near = np.arange(len(X))[:, None] + offset
    counts = (near >= 0) & (near < len(X))
    near = np.where(counts, near, np.arange(len(X))[:, None])
    after: Array = offset.astype(np.float64)
    if place is not None and (place != np.arange(len(place))).any():
        after = place[near] - place[:, None]
        counts &= np.abs(after) <= HALF_WINDOW
    counts &= has_pose[near] & (segment[near] == segment[:, None]) & ~(leave_out & (offset == 0))
    rows = np.flatnonzero(has_pose & (counts.sum(axis=1) >= _MIN_NEIGHBOURS))
    if not len(rows):
        return smoothed
    near = np.where(counts, near, np.arange(len(X))[:, None])[rows]
    counts = counts[rows]
    after = after if after.ndim == 1 else np.where(counts, after[rows], 0.0)
    kernel = (1.0 - np.abs(after / (HALF_WINDOW + 1)) ** 3) ** 3
    weight_near = np.where(counts, kernel * np.maximum(weight[near], 1e-3), 0.0)
    R = X[rows, :3, :3]
    rotation = rotation_log(X[near, :3, :3] @ R[:, None].swapaxes(-1, -2))
    values = np.concatenate([rotation, X[near, :3, 3]], axis=-1)
    value = _local_values(after, values, weight_near, information[near])
    smoothed[rows] = make_pose(rotation_exp(value[:, :3]) @ R, value[:, 3:])
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
    place: Array
    """(T,) times in frame periods."""

    @classmethod
    def from_poses(
        cls,
        poses: Sequence[FramePose | None],
        confidence: Array,
        anomalies: Sequence[Anomaly],
        lost: NDArray[np.bool_],
        X_prior: Array,
        t_s: Array,
    ) -> "RawTrack":
        """Collect poses, without false detections, vanished grippers and frames whose camera pose is lost.

        Args:
            poses: (T,) measurements, including those from priors.
            confidence: (T,) confidence of each frame by itself.
            anomalies: anomalies of the video.
            lost: (T,) frames whose camera pose is unknown.
            X_prior: (T, 4, 4) poses from priors [m], NaN elsewhere; their confidence is 1.
            t_s: (T,) task time [s].
        """
        X_AH = np.stack([np.full((4, 4), np.nan) if p is None else p.X_CH for p in poses])
        X_AH[(confidence < bounds.MIN_CONFIDENCE) | lost] = np.nan
        breaks: list[int] = []
        for anomaly in anomalies:
            after = anomaly.frame_end + 1
            if anomaly.kind is AnomalyKind.VANISH:  # a detection there is false
                X_AH[anomaly.frame_start : after] = np.nan
            if anomaly.kind in (AnomalyKind.TELEPORT, AnomalyKind.VANISH, AnomalyKind.FREEZE):
                breaks.append(anomaly.frame_start)
            if anomaly.kind in (AnomalyKind.VANISH, AnomalyKind.FREEZE):
                breaks.append(after)
        from_prior = np.asarray(np.isfinite(X_prior).all(axis=(1, 2)))
        X_AH[from_prior] = X_prior[from_prior]
        return cls(
            X_AH=X_AH,
            covariance=np.stack([np.zeros((6, 6)) if p is None else p.covariance for p in poses]),
            confidence=np.where(from_prior, 1.0, confidence),
            from_prior=from_prior,
            breaks=tuple(sorted(breaks)),
            place=frame_periods(t_s),
        )

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(T,) frames with a pose."""
        return np.asarray(np.isfinite(self.X_AH).all(axis=(1, 2)))

    def features(self) -> Array:
        """Return the features (T, 4) of `confidence.TRACK_FEATURES`."""
        predicted = smooth_track(
            self.X_AH, self.covariance, self.confidence, self.breaks, place=self.place, leave_out=True
        )
        return track_features(self.confidence, *pose_difference(self.X_AH, predicted))

    def smooth(self, tracked: NDArray[np.bool_], weight: Array) -> Array:
        """Return poses (T, 4, 4) of the `tracked` (T,) frames [m], weighted by `weight` (T,); priors are unchanged."""
        X_AH = np.where(tracked[:, None, None], self.X_AH, np.nan)
        smoothed = smooth_track(X_AH, self.covariance, weight, self.breaks, place=self.place)
        return np.where(self.from_prior[:, None, None], X_AH, smoothed)
