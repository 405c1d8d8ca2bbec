"""Inverse kinematics of a whole track: one joint path for all poses, verified in Drake, free of collisions."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, orthonormalize, pose_difference, rotation_exp
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.ik import POSITION_TOLERANCE_M, ROTATION_TOLERANCE_RAD, solve_pose
from kinebench_drake.kinematics.newton import (
    REACHED_M,
    ROTATION_ARM_M,
    followed_error,
    pose_twists,
    solve_newton,
    solve_newton_path,
    solve_newton_rows,
)
from kinebench_drake.kinematics.path import SAMPLES, grid_postures, limit_excess, search_path, within_limits
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver, spread_postures
from kinebench_drake.segments import spread
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack

CONTACT_TOLERANCE_M = 0.002
"""Penetration depth [m] up to which a contact is no collision: tasks touch the table."""
PROBES = 24
"""Colliding frames that are tested for collision-free postures before the path is searched again."""

_FREE_STARTS = 64  # postures from which a pose is searched that five joints do not reach near the one before
_CONTACTS = (IkStatus.SELF_COLLISION, IkStatus.TABLE_COLLISION, IkStatus.OBSTACLE_COLLISION)


def solve_track(
    plant: ArmPlant,
    track: GripperTrack,
    collision: CollisionModel | None = None,
    *,
    contact_tolerance_m: float = CONTACT_TOLERANCE_M,
    noise_rad: float = 0.0,
    X_plan: Array | None = None,
) -> JointTrack:
    """Solve the joint path of a track: least joint rates, continuous wherever poses and limits allow.

    The path is searched among all postures of all tracked poses (`path.search_path`) and verified in Drake. Poses
    without a posture within limits get the nearest one within limits. Where the path collides, it is searched again
    among collision-free postures; frames without one keep their posture and get a colliding status. Untracked frames
    are left out; their time counts.

    Args:
        track: gripper track; `t_s`, `X_BG`, `tracked` and, for collisions, `finger_width_m` are used.
        collision: collision model; None ignores collisions.
        contact_tolerance_m: penetration depth up to which a contact is no collision [m].
        noise_rad: standard deviation of the joint angles due to the noise of the poses [rad].
        X_plan: (T, 4, 4) denoised poses, for which the path is searched before it is moved to those of the track by
            least joint motion; None searches for the poses of the track.

    Raises:
        InputError: a tracked frame's pose is not finite, or the times do not increase.
    """
    if not (np.diff(track.t_s) > 0.0).all():
        raise InputError("t_s must increase from frame to frame")
    frames = np.flatnonzero(track.tracked)
    t_s = track.t_s[frames]
    X_BG = track.X_BG[frames]
    if not np.isfinite(X_BG).all():
        bad = int(frames[np.flatnonzero(~np.isfinite(X_BG).all(axis=(1, 2)))[0]])
        raise InputError(f"frame {bad} is tracked but its pose is not finite")
    X_BG = make_pose(orthonormalize(X_BG[:, :3, :3]), X_BG[:, :3, 3])
    if X_plan is None:
        path = search_path(plant, t_s, X_BG, plant.robot.rest_q, noise_rad)
    else:
        planned = search_path(plant, t_s, X_plan[frames], plant.robot.rest_q, noise_rad)
        path = solve_newton_path(plant, X_BG, planned)
    joints = verify_path(plant, t_s, X_BG, path)
    if collision is not None:
        joints = _avoid_collisions(
            plant, collision, X_BG, track.finger_width_m[frames], joints, contact_tolerance_m, noise_rad
        )
    return _with_gaps(joints, track, frames)


def settle_free_turns(plant: ArmPlant, X_BG: Array) -> Array:
    """Return the poses (T, 4, 4) that an arm is to follow; NaN stays NaN.

    With six joints and more these are the poses `X_BG` themselves. Five joints follow the position and the direction of
    one axis (`newton.followed_error`): the turn about it, which does not count, is set to the one that comes with them.
    """
    if len(plant.lower) > 5:
        return X_BG
    settled = X_BG.copy()
    finite = np.isfinite(X_BG).all(axis=(1, 2))
    rows = [*map(int, np.flatnonzero(finite & ~(posture_solver(plant).out_of_reach_m(X_BG) > 0.0)))]
    chosen: dict[int, Array] = {}
    q = plant.robot.rest_q
    for i in rows:
        near, error = solve_newton(plant, X_BG[i], q, iterations=20)
        reaching = near[None]
        if error > REACHED_M or pose_difference(plant.forward(near), X_BG[i])[1] > ROTATION_TOLERANCE_RAD:
            starts = spread_postures(plant, _FREE_STARTS)
            postures = solve_newton_rows(plant, np.broadcast_to(X_BG[i], (len(starts), 4, 4)), starts)
            postures = postures[np.isfinite(postures).all(axis=-1)]
            reaching = np.vstack([near, postures]) if error <= REACHED_M or not len(postures) else postures
        q = reaching[np.argmin(_turn_costs(plant, X_BG[i], reaching))]
        chosen[i] = q
    for i, after in zip(rows[-2::-1], rows[:0:-1], strict=True):  # what the search finds late leads back
        near, error = solve_newton(plant, X_BG[i], chosen[after], iterations=20)
        both = np.stack([chosen[i], near])
        if error <= REACHED_M and np.subtract(*_turn_costs(plant, X_BG[i], both)) > ROTATION_TOLERANCE_RAD:
            chosen[i] = near
    for i, q in chosen.items():
        X_now, J = plant.forward_and_jacobian(q)
        weight = np.repeat([ROTATION_ARM_M, 1.0], 3)
        error_G = weight * pose_twists(X_BG[[i]], X_now[None])[0]
        free = (error_G - followed_error(weight[:, None] * J, error_G)[0])[:3] / ROTATION_ARM_M
        settled[i, :3, :3] = rotation_exp(free) @ X_BG[i, :3, :3]
    return settled


def _turn_costs(plant: ArmPlant, X_BG: Array, q: Array) -> Array:
    """Return the turns (N,) [rad] from postures (N, J) to a pose (4, 4), beyond half a turn if past a limit."""
    past = limit_excess(plant, q).max(axis=-1)
    return pose_difference(plant.forward_path(q), X_BG)[1] + np.where(past > 0.0, np.pi + past, 0.0)


def verify_path(plant: ArmPlant, t_s: Array, X_BG: Array, path: Array) -> JointTrack:
    """Return the path (n, J) where Drake confirms it; other frames are solved again from the previous frame."""
    finite = np.asarray(np.isfinite(path).all(axis=-1))
    q = np.where(finite[:, None], path, plant.robot.rest_q)
    position, rotation = pose_difference(plant.forward_path(q), X_BG)
    ok = finite & (limit_excess(plant, q).max(axis=-1, initial=0.0) <= 0.0)
    ok &= (position <= POSITION_TOLERANCE_M) & (rotation <= ROTATION_TOLERANCE_RAD)
    status = [IkStatus.OK] * len(q)
    for i in np.flatnonzero(~ok):
        solution = solve_pose(plant, X_BG[i], q[i] if finite[i] or i == 0 else q[i - 1])
        q[i] = solution.q
        status[i] = solution.status
        position[i] = solution.position_error_m
        rotation[i] = solution.rotation_error_rad
    return JointTrack(t_s=t_s, q=q, status=tuple(status), position_error_m=position, rotation_error_rad=rotation)


def _avoid_collisions(
    plant: ArmPlant,
    collision: CollisionModel,
    X_BG: Array,
    finger_width_m: Array,
    joints: JointTrack,
    tolerance_m: float,
    noise_rad: float,
) -> JointTrack:
    """Return the path with collisions avoided where possible; the other colliding frames get a colliding status."""
    widths = np.where(np.isfinite(finger_width_m), finger_width_m, plant.finger_width_m)
    allowed: dict[int, Callable[[Array], NDArray[np.bool_]]] = {}
    stuck: set[int] = set()
    colliding, of_tool, kinds = _find_contacts(plant, collision, joints, widths, tolerance_m)

    def free(frame: int, q: Array) -> NDArray[np.bool_]:
        return _free(collision, q, widths[frame], tolerance_m)

    def free_if_any(frame: int, q: Array) -> NDArray[np.bool_]:
        """Return which postures (N,) are free of collisions; all of them if none is."""
        some = free(frame, q)
        return some if some.any() else np.ones(len(q), dtype=bool)

    def is_hopeless(frame: int) -> bool:
        """Return whether every posture on a grid of the frame collides."""
        [q] = grid_postures(plant, X_BG[[frame]], SAMPLES[1])
        return not free(frame, q).any()

    for _ in range(3):  # searches of a path that collides
        # The pose fixes the tool: if the tool meets the table, no posture avoids it.
        stuck |= {int(i) for i in np.flatnonzero(colliding & of_tool)}
        fresh = sorted({int(i) for i in np.flatnonzero(colliding)} - stuck - set(allowed))
        # Of many frames a sample is tested first: if none of it has a free posture, the rest is taken to have none.
        probes = {fresh[k] for k in np.linspace(0, len(fresh) - 1, min(len(fresh), PROBES)).astype(int)}
        hopeless = {i for i in probes if is_hopeless(i)}
        if hopeless == probes:
            break
        stuck |= hopeless
        allowed |= {i: partial(free_if_any, i) for i in fresh if i not in hopeless}
        path = search_path(plant, joints.t_s, X_BG, plant.robot.rest_q, noise_rad, allowed)
        joints = verify_path(plant, joints.t_s, X_BG, path)
        colliding, of_tool, kinds = _find_contacts(plant, collision, joints, widths, tolerance_m)
    status = list(joints.status)
    for i in np.flatnonzero(colliding):
        status[i] = _CONTACTS[kinds[i]]
    return replace(joints, status=tuple(status))


def _find_contacts(
    plant: ArmPlant, collision: CollisionModel, joints: JointTrack, widths_m: Array, tolerance_m: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.intp]]:
    """Return the reached frames (n,) with a collision, those whose tool hits the table, the kinds (`_CONTACTS`)."""
    measures = collision.self_distance, collision.table_distance, collision.obstacle_distance
    itself, table, obstacle = (measure(joints.q, widths_m) for measure in measures)
    tool = np.array([pair is not None and pair[0] in plant.tool for pair in table.pair], dtype=bool)
    distance = np.nan_to_num([each.distance_m for each in (itself, table, obstacle)], nan=np.inf)
    colliding = joints.ok & (distance.min(axis=0) < -tolerance_m)
    return colliding, tool & (table.distance_m < -tolerance_m), distance.argmin(axis=0)


def _free(collision: CollisionModel, q: Array, finger_width_m: float, tolerance_m: float) -> NDArray[np.bool_]:
    """Return which postures (N,) of `q` (N, J) [rad] are free of collisions."""
    free = np.ones(len(q), dtype=bool)
    for measure in (collision.table_distance, collision.self_distance, collision.obstacle_distance):  # cheap ones first
        free[free] = ~(measure(q[free], np.full(int(free.sum()), finger_width_m)).distance_m < -tolerance_m)
    return free


def find_free(
    plant: ArmPlant, collision: CollisionModel, track: GripperTrack, frames: NDArray[np.bool_], tolerance_m: float
) -> NDArray[np.bool_]:
    """Return which of the tracked `frames` (T,) have a posture within limits and free of collisions.

    The postures are on a grid of the pose. `tolerance_m` is the penetration depth up to which a contact is no collision
    [m].
    """
    free = np.zeros(len(frames), dtype=bool)
    for i in np.flatnonzero(frames):
        [q] = within_limits(plant, grid_postures(plant, track.X_BG[[i]], SAMPLES[1]))
        width = track.finger_width_m[i]
        free[i] = _free(collision, q, width if np.isfinite(width) else plant.finger_width_m, tolerance_m).any()
    return free


def _with_gaps(joints: JointTrack, track: GripperTrack, frames: NDArray[np.intp]) -> JointTrack:
    """Return the joint track with the untracked frames inserted."""
    n = len(track.t_s)
    results = (joints.q, joints.position_error_m, joints.rotation_error_rad)
    q, position, rotation = (spread(values, frames, n) for values in results)
    status = [IkStatus.NOT_TRACKED] * n
    for i, s in zip(frames, joints.status, strict=True):
        status[i] = s
    return JointTrack(t_s=track.t_s, q=q, status=tuple(status), position_error_m=position, rotation_error_rad=rotation)
