"""The track that a noisy track is a record of, as well as smoothing can tell: what the redundancy is planned on."""

import numpy as np

from kinebench_drake.geometry import Array, from_quaternion, to_quaternion
from kinebench_drake.metrics.derivatives import smooth_path
from kinebench_drake.metrics.noise import TrackNoise
from kinebench_drake.products import GripperTrack


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
