"""Smoothing of per-frame poses on SE(3)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp, rotation_log
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.tracking.pose import FramePose, track_features
from kinebench_drake.segments import frame_periods

HALF_WINDOW = 3
"""Number of frames before and after a frame that its pose is smoothed with."""
ON_PATH_M = 0.025
"""Greatest distance of a doubtful pose from the path of its neighbours that confirms it [m]."""
ON_PATH_RAD = float(np.deg2rad(10.0))
"""The same of its rotation [rad]."""
ON_PATH_CONFIDENCE = 0.6
"""Confidence of such a pose once it is smoothed.

In clean clips of robosuite and PyBullet 9 of 14 are within 10 mm and 5 degrees, all within 15 mm and 14 degrees."""
_PATH_FRAMES = 2
"""Fewest of three tracked frames on each side of it."""
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
    X: Array,
    covariance: Array,
    weight: Array,
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
    has_pose = np.asarray(np.isfinite(X).all(axis=(1, 2)))
    information = np.full((len(X), 6, 6), np.nan)
    information[has_pose] = np.linalg.inv(covariance[has_pose] + np.diag(_FLOOR**2))
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
    values = np.concatenate([rotation_log(X[near, :3, :3] @ R[:, None].swapaxes(-1, -2)), X[near, :3, 3]], axis=-1)
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
        gaps = [anomaly for anomaly in anomalies if anomaly.kind in (AnomalyKind.VANISH, AnomalyKind.FREEZE)]
        for gap in gaps:
            if gap.kind is AnomalyKind.VANISH:  # a detection there is false
                X_AH[gap.frame_start : gap.frame_end + 1] = np.nan
        jumps = [anomaly.frame_start for anomaly in anomalies if anomaly.kind is AnomalyKind.TELEPORT]
        breaks = [*jumps, *(frame for gap in gaps for frame in (gap.frame_start, gap.frame_end + 1))]
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

    def on_path(self, tracked: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the frames (T,) that are not `tracked` (T,), but have a pose on the path of tracked ones.

        At least two frames of the three before and of the three after are tracked, and predict the pose within
        ON_PATH_M and ON_PATH_RAD.
        """
        weight = np.where(tracked, self.confidence, 0.0)
        predicted = smooth_track(self.X_AH, self.covariance, weight, self.breaks, place=self.place, leave_out=True)
        distance, angle = pose_difference(self.X_AH, predicted)
        padded = np.concatenate([[0] * HALF_WINDOW, tracked, [0] * HALF_WINDOW]).cumsum()
        total = np.concatenate([[0], padded])
        frames = np.arange(len(tracked)) + HALF_WINDOW
        before = total[frames] - total[frames - HALF_WINDOW]
        after = total[frames + 1 + HALF_WINDOW] - total[frames + 1]
        near = (distance <= ON_PATH_M) & (angle <= ON_PATH_RAD)
        return np.asarray(~tracked & near & (np.minimum(before, after) >= _PATH_FRAMES))

    def smooth(self, tracked: NDArray[np.bool_], weight: Array) -> Array:
        """Return poses (T, 4, 4) of the `tracked` (T,) frames [m], weighted by `weight` (T,); priors are unchanged."""
        X_AH = np.where(tracked[:, None, None], self.X_AH, np.nan)
        smoothed = smooth_track(X_AH, self.covariance, weight, self.breaks, place=self.place)
        return np.where(self.from_prior[:, None, None], X_AH, smoothed)
