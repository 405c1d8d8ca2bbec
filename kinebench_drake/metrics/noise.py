"""Estimation of the noise of a track from the track alone, assuming a smooth motion and white noise.

A difference of order k over k + 1 frames reduces a smooth motion to nearly zero and maps white noise of standard
deviation sigma to sqrt(C(2k, k)) sigma (J. von Neumann, Ann. Math. Stat. 12, 1941, for k = 1; P. Hall, J. W. Kay, D. M.
Titterington, Biometrika 77, 1990, for higher orders). The rest of the motion adds to the estimate, so the least over
several orders is used. The scale of the differences is their median magnitude (F. R. Hampel, J. Am. Stat. Assoc. 69,
1974), which outliers and the fastest half of a motion do not affect. Noise that is correlated from frame to frame is
detected only in part.
"""

from dataclasses import dataclass, fields
from math import comb

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, from_quaternion, rotation_log, to_quaternion
from kinebench_drake.metrics.derivatives import smooth_path
from kinebench_drake.segments import finite_rows, rounding_unit, segments, spread
from kinebench_drake.track import GripperTrack

ORDERS = (2, 3, 4, 5, 6)
"""Orders of the differences."""
FREEDOM_PER_FRAME = 0.6
"""Degrees of freedom of the estimate for a pose track, per frame.

Measured on white noise: a normal deviate over `TrackNoise` follows Student's t with 0.6 T degrees of freedom from 10
frames on (its 99.99 % quantile to 9 % from 16 frames on; below 10 frames Student's t is conservative).
"""
JOINT_FREEDOM_PER_FRAME = 0.2
"""Degrees of freedom per frame of `estimate_joint_noise`, measured as 0.21 to 0.23: one axis, not the mean of three."""
NORMAL_MEDIAN = 0.6744897501960817
"""Median of |x| for a standard normal x."""
MIN_DIFFERENCES = 3
"""Least number of differences of an order; with fewer, the order is not used."""
ROTATION_UNITS = 2.0
"""Rotation error of a rounded quaternion, in errors of one of its numbers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackNoise:
    """Noise of a pose track: white noise as standard deviation per axis, NaN for too short a track, and offsets.

    An offset is an error common to neighbouring frames, which no difference between frames shows.
    """

    position_m: float
    """Root mean square over the three axes of B [m]."""
    rotation_rad: float
    """Root mean square over the rotation vector's three components [rad]."""
    offset_m: float = 0.0
    """Greatest position error common to neighbouring poses [m], stated by the source of the track."""
    offset_rad: float = 0.0
    """Greatest rotation error common to neighbouring poses [rad], stated by the source of the track."""

    def scaled(self, factor: float) -> "TrackNoise":
        """Return the noise with every error multiplied by a factor."""
        return TrackNoise(**{f.name: factor * getattr(self, f.name) for f in fields(self)})


def estimate_track_noise(t_s: Array, X_BG: Array, tracked: NDArray[np.bool_]) -> TrackNoise:
    """Estimate the noise of a track of poses `X_BG` (T, 4, 4) [m] at times `t_s` (T,) [s], from runs of tracked frames.

    Rotations are differenced as rotation vectors in B from each frame to the next. An order of difference is used if
    the runs contain MIN_DIFFERENCES of it; a track with none (in general without 5 consecutive frames) gives NaN:
    unknown.
    """
    pieces = [run for run in segments(tracked) if run.stop - run.start > ORDERS[0]]
    times = [t_s[run] for run in pieces]
    moves = [np.diff(X_BG[run, :3, 3], axis=0) for run in pieces]
    turns = [rotation_steps(X_BG[run, :3, :3]) for run in pieces]
    estimated_m = float(np.sqrt(np.mean(_variance(times, moves, 3))))
    estimated_rad = float(np.sqrt(np.mean(_variance(times, turns, 3))))
    rounding = float(rounding_deviation(X_BG[tracked, :3, 3]).max())
    # Rotations are stored with as many digits as positions.
    return TrackNoise(position_m=max(estimated_m, rounding), rotation_rad=max(estimated_rad, ROTATION_UNITS * rounding))


def estimate_joint_noise(t_s: Array, q: Array) -> Array:
    """Estimate the noise (7,) [rad] of joint angles `q` (T, 7) at `t_s` (T,) [s], ignoring NaN; NaN if too short."""
    pieces = [run for run in segments(finite_rows(q)) if run.stop - run.start > ORDERS[0]]
    variance = _variance([t_s[run] for run in pieces], [np.diff(q[run], axis=0) for run in pieces], q.shape[1])
    return np.asarray(np.maximum(np.sqrt(variance), rounding_deviation(q[finite_rows(q)])))


def propagate_noise(jacobians: Array, noise: TrackNoise) -> Array:
    """Propagate the noise of a pose track to standard deviations (T, 7) [rad] of the joint angles that follow it.

    To first order sigma_j^2 = sum_i (J+)_ji^2 sigma_i^2, of Jacobians (T, 6, 7) with angular rows first, which grows
    without bound towards a singularity; rows of NaN give NaN.
    """
    finite = np.asarray(np.isfinite(jacobians).all(axis=(-2, -1)))
    variance = np.repeat([noise.rotation_rad**2, noise.position_m**2], 3)
    return spread(np.sqrt(np.linalg.pinv(jacobians[finite]) ** 2 @ variance), finite, len(jacobians))


def rotation_steps(R: Array) -> Array:
    """Return the rotation vectors (T - 1, 3) [rad] from each of `R` (T, 3, 3) to the next, in the frame of `R`."""
    turns = rotation_log(np.swapaxes(R[:-1], -1, -2) @ R[1:])
    return np.asarray((R[:-1] @ turns[..., None])[..., 0])


def _variance(times: list[Array], steps: list[Array], axes: int) -> Array:
    """Estimate variances (axes,) of white noise from the first differences (n - 1, axes) of pieces of a track."""
    least = np.full(axes, np.nan)
    for order in ORDERS:
        differences = [_unit_differences(t, d, order) for t, d in zip(times, steps, strict=True) if len(t) > order]
        pooled = np.concatenate([np.empty((0, axes)), *differences])
        if len(pooled) < MIN_DIFFERENCES:
            break
        variance = (np.median(np.abs(pooled), axis=0) / NORMAL_MEDIAN) ** 2
        # All axes share the order of the least total: a choice per axis would increase the bias of the minimum.
        if not variance.sum() >= least.sum():
            least = variance
    return least


def rounding_deviation(values: Array) -> Array:
    """Return the standard deviation (N,) of the errors of columns of values (T, N) that were rounded; 0 for others.

    Most differences of a slow motion that was rounded are 0, and hide these errors: they are uniform over one unit of
    the last digit.
    """
    return np.asarray(rounding_unit(values) / np.sqrt(12.0))


def _unit_differences(t_s: Array, steps: Array, order: int) -> Array:
    """Return differences (n - order, axes) of `order`, scaled so that white noise keeps its standard deviation.

    Of first differences `steps` (n - 1, axes) at times `t_s` (n,) [s]: plain differences where these are even, else
    divided differences.
    """
    dt = np.diff(t_s)
    if np.ptp(dt) <= 1e-6 * dt.mean():
        return np.asarray(np.diff(steps, order - 1, axis=0) / np.sqrt(comb(2 * order, order)))
    t = t_s / dt.mean()
    divided = steps / np.diff(t)[:, None]
    for k in range(2, order + 1):
        divided = np.diff(divided, axis=0) / (t[k:] - t[:-k])[:, None]
    window = np.lib.stride_tricks.sliding_window_view(t, order + 1)
    apart = window[:, :, None] - window[:, None, :] + np.eye(order + 1)
    gain = np.linalg.norm(1.0 / apart.prod(axis=-1), axis=-1)  # norm of Newton's weights of a divided difference
    return np.asarray(divided / gain[:, None])


def smooth_poses(track: GripperTrack, noise: TrackNoise) -> Array:
    """Return the poses X_BG (T, 4, 4) [m] of the track, smoothed as far as its noise explains; NaN where untracked.

    Positions and quaternions are smoothed like joint paths (`derivatives.smooth_path`); a quaternion changes by half
    the angle, so its noise is half that of the rotation.
    """
    frames = np.flatnonzero(track.tracked)
    n = len(track.t_s)
    turned = to_quaternion(track.X_BG[frames, :3, :3])
    # q and -q are the same rotation: each gets the sign nearest to the previous one.
    flips = np.sum(turned[1:] * turned[:-1], axis=-1) < 0.0
    turned[1:] *= np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)[:, None]
    p = smooth_path(track.t_s, spread(track.X_BG[frames, :3, 3], frames, n), np.full(3, noise.position_m))
    quaternion = smooth_path(track.t_s, spread(turned, frames, n), np.full(4, 0.5 * noise.rotation_rad))
    return spread(from_quaternion(quaternion[frames], p[frames]), frames, n)
