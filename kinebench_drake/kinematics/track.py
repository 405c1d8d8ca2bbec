"""Inverse kinematics of a whole track: one joint path for all its poses, verified in Drake, clear of collisions."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, orthonormalize, pose_difference
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.ik import POSITION_TOLERANCE_M, ROTATION_TOLERANCE_RAD, postures_of, solve_pose
from kinebench_drake.kinematics.newton import least_motion, newton_path, twists
from kinebench_drake.kinematics.path import SAMPLES, candidates, continued_path, excess, is_sound, smoothest_path
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.types import GripperTrack, IkStatus, JointTrack

CONTACT_TOLERANCE_M = 0.002
"""Depth [m] up to which bodies that touch do not collide: tasks touch the table."""
JUMP_RAD = 0.5
"""A step in which a joint turns this much more than the gripper's motion asks for is a jump between branches [rad]."""

_PROBES = 24  # frames of a collision that are looked at before the path is searched anew
_DETOURS = 3  # times a path that collides is searched anew


def solve_track(
    plant: ArmPlant,
    track: GripperTrack,
    collision: CollisionModel | None = None,
    *,
    contact_tolerance_m: float = CONTACT_TOLERANCE_M,
    noise_rad: float = 0.0,
    X_plan: Array | None = None,
) -> JointTrack:
    """Joint angles along a track: the path that asks least of the joints, continuous wherever poses and limits allow.

    The path is searched among all postures of all tracked poses (`path.smoothest_path`) and verified in Drake. Poses
    without a posture within limits get the nearest that limits allow. Where the path collides, it is searched again
    among the postures that do not; poses that leave none keep theirs and say so. Frames that are not tracked are left
    out, their time counted.

    Args:
        plant: the robot.
        track: the gripper's path; `t_s`, `X_BG`, `tracked` and, for collisions, `finger_width_m` are used.
        collision: bodies to keep clear of; None ignores them.
        contact_tolerance_m: depth up to which touching is no collision [m].
        noise_rad: standard deviation of the noise that the poses bring into the joints [rad].
        X_plan: (T, 4, 4) the track's poses without their noise, as well as they are known: the path is searched for
            these and carried over to the track's own by the least joint motion, lest the redundancy chase the noise.
            None searches for the track's own.

    Raises:
        InputError: a tracked frame's pose is not finite, or the times do not increase.
    """
    if not (np.diff(track.t_s) > 0.0).all():
        raise InputError("t_s must increase from frame to frame")
    frames = np.flatnonzero(track.tracked)
    t_s, X_BG = track.t_s[frames], track.X_BG[frames]
    if not np.isfinite(X_BG).all():
        bad = int(frames[np.flatnonzero(~np.isfinite(X_BG).all(axis=(1, 2)))[0]])
        raise InputError(f"frame {bad} is tracked but its pose is not finite")
    X_BG = make_pose(orthonormalize(X_BG[:, :3, :3]), X_BG[:, :3, 3])
    if X_plan is None:
        path = _search(plant, t_s, X_BG, plant.robot.rest_q, noise_rad)
    else:
        planned = _search(plant, t_s, X_plan[frames], plant.robot.rest_q, noise_rad)
        path = newton_path(plant, X_BG, planned)
    joints = _verified(plant, t_s, X_BG, path, plant.robot.rest_q)
    if collision is not None:
        joints = _clear(plant, collision, X_BG, track.finger_width_m[frames], joints, contact_tolerance_m, noise_rad)
    return _with_gaps(joints, track, frames)


def follow(plant: ArmPlant, t_s: Array, X_BG: Array, q_start: Array) -> JointTrack:
    """Joint angles along a smooth track of poses, started warm from a posture near its first pose: the quick way.

    The path goes on from the start through few frames and is then relaxed as a whole; if that leaves the limits or is
    too fast, the whole search of `solve_track` is done.

    Args:
        plant: the robot.
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in the base [m], rotations orthonormal.
        q_start: (7,) posture [rad] near the first pose.
    """
    q = continued_path(plant, postures_of(plant), t_s, X_BG, np.asarray(q_start, dtype=np.float64))
    if not is_sound(plant, t_s, q):
        q = _search(plant, t_s, X_BG, q_start)
    return _verified(plant, t_s, X_BG, q, q_start)


def branch_jumps(plant: ArmPlant, X_BG: Array, q: Array) -> NDArray[np.intp]:
    """Indices (N,) of postures in `q` (n, 7) [rad] whose step from the one before the poses (n, 4, 4) do not explain.

    A step is explained by the least joint motion that moves the TCP as wanted, J^+ V, the mean of both ends' (the
    trapezoid rule); a branch jump is what remains.
    """
    if len(q) < 2:
        return np.zeros(0, dtype=np.intp)
    inverse = least_motion(plant, q)
    explained = 0.5 * (inverse[:-1] + inverse[1:]) @ twists(X_BG[:-1], X_BG[1:])[..., None]
    return np.flatnonzero(np.abs(np.diff(q, axis=0) - explained[..., 0]).max(axis=-1) > JUMP_RAD) + 1


def _search(
    plant: ArmPlant,
    t_s: Array,
    X_BG: Array,
    q_start: Array,
    noise_rad: float = 0.0,
    allowed: Mapping[int, Callable[[Array], NDArray[np.bool_]]] | None = None,
) -> Array:
    if len(X_BG) == 0:
        return np.zeros((0, 7))
    return smoothest_path(plant, postures_of(plant), t_s, X_BG, q_start, noise_rad, allowed)


def _verified(plant: ArmPlant, t_s: Array, X_BG: Array, path: Array, q_start: Array) -> JointTrack:
    """The path (n, 7) as it is where Drake confirms it, solved anew from the frame before elsewhere."""
    known = np.asarray(np.isfinite(path).all(axis=-1))
    q = np.where(known[:, None], path, q_start)
    position, rotation = pose_difference(np.reshape([plant.forward(row) for row in q], (-1, 4, 4)), X_BG)
    ok = known & (excess(plant, q).max(axis=-1, initial=0.0) <= 0.0)
    ok &= (position <= POSITION_TOLERANCE_M) & (rotation <= ROTATION_TOLERANCE_RAD)
    status = [IkStatus.OK] * len(q)
    for i in np.flatnonzero(~ok):
        solution = solve_pose(plant, X_BG[i], q[i] if known[i] or i == 0 else q[i - 1])
        q[i], status[i] = solution.q, solution.status
        position[i], rotation[i] = solution.position_error_m, solution.rotation_error_rad
    return JointTrack(t_s=t_s, q=q, status=tuple(status), position_error_m=position, rotation_error_rad=rotation)


def _clear(
    plant: ArmPlant,
    collision: CollisionModel,
    X_BG: Array,
    finger_width_m: Array,
    joints: JointTrack,
    tolerance_m: float,
    noise_rad: float,
) -> JointTrack:
    """The path bent around collisions where postures allow it; frames where none does get a colliding status."""
    widths = np.where(np.isfinite(finger_width_m), finger_width_m, plant.finger_width_m)
    allowed: dict[int, Callable[[Array], NDArray[np.bool_]]] = {}
    stuck: set[int] = set()

    def clear(frame: int, q: Array) -> NDArray[np.bool_]:
        """Which postures (N,) collide with nothing; all of them if none does."""
        width = np.full(len(q), widths[frame])
        free = collision.table_distance(q, width).distance_m >= -tolerance_m
        free[free] = collision.self_distance(q[free], width[free]).distance_m >= -tolerance_m
        return np.asarray(free if free.any() else np.ones(len(q), dtype=bool))

    def hopeless(frame: int) -> bool:
        """Whether every posture on a grid of the frame's collides."""
        [q] = candidates(plant, postures_of(plant), X_BG[[frame]], SAMPLES[1])
        return bool(clear(frame, q).all())

    for _ in range(_DETOURS):
        own = collision.self_distance(joints.q, widths)
        table = collision.table_distance(joints.q, widths)
        bad = joints.ok & (np.minimum(own.distance_m, table.distance_m) < -tolerance_m)
        # The tool goes where the pose puts it: if it is the tool that meets the table, no posture helps.
        by_tool = np.array([pair is not None and pair[0] in plant.tool for pair in table.pair], dtype=bool)
        stuck |= {int(i) for i in np.flatnonzero(bad & by_tool & (table.distance_m < -tolerance_m))}
        fresh = {int(i) for i in np.flatnonzero(bad)} - stuck - set(allowed)
        if not fresh:
            break
        # Of many frames some are looked at first: if all of those are past help, so are the rest.
        order = np.array(sorted(fresh))
        probes = order[np.linspace(0, len(order) - 1, min(len(order), _PROBES)).astype(int)]
        lost = {int(i) for i in probes if hopeless(int(i))}
        if len(lost) == len(set(probes.tolist())):
            stuck |= fresh
            continue
        stuck |= lost
        allowed |= {i: partial(clear, i) for i in fresh - lost}
        path = _search(plant, joints.t_s, X_BG, plant.robot.rest_q, noise_rad, allowed)
        joints = _verified(plant, joints.t_s, X_BG, path, plant.robot.rest_q)
    status = list(joints.status)
    for i in np.flatnonzero(bad):
        status[i] = IkStatus.SELF_COLLISION if own.distance_m[i] < table.distance_m[i] else IkStatus.TABLE_COLLISION
    return replace(joints, status=tuple(status))


def _with_gaps(joints: JointTrack, track: GripperTrack, frames: NDArray[np.intp]) -> JointTrack:
    """The joint track with its untracked frames back in."""
    n = len(track.t_s)
    q = np.full((n, 7), np.nan)
    position, rotation = np.full(n, np.nan), np.full(n, np.nan)
    status = [IkStatus.NOT_TRACKED] * n
    q[frames], position[frames], rotation[frames] = joints.q, joints.position_error_m, joints.rotation_error_rad
    for i, s in zip(frames, joints.status, strict=True):
        status[i] = s
    return JointTrack(t_s=track.t_s, q=q, status=tuple(status), position_error_m=position, rotation_error_rad=rotation)
