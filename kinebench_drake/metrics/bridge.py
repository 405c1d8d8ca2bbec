"""Bridges over short gaps of a track: poses of lost frames, where the track's own motion shows that they are sound.

A gap is bridged by a cubic spline through the three poses before and the three after it. Whether that is sound depends
on speed, frame rate and noise, so it is tried on the track itself: gaps of the same length are cut into its complete
stretches, and the bridges over them are compared with the poses that were there.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from kinebench_drake.geometry import Array, make_pose, pose_difference
from kinebench_drake.segments import finite_rows, segments
from kinebench_drake.track import GripperTrack

BRIDGE_M = 0.010
BRIDGE_RAD = float(np.deg2rad(5.0))
"""Errors within which a bridged pose is sound: those of a good pose."""
BRIDGE_FRAMES = 5
"""Longest gap that is bridged [frames]."""
SURE = 0.5
"""Least confidence of the poses on both sides of a gap."""
_SIDE = 3  # poses on each side that determine a bridge


def bridge_gaps(track: GripperTrack) -> tuple[GripperTrack, NDArray[np.bool_]]:
    """Fill the gaps of a track that are bridged soundly.

    Args:
        track: track; its frames that are not tracked are lost.

    Returns:
        The track with poses in the bridged frames, which count as tracked there, and the mask (T,) of these frames.
        Their confidence and gap between the fingers stay as they are.
    """
    bridged = np.zeros(len(track.t_s), dtype=bool)
    X_BG = track.X_BG.copy()
    longest = None
    for gap in segments(~track.tracked):
        inside = gap.start > 0 and gap.stop < len(track.t_s)
        if not inside or track.confidence[[gap.start - 1, gap.stop]].min() < SURE:
            continue
        longest = longest_bridge(track) if longest is None else longest
        if gap.stop - gap.start <= longest:
            X_BG[gap] = _bridge(track.t_s, track.X_BG, _knots(track.tracked, gap), gap)
            bridged[gap] = True
    if not bridged.any():
        return track, bridged
    return replace(track, X_BG=X_BG, tracked=track.tracked | bridged), bridged


def bridge_joints(t_s: Array, q: Array, bridged: NDArray[np.bool_]) -> Array:
    """Return the joint angles (T, 7) [rad] in bridged frames (T,), of splines through their neighbours; NaN elsewhere.

    `q` (T, 7) are the angles of the track; a gap beside frames without is left NaN.
    """
    filled = np.full_like(q, np.nan)
    for gap in segments(bridged):
        if finite_rows(q[[gap.start - 1, gap.stop]]).all():
            knots = _knots(finite_rows(q), gap)
            filled[gap] = CubicSpline(t_s[knots], q[knots], bc_type="natural")(t_s[gap])
    return filled


def longest_bridge(track: GripperTrack) -> int:
    """Return the greatest number of lost frames in a row, up to BRIDGE_FRAMES, that are bridged soundly.

    Sound are lengths at which 95 % of the gaps cut into the track, ten at least, are bridged within
    BRIDGE_M and BRIDGE_RAD in each frame.
    """
    for length in range(1, BRIDGE_FRAMES + 1):
        sound = []
        for start in range(1, len(track.t_s) - length):
            gap = slice(start, start + length)
            if not track.tracked[start - 1 : gap.stop + 1].all():
                continue
            knots = _knots(track.tracked, gap)
            distance, angle = pose_difference(_bridge(track.t_s, track.X_BG, knots, gap), track.X_BG[gap])
            sound.append(bool(distance.max() <= BRIDGE_M and angle.max() <= BRIDGE_RAD))
        if len(sound) < 10 or np.mean(sound) < 0.95:
            return length - 1
    return BRIDGE_FRAMES


def _knots(tracked: NDArray[np.bool_], gap: slice) -> NDArray[np.intp]:
    """Return the frames that a bridge over a gap goes through."""
    before = np.flatnonzero(tracked[: gap.start])
    after = np.flatnonzero(tracked[gap.stop :]) + gap.stop
    return np.concatenate([before[-_SIDE:], after[:_SIDE]])


def _bridge(t_s: Array, X_BG: Array, knots: NDArray[np.intp], gap: slice) -> Array:
    """Return the poses (n, 4, 4) in a gap, of natural cubic splines of position and rotation through the knots."""
    position = CubicSpline(t_s[knots], X_BG[knots, :3, 3], bc_type="natural")(t_s[gap])
    rotation = RotationSpline(t_s[knots], Rotation.from_matrix(X_BG[knots, :3, :3]))(t_s[gap])
    return make_pose(rotation.as_matrix(), position)
