"""The kinematic verdict on a track: inverse kinematics, limit checks and optimisations combined."""

from collections.abc import Iterable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, rotation_exp, rotation_z
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.ik import POSITION_TOLERANCE_M, ROTATION_TOLERANCE_RAD
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.timing import time_scale
from kinebench_drake.kinematics.track_ik import find_free, settle_free_turns, solve_track
from kinebench_drake.kinematics.trajopt import optimize_in_tube
from kinebench_drake.metrics.coverage import (
    Coverage,
    bridge_gaps,
    bridge_joints,
    cover_joints,
    cover_poses,
    weigh_manipulability,
    worst_manipulability,
)
from kinebench_drake.metrics.discontinuity import find_discontinuities
from kinebench_drake.metrics.executability import (
    MIN_TRACKED_FRACTION,
    MIN_TRACKED_FRAMES,
    MOST_NOISE,
    motion_ratios,
)
from kinebench_drake.metrics.kinematic_result import (
    JointPath,
    KinematicResult,
    PathMeasurements,
    feasible_period,
    kinematic_metrics,
    path_details,
    track_curves,
)
from kinebench_drake.metrics.limit_checks import KINDS, LimitChecks, check_limits
from kinebench_drake.metrics.noise import (
    JOINT_FREEDOM_PER_FRAME,
    TrackNoise,
    estimate_joint_noise,
    estimate_track_noise,
    propagate_noise,
    rounding_deviation,
    smooth_poses,
)
from kinebench_drake.metrics.reach import (
    contact_tolerance,
    find_collisions,
    find_joint_limit_violations,
    find_limit_violations,
    find_obstacles,
    find_unreachable,
    limit_tolerance,
)
from kinebench_drake.metrics.smoothness import measure_smoothness, stands_still
from kinebench_drake.results.direction import BOUND
from kinebench_drake.segments import finite_rows, spread
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack
from kinebench_drake.violation import Violation, ViolationKind

MOST_JOINT_NOISE_RAD = 0.02
"""The same for joint angles [rad]."""
ASSUMED_NOISE = TrackNoise(position_m=0.005, rotation_rad=float(np.deg2rad(2.5)))
"""Noise of tracks too short to measure theirs: that of a fair tracker."""
JOINT_LEVER_M = 0.3
"""Length [m] by which position noise is divided: about the joint noise that it causes."""
NOISE_SPREAD = 0.25
"""Relative change of the noise of estimated poses under which a verdict has to hold: poses in float32 and bfloat16
differ by a part of their noise (`python -m benchmarks precision`)."""
LEAST_SLOWDOWN = 1.1
"""Least slow-down that rates or torques of estimated poses need for a violation, likewise: between float32 and bfloat16
verdicts differed up to 1.06."""
TUBE_M = 0.005
"""Least radius of the tube about a track in which a feasible trajectory is searched [m]; noise widens it."""
TUBE_SIGMAS = 4.5
"""Least radius of that tube in standard deviations of the noise: white noise leaves it in one track of 300."""
_TURNS_RAD = np.deg2rad([0.0, 45.0, -45.0, 90.0])
"""Turns of the first pose that are tried where that about the own axis of the gripper is not sure [rad]; such grippers
look the same after half a turn."""
_CONTACTS = {
    ViolationKind.SELF_COLLISION: IkStatus.SELF_COLLISION,
    ViolationKind.TABLE_COLLISION: IkStatus.TABLE_COLLISION,
    ViolationKind.OBSTACLE_COLLISION: IkStatus.OBSTACLE_COLLISION,
}


class TrackJudge:
    """Judges tracks for one robot and its table. Uses the plant's context: one object a thread."""

    def __init__(self, plant: ArmPlant, *, table_height_m: float = 0.0) -> None:
        """Build the collision model; the table top is at z = `table_height_m` in B [m].

        Raises:
            InputError: a collision geometry of the robot cannot be used.
            UsageError: the table's height is not finite.
        """
        self._plant = plant
        self._collision = CollisionModel(plant, table_height_m=table_height_m)

    def judge_poses(self, track: GripperTrack) -> KinematicResult:
        """Judge a track of poses: infeasible only if no joint path follows it.

        Where the turn of the gripper about its own axis is not sure, only what no turn avoids is a violation.
        """
        track = replace(track, X_BG=settle_free_turns(self._plant, track.X_BG))
        path, checks = self._solve(track)
        violations, open_kinds = self._settle(path, self._pose_violations(path, checks))
        if violations and not track.turn_is_sure:
            violations, open_kinds = self._avoid_by_turning(track, violations)
        coverage = cover_poses(self._plant, track, path.joints, path.reached)
        # Where the track is incomplete, the path, which other lost frames may change, must not decide.
        asked = track.tracked & ~(path.joints.ok & coverage.complete)
        free = find_free(self._plant, self._collision, track, asked, contact_tolerance(path.noise))
        measured = self._measure(path, checks, coverage, free, *bridge_gaps(track), X_BG=track.X_BG)
        return self._result(measured, violations, open_kinds)

    def _solve(self, track: GripperTrack) -> tuple[JointPath, LimitChecks]:
        """Return the joint path that follows a track of poses, and its limits checked."""
        noise, assumed = _noise(track)
        joints = solve_track(
            self._plant,
            track,
            self._collision,
            contact_tolerance_m=contact_tolerance(noise),
            noise_rad=noise.rotation_rad + noise.position_m / JOINT_LEVER_M,
            X_plan=None if assumed else smooth_poses(track, noise),
        )
        reached = _reached(joints)
        J = spread(self._plant.chain.jacobians(joints.q[reached]), reached, len(reached))
        path = self._path(track, joints, propagate_noise(J, noise), noise, assumed)
        return path, self._check_poses(path)

    def _avoid_by_turning(
        self, track: GripperTrack, violations: list[Violation]
    ) -> tuple[list[Violation], tuple[ViolationKind, ...]]:
        """Return the violations of the kinds that remain however the gripper is turned, and the kinds that do not."""
        kinds = {violation.kind for violation in violations}
        remaining = set(kinds)
        for turn_rad in _TURNS_RAD:
            path, checks = self._solve(replace(track, X_BG=least_turn(track.X_BG, turn_rad)))
            remaining &= {violation.kind for violation in self._pose_violations(path, checks)}
        certain = [violation for violation in violations if violation.kind in remaining]
        return certain, () if certain else tuple(kind for kind in ViolationKind if kind in kinds)

    def judge_joints(self, t_s: Array, q: Array, finger_width_m: Array) -> KinematicResult:
        """Judge joint angles as recorded, not the best path to the same poses.

        Args:
            t_s: (T,) times [s], increasing.
            q: (T, 7) joint angles [rad]; NaN where unknown.
            finger_width_m: (T,) gap between the finger pads [m]; NaN where unknown.

        Raises:
            InputError: the shapes do not fit, or the times do not increase.
        """
        if not (np.diff(t_s) > 0.0).all():
            raise InputError("t_s must increase from frame to frame")
        valid = np.asarray(np.isfinite(q).all(axis=-1))
        X_BG = spread(self._plant.forward_path(q[valid]), valid, len(q))
        track = GripperTrack(
            t_s=t_s,
            X_CH=np.full_like(X_BG, np.nan),
            X_BG=X_BG,
            tracked=valid,
            confidence=valid.astype(np.float64),
            finger_width_m=finger_width_m,
        )
        error = np.where(valid, 0.0, np.nan)
        sigma = _joint_noise(t_s, q)
        past = np.asarray((limit_excess(self._plant, q) > limit_tolerance(sigma)).any(axis=-1))
        status = [
            IkStatus.NOT_TRACKED if not v else IkStatus.JOINT_LIMIT if p else IkStatus.OK
            for v, p in zip(valid, past, strict=True)
        ]
        joints = JointTrack(
            t_s=t_s,
            q=np.where(valid[:, None], q, np.nan),
            status=tuple(status),
            position_error_m=error,
            rotation_error_rad=error,
        )
        noise, assumed = _noise(track)
        moved = np.square(self._plant.chain.jacobians(q[valid])) @ np.square(rounding_deviation(q[valid]))
        rotation_rad, position_m = np.sqrt(np.median(moved.reshape(-1, 2, 3).mean(axis=-1), axis=0)).tolist()
        noise = replace(
            noise,
            position_m=max(noise.position_m, position_m),
            rotation_rad=max(noise.rotation_rad, rotation_rad),
        )
        path = self._path(track, joints, sigma, noise, assumed)
        checks = check_limits(self._plant, t_s, path.q, sigma, freedom_per_frame=JOINT_FREEDOM_PER_FRAME)
        violations = self._joint_violations(path, checks)
        path = replace(path, joints=_with_collisions(joints, violations))
        bridged = np.zeros(len(t_s), dtype=bool)
        coverage = cover_joints(self._plant, path.q)
        measured = self._measure(path, checks, coverage, path.joints.ok, track, bridged, X_BG=None)
        return self._result(measured, violations, ())

    def _path(
        self, track: GripperTrack, joints: JointTrack, sigma: Array, noise: TrackNoise, noise_assumed: bool
    ) -> JointPath:
        """Return the joint path of a track with its distances from collisions."""
        reached = _reached(joints)
        q = np.where(reached[:, None], joints.q, np.nan)
        return JointPath(
            track=track,
            joints=joints,
            reached=reached,
            q=q,
            sigma=sigma,
            own=self._collision.self_distance(q, track.finger_width_m),
            table=self._collision.table_distance(q, track.finger_width_m),
            noise=noise,
            noise_assumed=noise_assumed,
        )

    def _check_poses(self, path: JointPath, tolerance: float = 1.0) -> LimitChecks:
        return check_limits(self._plant, path.track.t_s, path.q, tolerance * path.sigma)

    def _pose_violations(self, path: JointPath, checks: LimitChecks, tolerance: float = 1.0) -> list[Violation]:
        """Return the violations of a solved joint path; what the poses' noise explains is multiplied by `tolerance`."""
        track = path.track
        noise = path.noise.scaled(tolerance)
        limits = find_limit_violations(self._plant, track, path.joints, noise)
        jumps = find_discontinuities(track.t_s, track.X_BG, track.tracked, path.noise, tolerance=tolerance)
        return self._violations(path, checks, noise, limits, jumps)

    def _joint_violations(self, path: JointPath, checks: LimitChecks) -> list[Violation]:
        """Return the violations of recorded joint angles."""
        track = path.track
        limits = find_joint_limit_violations(self._plant, path.q, limit_tolerance(path.sigma))
        joints = self._plant.robot.joints
        jumps = find_discontinuities(track.t_s, track.X_BG, track.tracked, path.noise, path.q, joints)
        return self._violations(path, checks, path.noise, limits, jumps)

    def _violations(
        self,
        path: JointPath,
        checks: LimitChecks,
        noise: TrackNoise,
        limits: Iterable[Violation],
        jumps: Iterable[Violation],
    ) -> list[Violation]:
        """Return all violations of a joint path, causes before what follows from them."""
        violations = (
            *find_unreachable(path.joints, noise),
            *limits,
            *find_collisions(self._collision, path.track, path.own, path.table, checks.q_smooth, noise),
            *find_obstacles(self._plant, self._collision, path.track, path.q, checks.q_smooth, noise),
            *checks.violations,
            *jumps,
        )
        return sorted(violations, key=lambda v: v.rank)

    def _settle(
        self, path: JointPath, violations: list[Violation]
    ) -> tuple[list[Violation], tuple[ViolationKind, ...]]:
        """Return the violations that hold for poses as exact as estimates are, and kinds of which it is open.

        Estimates of two number formats differ by a part of their noise. A kind of violation holds if it is found with a
        higher tolerance, too, and by a margin in time; it is open if it is found with a lower tolerance alone.
        """
        if path.track.offset_m == 0.0:  # not an estimate
            return violations, ()
        tolerance = 1.0 + NOISE_SPREAD if violations else 1.0 / (1.0 + NOISE_SPREAD)
        checks = self._check_poses(path, tolerance)
        others = self._pose_violations(path, checks, tolerance)
        if not violations:
            return [], tuple(dict.fromkeys(violation.kind for violation in others))
        sure = {violation.kind for violation in others}
        if checks.slowdown is None or checks.slowdown.factor < LEAST_SLOWDOWN:
            sure -= set(KINDS)
        certain = [violation for violation in violations if violation.kind in sure]
        return certain, () if certain else tuple(dict.fromkeys(violation.kind for violation in violations))

    def _measure(
        self,
        path: JointPath,
        checks: LimitChecks,
        coverage: Coverage,
        free: NDArray[np.bool_],
        filled: GripperTrack,
        bridged: NDArray[np.bool_],
        *,
        X_BG: Array | None,
    ) -> PathMeasurements:
        """Measure a joint path; `X_BG` (T, 4, 4) are the poses that it follows [m], None for recorded joint angles."""
        plant = self._plant
        track = path.track
        noise = path.noise
        tube_limit_m = max(TUBE_M, TUBE_SIGMAS * max(noise.position_m, ROTATION_ARM_M * noise.rotation_rad))
        tube = optimize_in_tube(
            plant,
            self._collision,
            track.t_s,
            np.where(track.tracked[:, None, None], track.X_BG, np.nan),
            path.joints.q,
            tube_limit_m=tube_limit_m,
            table_tolerance_m=contact_tolerance(noise),
            finger_width_m=np.where(np.isfinite(track.finger_width_m), track.finger_width_m, plant.finger_width_m),
        )
        w = weigh_manipulability(plant, coverage, bridge_joints(track.t_s, coverage.q, bridged))
        return PathMeasurements(
            path=path,
            coverage=coverage,
            manipulability=w,
            manipulability_worst=w if coverage.complete else worst_manipulability(plant, coverage, w, X_BG),
            free=free,
            bridged=bridged,
            p_BG=smooth_poses(filled, noise)[:, :3, 3],
            motionless=stands_still(track.X_BG[track.tracked]) if track.tracked.any() else None,
            smoothness=measure_smoothness(
                replace(filled, tracked=filled.tracked & ~coverage.unreachable),
                None if path.noise_assumed else noise,
                measured=track.tracked & ~coverage.unreachable,
            ),
            checks=checks,
            timing=time_scale(plant, track.t_s, checks.q_smooth),
            tube=tube,
            tube_limit_m=tube_limit_m,
        )

    def _result(
        self, measured: PathMeasurements, violations: list[Violation], open_kinds: tuple[ViolationKind, ...]
    ) -> KinematicResult:
        """Return the verdict with all metrics; it is open on `open_kinds` of limits."""
        plant = self._plant
        track = measured.path.track
        metrics, reasons = kinematic_metrics(plant, measured)
        undecided = _undecided(track, measured.checks) or _describe_open(open_kinds, track)
        if not violations and undecided is not None:
            reasons["feasible"] = undecided
        period, why = feasible_period(track.t_s, metrics["slowdown_min"], violations, undecided)
        metrics["feasible_from_period_s"] = period
        if period is None:
            reasons["feasible_from_period_s"] = why
        if "slowdown_min" + BOUND in metrics:  # the least slow-down of an incomplete track is not known
            metrics["feasible_from_period_s" + BOUND] = None
            reasons["feasible_from_period_s" + BOUND] = reasons["slowdown_min" + BOUND]
        return KinematicResult(
            track=track,
            joints=measured.path.joints,
            feasible=False if violations else (True if undecided is None else None),
            violations=tuple(violations),
            metrics=MappingProxyType(metrics),
            unchecked=plant.robot.limits.unstated,
            reasons=MappingProxyType(reasons),
            details=MappingProxyType(path_details(plant, measured)),
            curves=MappingProxyType({**track_curves(plant, measured), **motion_ratios(plant, measured, violations)}),
            contact_tolerance_m=contact_tolerance(measured.path.noise),
        )


def _reached(joints: JointTrack) -> NDArray[np.bool_]:
    """Return the frames (T,) whose pose the joint path reaches."""
    near = (joints.position_error_m <= POSITION_TOLERANCE_M) & (joints.rotation_error_rad <= ROTATION_TOLERANCE_RAD)
    return np.asarray(np.isfinite(joints.q).all(axis=-1) & near)


def least_turn(X: Array, turn_rad: float) -> Array:
    """Return poses (T, 4, 4) of the same positions and z axes that do not turn about z from one to the next.

    Each rotation is the one before, turned the shortest way that takes one z axis to the other (parallel transport).

    Args:
        X: (T, 4, 4) poses; NaN where there is none, and so in the result.
        turn_rad: turn about z of the first pose [rad].
    """
    result = X.copy()
    last: Array | None = None
    for i in np.flatnonzero(finite_rows(X.reshape(len(X), 16))):
        if last is None:
            last = X[i, :3, :3] @ rotation_z(turn_rad)
        axis = np.cross(last[:, 2], X[i, :3, 2])
        length = float(np.linalg.norm(axis))
        angle = np.arctan2(length, float(last[:, 2] @ X[i, :3, 2]))
        last = rotation_exp(axis * (angle / length if length > 0.0 else 0.0)) @ last
        result[i, :3, :3] = last
    return result


def _describe_open(kinds: tuple[ViolationKind, ...], track: GripperTrack) -> str | None:
    """Return why a verdict is open that depends on limits of some kinds; None without any."""
    names = ", ".join(kind.value for kind in kinds)
    turn = "" if track.turn_is_sure else " (the turn about the gripper's own axis is not sure)"
    return f"nearer to a limit than the estimated poses are exact{turn}: {names}" if kinds else None


def _noise(track: GripperTrack) -> tuple[TrackNoise, bool]:
    """Return the track's noise, 0 where it exceeds MOST_NOISE, and whether it was assumed."""
    noise = estimate_track_noise(track.t_s, track.X_BG, track.tracked)
    assumed = not np.isfinite([noise.position_m, noise.rotation_rad]).all()
    noise = ASSUMED_NOISE if assumed else noise
    position = noise.position_m if noise.position_m <= MOST_NOISE.position_m else 0.0
    rotation = noise.rotation_rad if noise.rotation_rad <= MOST_NOISE.rotation_rad else 0.0
    offsets = {"offset_m": track.offset_m, "offset_rad": track.offset_rad}
    return TrackNoise(position_m=position, rotation_rad=rotation, **offsets), assumed


def _joint_noise(t_s: Array, q: Array) -> Array:
    """Return the noise (7,) of joint angles [rad]: 0 where it exceeds MOST_JOINT_NOISE_RAD, that value if unknown."""
    sigma = estimate_joint_noise(t_s, q)
    granted = np.where(sigma <= MOST_JOINT_NOISE_RAD, sigma, 0.0)
    return np.where(np.isfinite(sigma), granted, MOST_JOINT_NOISE_RAD)


def _undecided(track: GripperTrack, checks: LimitChecks) -> str | None:
    """Return why the verdict on a track without violations is open; None if it is feasible."""
    n = len(track.t_s)
    tracked = int(track.tracked.sum())
    if tracked < max(MIN_TRACKED_FRAMES, MIN_TRACKED_FRACTION * n):
        return f"{tracked} of {n} frames are tracked; {MIN_TRACKED_FRAMES} and half of all are needed for a verdict"
    speed = checks.checks.get(ViolationKind.VELOCITY)
    measured = int(np.isfinite(checks.q_smooth if speed is None else speed.value).all(axis=-1).sum())
    if measured < MIN_TRACKED_FRACTION * tracked:
        return f"{measured} of {tracked} tracked frames are reached; half of them are needed for a verdict"
    return None


def _with_collisions(joints: JointTrack, violations: list[Violation]) -> JointTrack:
    """Return recorded joint angles with collisions in their status, as inverse kinematics reports them."""
    status = list(joints.status)
    for violation in violations:
        for i in range(violation.frame_start, violation.frame_end + 1):
            if violation.kind in _CONTACTS and status[i] is IkStatus.OK:
                status[i] = _CONTACTS[violation.kind]
    return replace(joints, status=tuple(status))
