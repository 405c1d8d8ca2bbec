"""Where a track asks for poses that the robot cannot take: out of reach, past a joint limit, into itself, the table."""

from collections.abc import Generator, Iterator

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import Clearance, CollisionModel
from kinebench_drake.kinematics.ik import POSITION_TOLERANCE_M, find_least_excess
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.track import CONTACT_TOLERANCE_M
from kinebench_drake.metrics.noise import TrackNoise
from kinebench_drake.segments import segments
from kinebench_drake.types import GripperTrack, IkStatus, JointTrack, Violation, ViolationKind

NOISE_SIGMAS = 3.0
"""Standard deviations of the track's noise that a pose may be beyond what the robot can do."""

_LIMIT_TOLERANCE_RAD = 1e-6


def contact_tolerance(noise: TrackNoise) -> float:
    """Depth [m] up to which touching is no collision.

    max(2 mm, three standard deviations of the position noise, how far the poses may be off).
    """
    return max(CONTACT_TOLERANCE_M, NOISE_SIGMAS * noise.position_m, noise.offset_m)


def limit_tolerance(sigma: Array) -> Array:
    """How far (7,) [rad] given joint angles with noise `sigma` (7,) [rad] may be past a limit."""
    return np.maximum(_LIMIT_TOLERANCE_RAD, NOISE_SIGMAS * sigma)


def unreachable(joints: JointTrack, noise: TrackNoise) -> Iterator[Violation]:
    """Runs of frames whose pose is out of reach by more than the noise explains.

    `value` is the worst distance left [m], a radian counting for ROTATION_ARM_M as in the search that found it.
    """
    left = _left(joints)
    limit = _noise_limit(noise)
    missed = _has(joints, IkStatus.UNREACHABLE) & (left > limit)
    for run in segments(missed):
        yield _violation(ViolationKind.UNREACHABLE, run, None, float(left[run].max()), limit)


def past_limits(plant: ArmPlant, track: GripperTrack, joints: JointTrack, noise: TrackNoise) -> Iterator[Violation]:
    """Runs of frames whose pose takes a joint past its limit: by the angle of the least bad posture that reaches it.

    For frames that no posture within limits comes near enough to for the noise to explain. Where no posture is known
    that reaches the pose either, no joint is named and `value` is the distance left [m].
    """
    limit = _noise_limit(noise)
    failed = _has(joints, IkStatus.JOINT_LIMIT) & (_left(joints) > limit)
    q = np.full_like(joints.q, np.nan)
    for i in np.flatnonzero(failed):
        posture = find_least_excess(plant, track.X_BG[i])
        if posture is not None:
            q[i] = posture
    named = yield from _past(plant, q, np.full(q.shape[1], _LIMIT_TOLERANCE_RAD))
    for run in segments(failed & ~named):  # past a limit between the sweep's samples: no posture to name a joint by
        yield _violation(ViolationKind.JOINT_LIMIT, run, None, float(_left(joints)[run].max()), limit)


def given_past_limits(plant: ArmPlant, q: Array, sigma: Array) -> Iterator[Violation]:
    """Runs of frames in which given joint angles `q` (T, 7) are past a limit by more than their noise (7,) [rad]."""
    yield from _past(plant, q, limit_tolerance(sigma))


def collisions(
    model: CollisionModel,
    track: GripperTrack,
    own: Clearance,
    table: Clearance,
    q_smooth: Array,
    noise: TrackNoise,
) -> Iterator[Violation]:
    """Runs of frames in which the arm is in itself or in the table, as it is and with its noise smoothed away.

    `value` is the least distance [m], negative in penetration; `limit` what it may be at least.

    Args:
        model: distances.
        track: for the gap between the fingers.
        own: (T,) distances of the arm from itself along the joint path.
        table: (T,) those from the table.
        q_smooth: (T, 7) the joint path, smoothed [rad].
        noise: of the track.
    """
    limit = -contact_tolerance(noise)
    for kind, clearance, distance in (
        (ViolationKind.SELF_COLLISION, own, model.self_distance),
        (ViolationKind.TABLE_COLLISION, table, model.table_distance),
    ):
        deep = np.nan_to_num(clearance.distance_m) < limit
        if deep.any():  # few tracks: the smoothed path is looked at only where the path itself collides
            smooth = np.full(len(deep), np.nan)
            smooth[deep] = distance(q_smooth[deep], track.finger_width_m[deep]).distance_m
            deep &= smooth < -max(CONTACT_TOLERANCE_M, noise.offset_m)
        for run in segments(deep):
            yield _violation(kind, run, None, float(clearance.distance_m[run].min()), limit)


def _past(plant: ArmPlant, q: Array, tolerance: Array) -> Generator[Violation, None, NDArray[np.bool_]]:
    """Violations of the rows of `q` (T, 7) past limits by more than `tolerance` (7,); returns their frames (T,)."""
    past = np.nan_to_num(limit_excess(plant, q))
    named = np.zeros(len(q), dtype=bool)
    for j, name in enumerate(plant.robot.joints):
        for run in segments(past[:, j] > tolerance[j]):
            named[run] = True
            worst = float(q[run, j][np.argmax(past[run, j])])
            limit = float(plant.upper[j] if worst > plant.upper[j] else plant.lower[j])
            yield _violation(ViolationKind.JOINT_LIMIT, run, name, worst, limit)
    return named


def _has(joints: JointTrack, status: IkStatus) -> NDArray[np.bool_]:
    return np.array([s is status for s in joints.status], dtype=bool)


def _left(joints: JointTrack) -> Array:
    """What is left to each pose (T,) [m], a radian counting for ROTATION_ARM_M."""
    return np.hypot(joints.position_error_m, ROTATION_ARM_M * joints.rotation_error_rad)


def _noise_limit(noise: TrackNoise) -> float:
    sigma = float(np.hypot(noise.position_m, ROTATION_ARM_M * noise.rotation_rad))
    offset = float(np.hypot(noise.offset_m, ROTATION_ARM_M * noise.offset_rad))
    return max(POSITION_TOLERANCE_M, NOISE_SIGMAS * sigma, offset)


def _violation(kind: ViolationKind, run: slice, joint: str | None, value: float, limit: float) -> Violation:
    return Violation(kind=kind, frame_start=run.start, frame_end=run.stop - 1, joint=joint, value=value, limit=limit)
