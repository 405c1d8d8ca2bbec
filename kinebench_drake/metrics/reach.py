"""Violations of single frames: poses out of reach, joints past their limits, self-collision and table collision."""

from collections.abc import Generator, Iterator

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import Clearance, CollisionModel
from kinebench_drake.kinematics.ik import POSITION_TOLERANCE_M, find_least_excess
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.sweep import sweep
from kinebench_drake.kinematics.track_ik import CONTACT_TOLERANCE_M
from kinebench_drake.metrics.noise import TrackNoise
from kinebench_drake.models.obstacles import PREFIX
from kinebench_drake.segments import segments
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack
from kinebench_drake.violation import Violation, ViolationKind

NOISE_SIGMAS = 3.0
"""Standard deviations of the noise by which a pose may exceed what the robot can do."""

_LIMIT_TOLERANCE_RAD = 1e-6


def contact_tolerance(noise: TrackNoise) -> float:
    """Return the penetration depth [m] up to which a contact is no collision.

    The greatest of 2 mm, three standard deviations of the position noise and the position offset.
    """
    return max(CONTACT_TOLERANCE_M, NOISE_SIGMAS * noise.position_m, noise.offset_m)


def limit_tolerance(sigma: Array) -> Array:
    """Return by how much (7,) [rad] recorded joint angles with noise `sigma` (7,) [rad] may exceed a limit."""
    return np.maximum(_LIMIT_TOLERANCE_RAD, NOISE_SIGMAS * sigma)


def find_unreachable(joints: JointTrack, noise: TrackNoise) -> Iterator[Violation]:
    """Find runs of frames whose pose is out of reach by more than the noise explains.

    `value` is the greatest pose error [m], with rotations weighted by ROTATION_ARM_M as in inverse kinematics.
    """
    error = pose_error(joints)
    limit = pose_tolerance(noise)
    for run in segments(_has(joints, IkStatus.UNREACHABLE) & (error > limit)):
        yield Violation.of_run(ViolationKind.UNREACHABLE, run, None, float(error[run].max()), limit)


def find_limit_violations(
    plant: ArmPlant, track: GripperTrack, joints: JointTrack, noise: TrackNoise
) -> Iterator[Violation]:
    """Find runs of frames whose pose needs a joint past its limit, by the angle in the posture of least excess.

    For frames whose pose error within limits is more than the noise explains. Where no posture is known that reaches
    the pose past limits, `joint` is None and `value` is the pose error [m].
    """
    limit = pose_tolerance(noise)
    failed = _has(joints, IkStatus.JOINT_LIMIT) & (pose_error(joints) > limit)
    q = np.full_like(joints.q, np.nan)
    for i in np.flatnonzero(failed):
        posture = find_least_excess(plant, track.X_BG[i])
        if posture is not None:
            q[i] = posture
    named = yield from find_joint_limit_violations(plant, q, np.full(q.shape[1], _LIMIT_TOLERANCE_RAD))
    for run in segments(failed & ~named):  # past a limit between the samples of the sweep: the joint is unknown
        yield Violation.of_run(ViolationKind.JOINT_LIMIT, run, None, float(pose_error(joints)[run].max()), limit)


def find_joint_limit_violations(
    plant: ArmPlant, q: Array, tolerance: Array
) -> Generator[Violation, None, NDArray[np.bool_]]:
    """Find runs of frames in which angles `q` (T, 7) exceed a limit by more than `tolerance` (7,) [rad].

    Returns:
        (T,) frames of the violations.
    """
    past = np.nan_to_num(limit_excess(plant, q))
    named = np.zeros(len(q), dtype=bool)
    for j, name in enumerate(plant.robot.joints):
        for run in segments(past[:, j] > tolerance[j]):
            named[run] = True
            worst = float(q[run, j][np.argmax(past[run, j])])
            limit = float(plant.upper[j] if worst > plant.upper[j] else plant.lower[j])
            yield Violation.of_run(ViolationKind.JOINT_LIMIT, run, name, worst, limit)
    return named


def find_collisions(
    model: CollisionModel, track: GripperTrack, own: Clearance, table: Clearance, q_smooth: Array, noise: TrackNoise
) -> Iterator[Violation]:
    """Find runs of frames in which the arm penetrates itself or the table, both as recorded and smoothed.

    `value` is the least distance [m], negative in penetration; `limit` the least allowed distance. `own` and `table`
    are the distances (T,) along the joint path, `q_smooth` (T, 7) is the smoothed path [rad]; the track has the finger
    gaps. Where a gap is unknown, the distances are those with open fingers, and a collision with these alone is none.
    """
    limit = -contact_tolerance(noise)
    for kind, clearance, distance in (
        (ViolationKind.SELF_COLLISION, own, model.self_distance),
        (ViolationKind.TABLE_COLLISION, table, model.table_distance),
    ):
        deep = np.nan_to_num(clearance.distance_m) < limit
        if deep.any():  # the smoothed path is checked only where the path itself collides, which is rare
            width = track.finger_width_m[deep]
            smooth = distance(q_smooth[deep], width).distance_m
            if np.isnan(width).any():
                smooth = np.maximum(smooth, distance(q_smooth[deep], np.nan_to_num(width)).distance_m)
            deep[deep] = smooth < -max(CONTACT_TOLERANCE_M, noise.offset_m)
        for run in segments(deep):
            yield Violation.of_run(kind, run, None, float(clearance.distance_m[run].min()), limit)


def find_obstacles(
    plant: ArmPlant, model: CollisionModel, track: GripperTrack, q: Array, q_smooth: Array, noise: TrackNoise
) -> Iterator[Violation]:
    """Find runs of frames in which a link penetrates an obstacle, or does so on the way to the next frame.

    Both as recorded, `q` (T, 7), and smoothed, `q_smooth` (T, 7) [rad]. `value` and `limit` as in `find_collisions`.
    """
    limit = contact_tolerance(noise)
    width = track.finger_width_m
    contacts = sweep(plant, model, q, width, limit)
    depth = max(CONTACT_TOLERANCE_M, noise.offset_m)
    smooth = (
        {(c.link, c.obstacle): c.distance_m for c in sweep(plant, model, q_smooth, width, depth)} if contacts else {}
    )
    for contact in contacts:
        own = smooth.get((contact.link, contact.obstacle))
        for run in segments(np.isfinite(contact.distance_m)):
            if own is not None and np.isfinite(own[run]).any():
                frames = slice(run.start // 2, run.stop // 2 + 1)
                yield Violation.of_run(
                    ViolationKind.OBSTACLE_COLLISION, frames, None, float(contact.distance_m[run].min()), -limit,
                    link=contact.link, body=contact.obstacle.removeprefix(PREFIX),
                )  # fmt: skip


def _has(joints: JointTrack, status: IkStatus) -> NDArray[np.bool_]:
    return np.array([s is status for s in joints.status], dtype=bool)


def pose_error(joints: JointTrack) -> Array:
    """Return the weighted pose error (T,) [m] of each frame, rotations weighted by ROTATION_ARM_M."""
    return np.hypot(joints.position_error_m, ROTATION_ARM_M * joints.rotation_error_rad)


def pose_tolerance(noise: TrackNoise) -> float:
    """Return the weighted pose error [m] that the noise of the track explains."""
    sigma = float(np.hypot(noise.position_m, ROTATION_ARM_M * noise.rotation_rad))
    offset = float(np.hypot(noise.offset_m, ROTATION_ARM_M * noise.offset_rad))
    return max(POSITION_TOLERANCE_M, NOISE_SIGMAS * sigma, offset)
