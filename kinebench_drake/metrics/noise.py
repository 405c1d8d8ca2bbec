"""How noisy a track is, from the track alone: the motion is smooth, the noise is not.

A difference of order k over k + 1 frames takes a smooth motion to nearly nothing and white noise of standard deviation
sigma to sqrt(C(2k, k)) sigma (difference-based variance estimation: J. von Neumann, Ann. Math. Stat. 12, 1941, for
k = 1; P. Hall, J. W. Kay, D. M. Titterington, Biometrika 77, 1990, for higher orders). Whatever the motion leaves adds
to the estimate. So each order bounds the noise from above, and the least over several orders is taken. The scale of the
differences is read off their median magnitude (F. R. Hampel, J. Am. Stat. Assoc. 69, 1974), which outliers and the
quickest half of a motion do not reach.

Noise that is correlated from frame to frame, such as what a smoothing tracker leaves, is seen only in part.
"""

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array, from_quaternion, rotation_log, to_quaternion
from kinebench_drake.metrics.derivatives import smooth_path
from kinebench_drake.segments import complete, segments
from kinebench_drake.types import GripperTrack

ORDERS = (2, 3, 4, 5, 6)
"""Orders of difference that are tried."""
MIN_DIFFERENCES = 3
"""Fewest differences of one order that are asked for their median; below, that order says nothing."""
FREEDOM_A_FRAME = 0.6
"""Degrees of freedom that the estimate for a pose track has for each frame that it is made from.

Measured on white noise: a normal deviate over `TrackNoise` follows Student's t with 0.6 T degrees of freedom from 10
frames on (its 99.99 % quantile to 9 % from 16 frames on; below 10, Student's is the more cautious).
"""
JOINT_FREEDOM_A_FRAME = 0.2
"""The same for each joint of `joint_noise`, measured as 0.21 to 0.23: one axis, not the mean of three."""

_MEDIAN_OF_NORMAL = 0.6744897501960817  # median of |x| for a standard normal x


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackNoise:
    """White noise of a pose track, one standard deviation along or about an axis, NaN where too short to tell.

    And what no difference between frames shows, because neighbours err alike.
    """

    position_m: float
    """Root mean square over the three axes of B [m]."""
    rotation_rad: float
    """Root mean square over the rotation vector's three components [rad]."""
    offset_m: float = 0.0
    """How far neighbouring poses may be off alike [m], as the track's maker tells."""
    offset_rad: float = 0.0
    """The same of their rotation [rad]."""


def track_noise(t_s: Array, X_BG: Array, tracked: NDArray[np.bool_]) -> TrackNoise:
    """Noise of a track of poses, from runs of consecutive tracked frames.

    Positions are differenced as they are; of the rotations the turn from each frame to the next, as a rotation vector
    in B, is the first difference, which is differenced further. An order of difference counts if the runs hold
    MIN_DIFFERENCES of it; a track with none (no 5 consecutive frames, as a rule) gives NaN: not known, not 0.

    Args:
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in B [m].
        tracked: (T,) frames that count.
    """
    pieces = [run for run in segments(tracked) if run.stop - run.start > ORDERS[0]]
    times = [t_s[run] for run in pieces]
    moves = [np.diff(X_BG[run, :3, 3], axis=0) for run in pieces]
    turns = [rotation_steps(X_BG[run, :3, :3]) for run in pieces]
    return TrackNoise(
        position_m=float(np.sqrt(np.mean(_variance(times, moves, 3)))),
        rotation_rad=float(np.sqrt(np.mean(_variance(times, turns, 3)))),
    )


def joint_noise(t_s: Array, q: Array) -> Array:
    """Noise (7,) [rad] of joint angles `q` (T, 7) at `t_s` (T,) [s], rows of NaN left out; NaN where too short."""
    pieces = [run for run in segments(complete(q)) if run.stop - run.start > ORDERS[0]]
    variance = _variance([t_s[run] for run in pieces], [np.diff(q[run], axis=0) for run in pieces], q.shape[1])
    return np.asarray(np.sqrt(variance))


def carried_noise(jacobians: Array, noise: TrackNoise) -> Array:
    """Standard deviations (T, 7) [rad] of joint angles that follow a noisy pose track.

    To first order the joints follow the poses through the pseudo-inverse of the Jacobian, so that
    sigma_j^2 = sum_i (J+)_ji^2 sigma_i^2. It grows without bound towards a singularity, as the joints' noise does.

    Args:
        jacobians: (T, 6, 7) of `plant.jacobian`, angular rows first; rows of NaN give NaN.
        noise: of the pose track.
    """
    known = np.isfinite(jacobians).all(axis=(-2, -1))
    sigma = np.full(jacobians.shape[::2], np.nan)
    variance = np.repeat([noise.rotation_rad**2, noise.position_m**2], 3)
    sigma[known] = np.sqrt(np.linalg.pinv(jacobians[known]) ** 2 @ variance)
    return sigma


def rotation_steps(R: Array) -> Array:
    """Rotation vectors (T - 1, 3) [rad] that turn each of `R` (T, 3, 3) into the next, in the frame of `R`."""
    turns = rotation_log(np.swapaxes(R[:-1], -1, -2) @ R[1:])
    return np.asarray((R[:-1] @ turns[..., None])[..., 0])


def _variance(times: list[Array], steps: list[Array], axes: int) -> Array:
    """Variances (axes,) of white noise in pieces of a track, given their first differences (n - 1, axes)."""
    least = np.full(axes, np.nan)
    for order in ORDERS:
        differences = [_unit_differences(t, d, order) for t, d in zip(times, steps, strict=True) if len(t) > order]
        found = np.concatenate([np.empty((0, axes)), *differences])
        if len(found) < MIN_DIFFERENCES:
            break
        variance = (np.median(np.abs(found), axis=0) / _MEDIAN_OF_NORMAL) ** 2
        # All axes take one order, that of the least total: choosing for each would bias the least further.
        if not variance.sum() >= least.sum():
            least = variance
    return least


def _unit_differences(t_s: Array, steps: Array, order: int) -> Array:
    """Differences (n - order, axes) of `order`, scaled so that white noise keeps its standard deviation.

    Args:
        t_s: (n,) times [s].
        steps: (n - 1, axes) first differences.
        order: k; the k-th difference at even times, else the k-th divided difference.
    """
    dt = np.diff(t_s)
    if np.ptp(dt) <= 1e-6 * dt.mean():
        return np.asarray(np.diff(steps, order - 1, axis=0) / np.sqrt(comb(2 * order, order)))
    scale = dt.mean()
    t = t_s / scale
    divided = steps / np.diff(t)[:, None]
    for k in range(2, order + 1):
        divided = np.diff(divided, axis=0) / (t[k:] - t[:-k])[:, None]
    window = np.lib.stride_tricks.sliding_window_view(t, order + 1)
    apart = window[:, :, None] - window[:, None, :] + np.eye(order + 1)
    gain = np.linalg.norm(1.0 / apart.prod(axis=-1), axis=-1)  # Newton's weights of a divided difference
    return np.asarray(divided / gain[:, None])


def smooth_poses(track: GripperTrack, noise: TrackNoise) -> Array:
    """Poses X_BG (T, 4, 4) [m] of the track with its noise smoothed away; NaN where it is not tracked.

    Positions and quaternions are smoothed as joint paths are (`derivatives.smooth_path`); a quaternion moves by half
    of the angle, so its noise is half of the rotation's.
    """
    frames = np.flatnonzero(track.tracked)
    p, quaternion = np.full((len(track.t_s), 3), np.nan), np.full((len(track.t_s), 4), np.nan)
    p[frames] = track.X_BG[frames, :3, 3]
    turned = to_quaternion(track.X_BG[frames, :3, :3])
    # q and -q are one rotation: each takes the sign nearest to the one before.
    flips = np.sum(turned[1:] * turned[:-1], axis=-1) < 0.0
    turned[1:] *= np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)[:, None]
    quaternion[frames] = turned
    p = smooth_path(track.t_s, p, np.full(3, noise.position_m))
    quaternion = smooth_path(track.t_s, quaternion, np.full(4, 0.5 * noise.rotation_rad))
    X_BG = np.full_like(track.X_BG, np.nan)
    X_BG[frames] = from_quaternion(quaternion[frames], p[frames])
    return X_BG
