"""Lost and unreachable frames of a track, and their part in its numbers: no number may improve because of them.

A frame is *lost* without a pose, and *unreachable* if the nearest posture within limits misses its pose by MISS_M or
more. In a track that has either, the manipulability is the least that it can be: 0 in these frames, and elsewhere that
of the worst posture within limits that reaches the pose, as the postures of the other frames are open, too.

A short gap is bridged by a cubic spline through the three poses before and the three after it. Whether that is sound
depends on speed, frame rate and noise, so it is tried on the track itself: gaps of the same length are cut into its
complete stretches, and the bridges over them are compared with the poses that were there.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from kinebench_drake.geometry import Array, make_pose, pose_difference
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.manipulability import Manipulability, compute_manipulability, cost
from kinebench_drake.kinematics.newton import ROTATION_ARM_M, pose_twists
from kinebench_drake.kinematics.path import grid_postures
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.segments import finite_rows, segments
from kinebench_drake.track import GripperTrack, JointTrack

MISS_M = 0.005
"""Pose error [m], rotations weighted by ROTATION_ARM_M, from which on a frame is unreachable: that of a trajectory that
still counts as following its track (`judge.TUBE_M`). Up to it the frame's manipulability falls linearly to 0."""
COST_MAX = 1000.0
"""Greatest manipulability cost of a frame, that of a lost or unreachable one. PyRoki's own, 1e6 at a singularity, would
leave nothing of a mean but the share of such frames."""

# angles of the redundancy among which the worst posture is searched, and their halvings
_SAMPLES = 128
_ROUNDS = 5
_PRODUCTS = ("full", "translation")  # fields of Manipulability that shrink with the weight


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """How far the frames of a track are known and reached."""

    lost: NDArray[np.bool_]
    """(T,) frames without a pose."""
    weight: Array
    """(T,) factor of the manipulability: 1 where the pose is reached, 1 - error / MISS_M where it is missed by less
    than MISS_M, else 0."""
    q: Array
    """(T, 7) postures [rad] to which the weights belong: within limits, NaN where the weight is 0."""
    position_error_m: Array
    """(T,) distance of the TCP from its pose in the nearest posture within limits [m]; NaN where lost."""

    @property
    def unreachable(self) -> NDArray[np.bool_]:
        """(T,) frames with a pose that no posture within limits comes near."""
        return np.asarray(~self.lost & (self.weight == 0.0))

    @property
    def complete(self) -> bool:
        """True if no frame is lost or unreachable."""
        return bool((self.weight > 0.0).all())

    @property
    def reason(self) -> str:
        """Why numbers of an incomplete track are missing."""
        counts = {"lost": int(self.lost.sum()), "out of reach": int(self.unreachable.sum())}
        return ", ".join(f"{count} of {len(self.lost)} frames are {kind}" for kind, count in counts.items() if count)


def cover_poses(plant: ArmPlant, track: GripperTrack, joints: JointTrack, reached: NDArray[np.bool_]) -> Coverage:
    """Return the coverage of a track of poses, of which the path `joints` reaches the frames `reached` (T,).

    The errors of missed poses are those of `solve_pose` from the rest posture: they depend on the pose alone. A common
    error of the track (`offset_m`, `offset_rad`) greater than MISS_M replaces it.
    """
    weight = reached.astype(np.float64)
    q = np.where(reached[:, None], joints.q, np.nan)
    position_error_m = joints.position_error_m.copy()
    limit_m = max(MISS_M, float(np.hypot(track.offset_m, ROTATION_ARM_M * track.offset_rad)))
    for i in np.flatnonzero(track.tracked & ~reached):
        nearest = solve_pose(plant, track.X_BG[i], plant.robot.rest_q)
        position_error_m[i] = nearest.position_error_m
        error_m = float(np.hypot(nearest.position_error_m, ROTATION_ARM_M * nearest.rotation_error_rad))
        if error_m < limit_m:
            weight[i] = 1.0 - error_m / limit_m
            q[i] = nearest.q
    return Coverage(lost=~track.tracked, weight=weight, q=q, position_error_m=position_error_m)


def cover_joints(plant: ArmPlant, q: Array) -> Coverage:
    """Return the coverage of recorded joint angles (T, 7) [rad]: the nearest posture has each angle at its limit."""
    valid = finite_rows(q)
    within = np.clip(q, plant.lower, plant.upper)
    weight = np.zeros(len(q))
    tcp = plant.robot.tcp_link
    twists = pose_twists(plant.chain.poses(within[valid], tcp), plant.chain.poses(q[valid], tcp))
    error_m = np.linalg.norm(twists * np.repeat([ROTATION_ARM_M, 1.0], 3), axis=-1)
    weight[valid] = np.maximum(0.0, 1.0 - error_m / MISS_M)
    q_near = np.where(weight[:, None] > 0.0, within, np.nan)
    position_error_m = np.full(len(q), np.nan)
    position_error_m[valid] = np.linalg.norm(twists[:, 3:], axis=-1)
    return Coverage(lost=~valid, weight=weight, q=q_near, position_error_m=position_error_m)


def weigh_manipulability(plant: ArmPlant, coverage: Coverage, q_bridged: Array) -> Manipulability:
    """Return the manipulability of each frame times its weight: 0 where unreachable, NaN where lost and not bridged.

    `q_bridged` (T, 7) are the postures of the bridged frames [rad], NaN elsewhere.
    """
    bridged = finite_rows(q_bridged)
    w = compute_manipulability(plant, np.where(bridged[:, None], q_bridged, coverage.q))
    weight = np.where(bridged, 1.0, coverage.weight)
    none = coverage.unreachable & (weight > 0.0).any()  # of a track that is out of reach throughout nothing is known
    products = {name: np.where(none, 0.0, getattr(w, name) * weight) for name in _PRODUCTS}
    return _costed(replace(w, **products))


def worst_manipulability(plant: ArmPlant, coverage: Coverage, w: Manipulability, X_BG: Array | None) -> Manipulability:
    """Return the least manipulability (T,) of the frames of an incomplete track: 0 where lost or unreachable.

    `w` is the manipulability along its joint path (`weigh_manipulability`), `X_BG` its poses (T, 4, 4) [m], None if the
    joint angles are recorded, and hence known.
    """
    least = {name: np.where(coverage.lost, 0.0, getattr(w, name)) for name in _PRODUCTS}
    frames = np.flatnonzero(coverage.weight == 1.0)
    if X_BG is not None and len(frames):
        layers = grid_postures(plant, X_BG[frames], _SAMPLES, _ROUNDS)  # to just past the limits, to cover those at one
        postures = compute_manipulability(plant, np.concatenate(layers))
        own = np.repeat(frames, [len(layer) for layer in layers])
        for name in _PRODUCTS:  # of the poses alone, not of the joint path, which other lost frames may change
            least[name][own] = np.inf
            np.minimum.at(least[name], own, 0.99 * getattr(postures, name))  # allowance for worse postures between them
    return _costed(replace(w, **least))


def _costed(w: Manipulability) -> Manipulability:
    return replace(w, cost=np.minimum(cost(w.translation), COST_MAX))


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
