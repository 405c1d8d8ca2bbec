"""Whether the robot can do a track: inverse kinematics, checks and optimisations put together into a verdict."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.ik import POSITION_TOLERANCE_M, ROTATION_TOLERANCE_RAD
from kinebench_drake.kinematics.manipulability import manipulability_of
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.path import excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.timing import time_scale
from kinebench_drake.kinematics.track import branch_jumps, solve_track
from kinebench_drake.kinematics.trajopt import optimize_in_tube
from kinebench_drake.metrics.derivatives import smooth_path
from kinebench_drake.metrics.discontinuity import find_discontinuities
from kinebench_drake.metrics.limits import LimitChecks, check_limits
from kinebench_drake.metrics.noise import (
    JOINT_FREEDOM_A_FRAME,
    TrackNoise,
    carried_noise,
    joint_noise,
    smooth_poses,
    track_noise,
)
from kinebench_drake.metrics.reach import (
    collisions,
    contact_tolerance,
    given_past_limits,
    limit_tolerance,
    past_limits,
    unreachable,
)
from kinebench_drake.metrics.result import KinematicResult, PathMeasurements, kinematic_metrics, track_curves
from kinebench_drake.metrics.smoothness import track_smoothness
from kinebench_drake.metrics.violation import Violation, ViolationKind
from kinebench_drake.types import GripperTrack, IkStatus, JointTrack

MIN_TRACKED_FRAMES = 5
"""Fewest tracked frames on which a track can be called feasible."""
MIN_TRACKED_FRACTION = 0.5
"""Least share of tracked frames on which a track can be called feasible."""
ASSUMED_NOISE = TrackNoise(position_m=0.005, rotation_rad=float(np.deg2rad(2.5)))
"""Noise granted to tracks too short to tell theirs: that of a fair tracker."""
MOST_NOISE = TrackNoise(position_m=0.015, rotation_rad=float(np.deg2rad(7.5)))
"""Most noise that a track is granted: what jitters more is taken for motion and judged as exact."""
MOST_JOINT_NOISE_RAD = 0.02
"""The same for given joint angles [rad]."""
TUBE_M = 0.005
"""Radius of the tube about a track in which a feasible trajectory is looked for [m], if the noise asks for no more."""
TUBE_SIGMAS = 4.5
"""Standard deviations of the noise that the tube's radius is at least: white noise leaves it in one track of 300."""

_LEVER_M = 0.3  # noise of position over this is about what it brings into the joints


class TrackJudge:
    """Holds tracks against one robot and its table. Uses the plant's context: one object a thread."""

    def __init__(self, plant: ArmPlant, *, table_height_m: float = 0.0) -> None:
        """Take the robot.

        Args:
            plant: the robot.
            table_height_m: z of the table's top in B [m].

        Raises:
            InputError: a collision geometry of the robot cannot be used.
            UsageError: the table's height is not finite.
        """
        self._plant = plant
        self._collision = CollisionModel(plant, table_height_m=table_height_m)

    def judge_poses(self, track: GripperTrack) -> KinematicResult:
        """A track of poses: infeasible only if no joint path does it.

        Raises:
            InputError: a tracked frame's pose is not finite, or the times do not increase.
        """
        noise, assumed = _noise(track)
        joints = solve_track(
            self._plant,
            track,
            self._collision,
            contact_tolerance_m=contact_tolerance(noise),
            noise_rad=noise.rotation_rad + noise.position_m / _LEVER_M,
            X_plan=None if assumed else smooth_poses(track, noise),
        )
        return self._judge(track, joints, noise, assumed, given=None)

    def judge_joints(self, t_s: Array, q: Array, finger_width_m: Array) -> KinematicResult:
        """Joint angles as they are given, not a better path to the same poses.

        Args:
            t_s: (T,) times [s], increasing.
            q: (T, 7) joint angles [rad]; NaN where unknown.
            finger_width_m: (T,) gap between the finger pads [m]; NaN where unknown.

        Raises:
            InputError: the shapes do not fit, or the times do not increase.
        """
        if not (np.diff(t_s) > 0.0).all():
            raise InputError("t_s must increase from frame to frame")
        known = np.asarray(np.isfinite(q).all(axis=-1))
        X_BG = np.full((len(q), 4, 4), np.nan)
        X_BG[known] = np.reshape([self._plant.forward(row) for row in q[known]], (-1, 4, 4))
        track = GripperTrack(
            t_s=t_s,
            X_CH=np.full_like(X_BG, np.nan),
            X_BG=X_BG,
            tracked=known,
            confidence=known.astype(np.float64),
            finger_width_m=finger_width_m,
        )
        error = np.where(known, 0.0, np.nan)
        sigma = _joint_noise(t_s, q)
        past = np.asarray((excess(self._plant, q) > limit_tolerance(sigma)).any(axis=-1))
        status = [
            IkStatus.NOT_TRACKED if not k else IkStatus.JOINT_LIMIT if p else IkStatus.OK
            for k, p in zip(known, past, strict=True)
        ]
        joints = JointTrack(
            t_s=t_s,
            q=np.where(known[:, None], q, np.nan),
            status=tuple(status),
            position_error_m=error,
            rotation_error_rad=error,
        )
        noise, assumed = _noise(track)
        return self._judge(track, joints, noise, assumed, given=sigma)

    def _judge(
        self, track: GripperTrack, joints: JointTrack, noise: TrackNoise, assumed: bool, *, given: Array | None
    ) -> KinematicResult:
        """The verdict on a joint path; `given` is the noise (7,) [rad] of joint angles that are judged as they are."""
        plant, t_s = self._plant, track.t_s
        known = np.isfinite(joints.q).all(axis=-1)
        # Where the pose is not reached, speeds and torques of the nearest posture would be made up.
        reached = known & (joints.position_error_m <= POSITION_TOLERANCE_M)
        reached &= joints.rotation_error_rad <= ROTATION_TOLERANCE_RAD
        q = np.where(reached[:, None], joints.q, np.nan)
        J = np.full((len(q), 6, q.shape[1]), np.nan)
        J[reached] = plant.chain.jacobians(joints.q[reached])
        sigma = carried_noise(J, noise) if given is None else given
        q_smooth = smooth_path(t_s, q, sigma)
        own = self._collision.self_distance(q, track.finger_width_m)
        table = self._collision.table_distance(q, track.finger_width_m)
        if given is None:
            checks = check_limits(plant, t_s, q, sigma)
            limits = past_limits(plant, track, joints, noise)
            jumps = find_discontinuities(t_s, track.X_BG, track.tracked, noise)
        else:
            checks = check_limits(plant, t_s, q, sigma, freedom_a_frame=JOINT_FREEDOM_A_FRAME)
            limits = given_past_limits(plant, q, given)
            jumps = find_discontinuities(t_s, track.X_BG, track.tracked, noise, q, plant.robot.joints)
        violations = sorted(
            (
                *unreachable(joints, noise),
                *limits,
                *collisions(self._collision, track, own, table, q_smooth, noise),
                *checks.violations,
                *jumps,
            ),
            key=lambda v: (v.frame_start, v.frame_end, v.kind.value, v.joint or ""),
        )
        joints = joints if given is None else _with_collisions(joints, violations)
        timing = time_scale(plant, t_s, q_smooth)
        tube_limit = max(TUBE_M, TUBE_SIGMAS * max(noise.position_m, ROTATION_ARM_M * noise.rotation_rad))
        tube = optimize_in_tube(
            plant,
            self._collision,
            t_s,
            np.where(track.tracked[:, None, None], track.X_BG, np.nan),
            joints.q,
            tube_limit_m=tube_limit,
            table_tolerance_m=contact_tolerance(noise),
            finger_width_m=np.where(np.isfinite(track.finger_width_m), track.finger_width_m, plant.finger_width_m),
        )
        branches = np.flatnonzero(reached)
        branch = branch_jumps(plant, track.X_BG[branches], joints.q[branches])
        found = PathMeasurements(
            manipulability=manipulability_of(plant, J, q),
            own=own,
            table=table,
            smoothness=track_smoothness(track, None if assumed else noise),
            checks=checks,
            timing=timing,
            tube=tube,
            q_smooth=q_smooth,
        )
        metrics, reasons = kinematic_metrics(plant, track, joints, found)
        metrics["branch_jumps"] = float(len(branch)) if len(branches) > 1 else None
        if len(branches) < 2:
            reasons["branch_jumps"] = "fewer than two poses are reached"
        undecided = _undecided(track, checks)
        if not violations and undecided is not None:
            reasons["feasible"] = undecided
        residual = (q_smooth - q)[np.isfinite(q_smooth).all(axis=-1)]
        return KinematicResult(
            track=track,
            joints=joints,
            metrics=MappingProxyType(metrics),
            reasons=MappingProxyType(reasons),
            violations=tuple(violations),
            feasible=False if violations else (True if undecided is None else None),
            noise=noise,
            noise_assumed=assumed,
            checks=checks,
            timing=timing,
            tube=tube,
            tube_limit_m=tube_limit,
            jumps=branches[branch] if len(branch) else branch,
            fit_residual_rad=float(np.sqrt(np.mean(residual**2))) if residual.size else None,
            curves=MappingProxyType(track_curves(plant, joints, found)),
        )


def _noise(track: GripperTrack) -> tuple[TrackNoise, bool]:
    """The track's noise, 0 where it would be more than MOST_NOISE, and whether it had to be assumed."""
    noise = track_noise(track.t_s, track.X_BG, track.tracked)
    if not np.isfinite([noise.position_m, noise.rotation_rad]).all():
        return replace(ASSUMED_NOISE, offset_m=track.offset_m, offset_rad=track.offset_rad), True
    position = noise.position_m if noise.position_m <= MOST_NOISE.position_m else 0.0
    rotation = noise.rotation_rad if noise.rotation_rad <= MOST_NOISE.rotation_rad else 0.0
    known = TrackNoise(position_m=position, rotation_rad=rotation, offset_m=track.offset_m, offset_rad=track.offset_rad)
    return known, False


def _joint_noise(t_s: Array, q: Array) -> Array:
    """Noise (7,) [rad] of given joint angles: 0 where it would be more than MOST_JOINT_NOISE_RAD, that if unknown."""
    sigma = joint_noise(t_s, q)
    granted = np.where(sigma <= MOST_JOINT_NOISE_RAD, sigma, 0.0)
    return np.where(np.isfinite(sigma), granted, MOST_JOINT_NOISE_RAD)


def _undecided(track: GripperTrack, checks: LimitChecks) -> str | None:
    """Why a track without violations cannot be called feasible; None if it can."""
    n, tracked = len(track.t_s), int(track.tracked.sum())
    if tracked < max(MIN_TRACKED_FRAMES, MIN_TRACKED_FRACTION * n):
        return f"{tracked} of {n} frames are tracked; {MIN_TRACKED_FRAMES} and half of all are needed to acquit"
    speed = checks.checks.get(ViolationKind.VELOCITY)
    seen = 0 if speed is None else int(np.isfinite(speed.value).all(axis=-1).sum())
    if seen < MIN_TRACKED_FRACTION * tracked:
        return f"{seen} of {tracked} tracked frames are reached; half of them are needed to acquit"
    return None


def _with_collisions(joints: JointTrack, violations: list[Violation]) -> JointTrack:
    """Given joint angles with the collisions found in their status, as inverse kinematics has them."""
    kinds = {
        ViolationKind.SELF_COLLISION: IkStatus.SELF_COLLISION,
        ViolationKind.TABLE_COLLISION: IkStatus.TABLE_COLLISION,
    }
    status = list(joints.status)
    for violation in violations:
        for i in range(violation.frame_start, violation.frame_end + 1):
            if violation.kind in kinds and status[i] is IkStatus.OK:
                status[i] = kinds[violation.kind]
    return replace(joints, status=tuple(status))
