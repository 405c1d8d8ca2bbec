"""Lost and unreachable frames of a track, and their part in its numbers: no number may improve because of them.

A frame is *lost* without a pose, and *unreachable* if the nearest posture within limits misses its pose by MISS_M or
more. In a track that has either, the manipulability is the least that it can be: 0 in these frames, and elsewhere that
of the worst posture within limits that reaches the pose, as the postures of the other frames are open, too.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.manipulability import Manipulability, compute_manipulability, cost
from kinebench_drake.kinematics.newton import ROTATION_ARM_M, pose_twists
from kinebench_drake.kinematics.path import grid_postures
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.segments import finite_rows
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
_PRODUCTS = ("full", "translation", "rotation", "limited")  # fields of Manipulability that shrink with the weight


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
        n = len(self.lost)
        lost = int(self.lost.sum())
        unreachable = int(self.unreachable.sum())
        counts = {"lost": lost, "out of reach": unreachable}
        return ", ".join(f"{count} of {n} frames are {kind}" for kind, count in counts.items() if count)


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
