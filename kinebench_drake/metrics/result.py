"""The result of judging one track: verdict, violations, metrics and their serialization."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import Clearance
from kinebench_drake.kinematics.manipulability import Manipulability, time_integral
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.timing import TimeScale
from kinebench_drake.kinematics.trajopt import TubeResult
from kinebench_drake.metrics.limits import LimitCheck, LimitChecks
from kinebench_drake.metrics.noise import (
    TrackNoise,
)
from kinebench_drake.metrics.smoothness import Smoothness
from kinebench_drake.metrics.violation import Violation, ViolationKind
from kinebench_drake.types import GripperTrack, JointTrack, Json

Value = float | bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicResult:
    """Everything that kinematics says about one track."""

    track: GripperTrack
    """The track as judged; of given joint angles, where they put the TCP."""
    joints: JointTrack
    """The joint path, with collisions in its status."""
    metrics: Mapping[str, Value]
    """Metric names of the output format; None where not measurable."""
    reasons: Mapping[str, str]
    """Why a metric is None, by its name."""
    violations: tuple[Violation, ...]
    """Limits broken, by first frame."""
    feasible: bool | None
    """False if there is a violation, None if too few frames are tracked to tell, else True."""
    noise: TrackNoise
    """The track's noise, measured or ASSUMED_NOISE."""
    noise_assumed: bool
    """Whether the track is too short to tell its noise."""
    checks: LimitChecks
    """Speed, acceleration, jerk and torque against their limits."""
    timing: TimeScale
    """How fast the path could be run."""
    tube: TubeResult
    """The smallest tube that holds a feasible trajectory."""
    tube_limit_m: float
    """Radius that it may have to call the track feasible for it [m]."""
    jumps: NDArray[np.intp]
    """Frames (N,) before which the joint path changes its branch."""
    fit_residual_rad: float | None
    """Root mean square of what smoothing took off the joint path [rad]; None without a path."""
    curves: Mapping[str, Array]
    """What was found along the track, (T,) or (T, 7) each; NaN where there is nothing."""


def limit_margin(plant: ArmPlant, q: Array) -> Array:
    """Distance to the nearer limit / half the joint's range (..., 7) of `q` (..., 7) [rad]: 1 mid-way, 0 at a limit."""
    return np.asarray(np.minimum(q - plant.lower, plant.upper - q) / (0.5 * (plant.upper - plant.lower)))


@dataclass(frozen=True, slots=True, kw_only=True)
class PathMeasurements:
    """What was found along a joint path, before it is put into metrics and curves."""

    manipulability: Manipulability
    """Of the frames whose pose is reached."""
    own: Clearance
    """Distances of the arm from itself."""
    table: Clearance
    """Distances of the arm from the table."""
    smoothness: Smoothness
    """Of the gripper's track."""
    checks: LimitChecks
    """Limits of speed, acceleration, jerk and torque."""
    timing: TimeScale
    """Toppra's."""
    tube: TubeResult
    """Trajectory optimisation's."""
    q_smooth: Array
    """(T, 7) the path without its noise [rad]."""


def kinematic_metrics(
    plant: ArmPlant, track: GripperTrack, joints: JointTrack, found: PathMeasurements
) -> tuple[dict[str, Value], dict[str, str]]:
    """Metrics by name, and why those that are None are."""
    w, checks, timing, tube = found.manipulability, found.checks, found.timing, found.tube
    tracked = int(track.tracked.sum())
    nothing = "no frame is tracked" if tracked == 0 else "no frame's pose is reached"
    error = joints.position_error_m[track.tracked]
    margin = limit_margin(plant, np.where(np.isfinite(w.full)[:, None], joints.q, np.nan))
    metrics: dict[str, Value] = {
        "manipulability_mean": _mean(w.full),
        "manipulability_min": _least(w.full),
        "manipulability_integral": time_integral(track.t_s, w.full),
        "manipulability_cost_mean": _mean(w.cost),
        "manipulability_translation_mean": _mean(w.translation),
        "manipulability_rotation_mean": _mean(w.rotation),
        "manipulability_limited_mean": _mean(w.limited),
        "manipulability_limited_min": _least(w.limited),
        "condition_number_max": _greatest(w.condition),
        "ik_success_rate": float(joints.ok[track.tracked].mean()) if tracked else None,
        "ik_position_error_max_m": _greatest(error),
        "joint_limit_margin_min": _least(margin),
        "self_distance_min_m": _least(found.own.distance_m),
        "table_distance_min_m": _least(found.table.distance_m),
    }
    reasons = {name: nothing for name, value in metrics.items() if value is None}
    for kind in (ViolationKind.VELOCITY, ViolationKind.ACCELERATION, ViolationKind.JERK, ViolationKind.TORQUE):
        name, check = f"{kind.value}_ratio_max", checks.checks.get(kind)
        metrics[name] = None if check is None or not np.isfinite(check.ratio_max) else check.ratio_max
        if metrics[name] is None:
            reasons[name] = checks.reasons.get(kind, "noise hides it throughout")
    metrics["time_scale"] = timing.value
    if timing.value is None:
        reasons["time_scale"] = timing.reason or "Toppra gave none"
    slowdown = checks.slowdown
    metrics["slowdown_min"] = None if slowdown is None or np.isinf(slowdown.factor) else slowdown.factor
    if slowdown is None:
        reasons["slowdown_min"] = "too few frames are reached to take a derivative, or noise hides all of them"
    elif np.isinf(slowdown.factor):
        reasons["slowdown_min"] = f"however slow, the arm's own weight asks too much of {slowdown.joint}"
    metrics["trajopt_feasible"], metrics["trajopt_position_tube_m"] = tube.feasible, tube.radius_m
    for name in ("trajopt_feasible", "trajopt_position_tube_m"):
        if metrics[name] is None:
            reasons[name] = tube.reason or "no tube was found"
    smooth = found.smoothness.metrics
    for name in (name for name, value in smooth.items() if value is None):
        told = found.smoothness.reasons.get(name.partition("_floor_")[0], "")
        reasons[name] = told or "the track's noise is not known"
    return {**smooth, **metrics}, reasons


def track_curves(plant: ArmPlant, joints: JointTrack, found: PathMeasurements) -> dict[str, Array]:
    """Arrays (T,) or (T, 7) by name, for the track's file."""
    w = found.manipulability
    return {
        "manipulability": w.full,
        "manipulability_translation": w.translation,
        "manipulability_rotation": w.rotation,
        "manipulability_weighted": w.limited,
        "condition_number": w.condition,
        "joint_margin": limit_margin(plant, joints.q).min(axis=-1),
        "self_distance_m": found.own.distance_m,
        "table_distance_m": found.table.distance_m,
        "q_smooth": found.q_smooth,
        **{kind.value: check.value for kind, check in found.checks.checks.items()},
    }


def _mean(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def _least(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.min()) if known.size else None


def _greatest(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else None


def violation_json(violation: Violation) -> dict[str, Json]:
    """One violation, in the keys of the output format."""
    return {
        "kind": violation.kind.value,
        "frame_start": int(violation.frame_start),
        "frame_end": int(violation.frame_end),
        "joint": violation.joint,
        "value": float(violation.value),
        "limit": float(violation.limit),
    }


def details_json(plant: ArmPlant, result: KinematicResult) -> dict[str, Json]:
    """Noise, limits, checks joint by joint, timing, tube and branch jumps of a track."""
    return {
        "limits": _limits(plant),
        "noise": {
            "position_m": result.noise.position_m,
            "rotation_rad": result.noise.rotation_rad,
            "assumed": result.noise_assumed,
            "offset_m": result.noise.offset_m,
            "offset_rad": result.noise.offset_rad,
            "fit_residual_rad": result.fit_residual_rad,
            "allowance_sigmas": result.checks.z,
        },
        "checks": {kind.value: _check(check) for kind, check in result.checks.checks.items()},
        "slowdown": _slowdown(result),
        "time_scale": _timing(result),
        "trajopt": _tube(result),
        "branch_jump_frames": [int(frame) for frame in result.jumps],
    }


def _limits(plant: ArmPlant) -> dict[str, Json]:
    return {
        "joints": list(plant.robot.joints),
        "position": {"lower": _list(plant.lower), "upper": _list(plant.upper)},
        "velocity": _list(plant.velocity_limits),
        "acceleration": _list(plant.acceleration_limits),
        "jerk": _list(plant.jerk_limits),
        "torque": _list(plant.effort_limits),
    }


def _check(check: LimitCheck) -> dict[str, Json]:
    return {
        "ratio_max": check.ratio_max,
        "joint": check.joint,
        "frame": check.frame,
        "t_worst_s": check.t_worst_s,
        "ratios": _list(check.ratios),
        "margins": _list(check.margins),
        "noise_ratio": check.noise_ratio,
        "window_s": check.window_s,
        "bandwidth_hz": check.bandwidth_hz,
    }


def _slowdown(result: KinematicResult) -> Mapping[str, Json] | None:
    slowdown = result.checks.slowdown
    if slowdown is None:
        return None
    return {"limit": slowdown.kind.value, "joint": slowdown.joint, "frame": slowdown.frame}


def _timing(result: KinematicResult) -> dict[str, Json]:
    timing = result.timing
    return {
        "limit": timing.constraint.value if timing.constraint else None,
        "joint": timing.joint,
        "frame": timing.frame,
        "reason": timing.reason,
        "active": [{"limit": a.constraint.value, "joint": a.joint, "share": a.share} for a in timing.active],
    }


def _tube(result: KinematicResult) -> dict[str, Json]:
    tube, certificate = result.tube, result.tube.certificate
    against = tube.violation
    return {
        "tube_limit_m": result.tube_limit_m,
        "infeasible_radius_m": tube.infeasible_radius_m,
        "reason": tube.reason,
        "against": None
        if against is None
        else {
            "kind": against.kind.value,
            "frame": against.frame,
            "joint": against.joint,
            "value": against.value,
            "limit": against.limit,
        },
        "certificate": None
        if certificate is None
        else {
            "position_error_max_m": certificate.position_error_max_m,
            "rotation_error_max_rad": certificate.rotation_error_max_rad,
            "joint_limit_margin_min": certificate.joint_limit_margin_min,
            "velocity_ratio_max": certificate.velocity_ratio_max,
            "acceleration_ratio_max": certificate.acceleration_ratio_max,
            "jerk_ratio_max": certificate.jerk_ratio_max,
            "torque_ratio_max": certificate.torque_ratio_max,
            "self_distance_min_m": certificate.self_distance_min_m,
            "table_distance_min_m": certificate.table_distance_min_m,
        },
    }


def _list(values: Array | None) -> list[Json] | None:
    return None if values is None else [float(v) if np.isfinite(v) else None for v in values]
