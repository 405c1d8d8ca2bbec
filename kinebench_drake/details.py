"""What kinematics says about a track, as a row's JSON: the violations, and under `details` all that stands behind."""

from collections.abc import Mapping

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.kinematic import KinematicResult
from kinebench_drake.metrics.limits import LimitCheck
from kinebench_drake.metrics.violation import Violation
from kinebench_drake.row import Json


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
