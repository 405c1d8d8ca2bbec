"""The result of judging one track: verdict, violations, metrics, and the measurements behind them as JSON."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json
from kinebench_drake.kinematics.collision import Clearance
from kinebench_drake.kinematics.manipulability import Manipulability, time_integral
from kinebench_drake.kinematics.path import limit_margin
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.timing import TimeScale
from kinebench_drake.kinematics.track_ik import CONTACT_TOLERANCE_M
from kinebench_drake.kinematics.trajopt import TubeResult
from kinebench_drake.metrics.coverage import Coverage
from kinebench_drake.metrics.limit_checks import KINDS, LimitCheck, LimitChecks
from kinebench_drake.metrics.noise import TrackNoise
from kinebench_drake.metrics.smoothness import Smoothness
from kinebench_drake.results.direction import BOUND
from kinebench_drake.segments import finite_rows
from kinebench_drake.track import GripperTrack, JointTrack
from kinebench_drake.violation import Violation

Value = float | bool | None


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicResult:
    """Kinematic verdict and metrics of one track, or of the joined clips of an episode."""

    track: GripperTrack
    """The track that was judged; of given joint angles their forward kinematics."""
    joints: JointTrack
    """The joint path, with collisions in its status."""
    feasible: bool | None
    """False if there is a violation, None if too few frames are tracked to decide, else True."""
    violations: tuple[Violation, ...]
    """Limits broken, by cause and frame (`Violation.rank`)."""
    metrics: Mapping[str, Value]
    """Metric names of the output format; None where not measurable. Of a track with lost or unreachable frames also
    NAME_bound, the worst that NAME can be whatever happens there; None if there is no worst."""
    unchecked: tuple[str, ...] = ()
    """Kinds of limits that the robot does not state: `feasible` says nothing about them."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Why a metric is None, by its name; why the verdict is open, by "feasible"."""
    details: Mapping[str, Json] = field(default_factory=dict)
    """The field `details` of samples.jsonl: noise, limits and checks joint by joint, timing, tube."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """Arrays (T,) or (T, 7) along the track for its npz file; NaN where not measured. `bridged` is 1 where bridged."""
    contact_tolerance_m: float = CONTACT_TOLERANCE_M
    """Penetration depth up to which a contact is no collision [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointPath:
    """Joint path of a track, and what violations are found from."""

    track: GripperTrack
    joints: JointTrack
    reached: NDArray[np.bool_]
    """(T,) frames whose pose is reached: velocities and torques of the nearest posture mean nothing elsewhere."""
    q: Array
    """(T, 7) joint angles of the reached frames [rad]; else NaN."""
    sigma: Array
    """(7,) or (T, 7) standard deviations of their noise [rad]."""
    own: Clearance
    """Distances of the arm from itself."""
    table: Clearance
    """Distances of the arm from the table."""
    noise: TrackNoise
    """Noise of the track, measured or assumed."""
    noise_assumed: bool
    """True if the track is too short to measure its noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathMeasurements:
    """Measurements along a joint path, from which metrics, curves and details are taken."""

    path: JointPath
    coverage: Coverage
    """Lost and unreachable frames."""
    manipulability: Manipulability
    """Manipulability along the path: 0 where unreachable, NaN where lost and not bridged."""
    manipulability_worst: Manipulability
    """The least that the manipulability of each frame can be."""
    free: NDArray[np.bool_]
    """(T,) frames with a posture free of collisions whatever the path (`track_ik.find_free`); of a complete track only
    those where the path itself fails, of recorded joint angles those that are free."""
    smoothness: Smoothness
    """Smoothness of the gripper's track."""
    checks: LimitChecks
    """Velocity, acceleration, jerk and torque against their limits."""
    timing: TimeScale
    """Time-optimal parametrisation (Toppra)."""
    tube: TubeResult
    """Smallest tube about the track that contains a feasible trajectory."""
    tube_limit_m: float
    """Largest tube radius of a feasible track [m]."""
    bridged: NDArray[np.bool_]
    """(T,) lost frames that are bridged (`coverage.bridge_gaps`)."""
    p_BG: Array
    """(T, 3) denoised positions of the TCP [m]; NaN where lost, not bridged."""
    motionless: bool | None
    """True if the gripper neither moves nor turns; None if no frame is tracked."""


def kinematic_metrics(plant: ArmPlant, measured: PathMeasurements) -> tuple[dict[str, Value], dict[str, str]]:
    """Return the metrics by name, with their bounds if frames are lost or out of reach, and why some are None.

    Values are those of measured and bridged frames, unreachable ones at their worst.
    """
    metrics, reasons = _path_metrics(plant, measured)
    track = measured.path.track
    smooth = measured.smoothness
    coverage = measured.coverage
    for name, value in smooth.metrics.items():
        if value is None:
            reasons[name] = smooth.reasons.get(name.partition("_floor_")[0], "") or "the track's noise is unknown"
    if coverage.complete:
        return {**smooth.metrics, **metrics}, reasons
    worst: dict[str, Value] = {**dict.fromkeys(metrics), **smooth.bounds}
    if metrics["manipulability_mean"] is not None:
        worst |= _manipulability_metrics(track.t_s, measured.manipulability_worst)
    if track.tracked.any():
        worst["ik_success_rate"] = float(measured.free.mean())
    if not coverage.lost.any():
        worst |= {name: metrics[name] for name in ("ik_position_error_max_m", "joint_limit_margin_min")}
    if metrics["trajopt_feasible"] is False:  # nor is there a trajectory through more frames
        worst["trajopt_feasible"] = False
    bounds: dict[str, Value] = {name + BOUND: value for name, value in worst.items()}
    reasons |= {name: coverage.reason for name, value in bounds.items() if value is None}
    return {**smooth.metrics, **metrics, **bounds}, reasons


def path_length(p: Array) -> float | None:
    """Return the length [m] of a path `p` (T, 3) through its finite positions; None without two."""
    finite = p[finite_rows(p)]
    return float(np.linalg.norm(np.diff(finite, axis=0), axis=-1).sum()) if len(finite) > 1 else None


def feasible_period(
    t_s: Array, slowdown: Value, violations: Iterable[Violation], undecided: str | None
) -> tuple[float | None, str]:
    """Return the shortest frame period at which a track is feasible [s], or None and why there is none.

    Slower by k = `slowdown_min` the track keeps every limit of speed, acceleration, jerk and torque; nothing else
    depends on time.
    """
    others = sorted({v.kind.value for v in violations if v.kind not in KINDS})
    if others:
        return None, f"no frame period changes {', '.join(others)}"
    if undecided is not None or slowdown is None:
        return None, undecided or "the least slow-down is unknown"
    return float(slowdown * np.median(np.diff(t_s))), ""


def _manipulability_metrics(t_s: Array, w: Manipulability) -> dict[str, Value]:
    return {
        "manipulability_mean": _over_finite(np.mean, w.full),
        "manipulability_min": _over_finite(np.min, w.full),
        "manipulability_integral": time_integral(t_s, w.full),
        "manipulability_cost_mean": _over_finite(np.mean, w.cost),
    }


def _path_metrics(plant: ArmPlant, measured: PathMeasurements) -> tuple[dict[str, Value], dict[str, str]]:
    """Return the metrics of the frames that are neither lost nor unreachable, and why some are None."""
    path = measured.path
    track = path.track
    checks = measured.checks
    timing = measured.timing
    tube = measured.tube
    coverage = measured.coverage
    w = measured.manipulability
    no_value = "no frame is tracked" if not track.tracked.any() else "no frame's pose is reached"
    lowest = _over_finite(np.min, limit_margin(plant, path.q))
    if lowest is not None and coverage.unreachable.any():  # no posture within limits reaches these frames
        lowest = min(0.0, lowest)
    is_free = (path.joints.ok | measured.free)[track.tracked]
    values: dict[str, Value] = {
        **_manipulability_metrics(track.t_s, w),
        "ik_success_rate": float(is_free.mean()) if is_free.size else None,
        "ik_position_error_max_m": _over_finite(np.max, coverage.position_error_m),
        "joint_limit_margin_min": lowest,
        "self_distance_min_m": _over_finite(np.min, path.own.distance_m),
        "table_distance_min_m": _over_finite(np.min, path.table.distance_m),
    }
    rows: dict[str, tuple[Value, str]] = {name: (value, no_value) for name, value in values.items()}
    for kind in KINDS:
        check = checks.checks.get(kind)
        ratio = None if check is None or not np.isfinite(check.ratio_max) else check.ratio_max
        rows[f"{kind.value}_ratio_max"] = ratio, checks.reasons.get(kind, "noise hides it throughout")
    rows["time_scale"] = timing.value, timing.reason or "Toppra gave none"
    slowdown = checks.slowdown
    if slowdown is None:
        why = "too few frames are reached to take a derivative, or noise hides all of them"
        rows["slowdown_min"] = None, why
    else:
        why = f"however slow, the arm's own weight exceeds the torque limit of {slowdown.joint}"
        rows["slowdown_min"] = None if np.isinf(slowdown.factor) else slowdown.factor, why
    for name, value in (("trajopt_feasible", tube.feasible), ("trajopt_position_tube_m", tube.radius_m)):
        rows[name] = value, tube.reason or "no tube was found"
    rows["path_length_m"] = path_length(measured.p_BG), no_value
    rows["motionless"] = measured.motionless, no_value
    metrics = {name: value for name, (value, _) in rows.items()}
    return metrics, {name: why for name, (value, why) in rows.items() if value is None}


def track_curves(plant: ArmPlant, measured: PathMeasurements) -> dict[str, Array]:
    """Return arrays (T,) or (T, 7) by name, for the track's file."""
    checks = measured.checks
    return {
        "bridged": measured.bridged.astype(np.float64),
        "manipulability": measured.manipulability.full,
        "joint_margin": limit_margin(plant, measured.path.joints.q).min(axis=-1),
        "self_distance_m": measured.path.own.distance_m,
        "table_distance_m": measured.path.table.distance_m,
        "q_smooth": checks.q_smooth,
        **{kind.value: check.value for kind, check in checks.checks.items()},
        **{f"{kind.value}_limit": c.limits for kind, c in checks.checks.items() if np.ptp(c.limits, axis=0).any()},
    }


def path_details(plant: ArmPlant, measured: PathMeasurements) -> dict[str, Json]:
    """Serialize measurements into the field `details` of samples.jsonl."""
    path = measured.path
    checks = measured.checks
    residual = (checks.q_smooth - path.q)[finite_rows(checks.q_smooth)]
    slowdown = checks.slowdown
    timing = measured.timing
    return {
        "limits": {
            "joints": list(plant.robot.joints),
            "position": {"lower": _list(plant.lower), "upper": _list(plant.upper)},
            "velocity": _list(plant.velocity_limits),
            "acceleration": _list(plant.acceleration_limits),
            "jerk": _list(plant.jerk_limits),
            "torque": _list(plant.effort_limits),
        },
        "coverage": {
            "lost": int(measured.coverage.lost.sum()),
            "unreachable": int(measured.coverage.unreachable.sum()),
        },
        "noise": {
            "position_m": path.noise.position_m,
            "rotation_rad": path.noise.rotation_rad,
            "assumed": path.noise_assumed,
            "offset_m": path.noise.offset_m,
            "offset_rad": path.noise.offset_rad,
            **({} if path.track.turn_is_sure else {"turn_is_sure": False}),
            "fit_residual_rad": float(np.sqrt(np.mean(residual**2))) if residual.size else None,
            "allowance_sigmas": checks.z,
        },
        "checks": {kind.value: _check(check) for kind, check in checks.checks.items()},
        "slowdown": None
        if slowdown is None
        else {"limit": slowdown.kind.value, "joint": slowdown.joint, "frame": slowdown.frame},
        "time_scale": {
            "limit": timing.constraint.value if timing.constraint else None,
            "joint": timing.joint,
            "frame": timing.frame,
            "reason": timing.reason,
        },
        "trajopt": _tube(measured.tube, measured.tube_limit_m),
    }


def _check(check: LimitCheck) -> dict[str, Json]:
    names = ("ratio_max", "joint", "frame", "t_worst_s", "ratios", "margins", "noise_ratio", "window_s", "bandwidth_hz")
    return {name: _list(v) if isinstance(v := getattr(check, name), np.ndarray) else v for name in names}


def _tube(tube: TubeResult, limit_m: float) -> dict[str, Json]:
    against = tube.violation
    certificate = tube.certificate
    return {
        "tube_limit_m": limit_m,
        "infeasible_radius_m": tube.infeasible_radius_m,
        "reason": tube.reason,
        "against": None
        if against is None
        else {
            "kind": against.kind.value,
            "frame": against.frame_start,
            "joint": against.joint,
            "value": against.value,
            "limit": against.limit,
        },
        "certificate": None if certificate is None else certificate.figures(),
    }


def _list(values: Array | None) -> list[Json] | None:
    return None if values is None else [float(v) if np.isfinite(v) else None for v in values]


def _over_finite(reduce: Callable[[Array], float], values: Array) -> float | None:
    finite = values[np.isfinite(values)]
    return float(reduce(finite)) if finite.size else None
