"""What the robot makes of a track: kinematic metrics, and the limits that it would break."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.path import excess
from kinebench_drake.kinematics.ik import POSITION_TOLERANCE_M, ROTATION_TOLERANCE_RAD, least_excess
from kinebench_drake.kinematics.manipulability import manipulability
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.smoothness import runs, track_smoothness
from kinebench_drake.metrics.violation import Violation as Violation
from kinebench_drake.metrics.violation import ViolationKind as ViolationKind
from kinebench_drake.models.panda.robot import ARM_JOINTS
from kinebench_drake.products import GripperTrack, IkStatus, JointTrack

MIN_TRACKED_FRAMES = 5
"""Fewest tracked frames on which a track can be called feasible."""
MIN_TRACKED_FRACTION = 0.5
"""Least share of tracked frames on which a track can be called feasible."""
VELOCITY_WINDOW_S = 0.25
"""Joint speeds are slopes over about this time, and over three frames at least [s]."""

_LIMIT_TOLERANCE_RAD = 1e-6
_LATER = (
    "acceleration_ratio_max",
    "jerk_ratio_max",
    "torque_ratio_max",
    "time_scale",
    "slowdown_min",
    "trajopt_feasible",
    "trajopt_position_tube_m",
    "self_distance_min_m",
    "table_distance_min_m",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicResult:
    """Everything that kinematics says about one track."""

    metrics: Mapping[str, float | bool | None]
    """Metric names of the output format; None where not measurable."""
    violations: tuple[Violation, ...]
    """Limits broken, by first frame."""
    feasible: bool | None
    """False if there is a violation, None if too few frames are tracked to tell, else True."""


def evaluate_track(plant: ArmPlant, track: GripperTrack, joints: JointTrack) -> KinematicResult:
    """Metrics, violations and verdict of a gripper track and the joint path that follows it.

    Manipulability and joint speeds are taken at the frames whose joint angles do reach the pose; the joint-limit
    margin and the errors at all tracked frames. The manipulability's integral runs over `t_s` by the trapezoid rule
    and bridges gaps; mean and least value are those of the frames.

    Args:
        plant: the robot.
        track: the gripper's path.
        joints: `solve_track(plant, track)`, or given joint angles to be judged as they are.

    Raises:
        InputError: the two tracks differ in length.
    """
    if len(track.t_s) != len(joints.t_s):
        raise InputError(f"the gripper track has {len(track.t_s)} frames, the joint track {len(joints.t_s)}")
    known = np.asarray(np.isfinite(joints.q).all(axis=-1), dtype=bool)
    within = (joints.position_error_m <= POSITION_TOLERANCE_M) & (joints.rotation_error_rad <= ROTATION_TOLERANCE_RAD)
    reached = known & within
    speed = joint_speed(joints.t_s, np.where(reached[:, None], joints.q, np.nan))
    violations = sorted(
        (
            *_unreachable(joints),
            *_past_limits(plant, track, joints),
            *_too_fast(speed, plant.velocity_limits),
        ),
        key=lambda v: (v.frame_start, v.frame_end, v.kind.value, v.joint or ""),
    )
    tracked = int(track.tracked.sum())
    enough = tracked >= max(MIN_TRACKED_FRAMES, MIN_TRACKED_FRACTION * len(track.t_s))
    return KinematicResult(
        metrics=MappingProxyType(_metrics(plant, track, joints, known, reached, speed)),
        violations=tuple(violations),
        feasible=False if violations else (True if enough else None),
    )


def _metrics(
    plant: ArmPlant,
    track: GripperTrack,
    joints: JointTrack,
    known: NDArray[np.bool_],
    reached: NDArray[np.bool_],
    speed: Array,
) -> dict[str, float | bool | None]:
    smoothness = track_smoothness(track)
    w = manipulability(plant, joints.q[reached])
    tracked = int(track.tracked.sum())
    position_error = joints.position_error_m[track.tracked & np.isfinite(joints.position_error_m)]
    margin = limit_margin(plant, joints.q[known])
    ratio = speed[np.isfinite(speed).all(axis=-1)] / plant.velocity_limits
    return {
        "sparc": smoothness.sparc,
        "sparc_rotation": smoothness.sparc_rotation,
        "ldlj": smoothness.ldlj,
        "manipulability_mean": float(w.full.mean()) if len(w.full) else None,
        "manipulability_min": float(w.full.min()) if len(w.full) else None,
        "manipulability_integral": float(np.trapezoid(w.full, joints.t_s[reached])) if len(w.full) > 1 else None,
        "manipulability_cost_mean": float(w.cost.mean()) if len(w.cost) else None,
        "ik_success_rate": float(joints.ok[track.tracked].mean()) if tracked else None,
        "ik_position_error_max_m": float(position_error.max()) if len(position_error) else None,
        "joint_limit_margin_min": float(margin.min()) if len(margin) else None,
        "velocity_ratio_max": float(np.abs(ratio).max()) if len(ratio) else None,
        **dict.fromkeys(_LATER, None),
    }


def limit_margin(plant: ArmPlant, q: Array) -> Array:
    """Distance to the nearer limit / half the joint's range (..., 7) of `q` (..., 7) [rad]: 1 mid-way, 0 at a limit."""
    return np.asarray(np.minimum(q - plant.lower, plant.upper - q) / (0.5 * (plant.upper - plant.lower)))


def joint_speed(t_s: Array, q: Array) -> Array:
    """Smoothed joint speeds (T, 7) [rad/s] of `q` (T, 7) [rad] at times `t_s` (T,) [s]; NaN beside NaN.

    The slope of a straight line fitted to the frames within VELOCITY_WINDOW_S / 2 of each frame, its two neighbours
    at least: at even times the Savitzky-Golay first derivative of order 1 and 2 (A. Savitzky and M. J. E. Golay,
    Anal. Chem. 36, 1964). At the ends of a run of known frames the nearest whole window is used. Runs of a single
    frame have no speed.
    """
    speed = np.full_like(q, np.nan)
    for run in runs(np.asarray(np.isfinite(q).all(axis=-1))):
        t, angles = t_s[run], q[run]
        n = len(t)
        if n < 2:
            continue
        half = max(1, round(0.5 * VELOCITY_WINDOW_S * (n - 1) / float(t[-1] - t[0])))
        width = min(2 * half + 1, n)
        first = np.clip(np.arange(n) - width // 2, 0, n - width)
        index = first[:, None] + np.arange(width)
        dt = t[index] - t[index].mean(axis=-1, keepdims=True)
        speed[run] = np.einsum("nw,nwj->nj", dt, angles[index]) / np.sum(dt**2, axis=-1, keepdims=True)
    return speed


def _unreachable(joints: JointTrack) -> Iterator[Violation]:
    for run in runs(np.array([s is IkStatus.UNREACHABLE for s in joints.status], dtype=bool)):
        yield Violation(
            kind=ViolationKind.UNREACHABLE,
            frame_start=run.start,
            frame_end=run.stop - 1,
            joint=None,
            value=float(joints.position_error_m[run].max()),
            limit=POSITION_TOLERANCE_M,
        )


def _past_limits(plant: ArmPlant, track: GripperTrack, joints: JointTrack) -> Iterator[Violation]:
    """Joint angles past a limit, as given or, where none were found within, as the least bad posture has them."""
    q = joints.q.copy()
    for i, status in enumerate(joints.status):
        if status is IkStatus.JOINT_LIMIT and excess(plant, q[i]).max() <= _LIMIT_TOLERANCE_RAD:
            posture = least_excess(plant, track.X_BG[i])
            q[i] = np.nan if posture is None else posture
    failed = np.array([s is IkStatus.JOINT_LIMIT for s in joints.status], dtype=bool)
    past = np.nan_to_num(excess(plant, q)) * (failed | np.isfinite(joints.q).all(axis=-1))[:, None]
    named = np.zeros(len(q), dtype=bool)
    for j, name in enumerate(ARM_JOINTS):
        for run in runs(past[:, j] > _LIMIT_TOLERANCE_RAD):
            named[run] = True
            worst = float(q[run, j][np.argmax(past[run, j])])
            yield Violation(
                kind=ViolationKind.JOINT_LIMIT,
                frame_start=run.start,
                frame_end=run.stop - 1,
                joint=name,
                value=worst,
                limit=float(plant.upper[j] if worst > plant.upper[j] else plant.lower[j]),
            )
    for run in runs(failed & ~named):  # past a limit between the sweep's samples: no posture to name a joint by
        yield Violation(
            kind=ViolationKind.JOINT_LIMIT,
            frame_start=run.start,
            frame_end=run.stop - 1,
            joint=None,
            value=float(joints.position_error_m[run].max()),
            limit=POSITION_TOLERANCE_M,
        )


def _too_fast(speed: Array, limits: Array) -> Iterator[Violation]:
    for j, name in enumerate(ARM_JOINTS):
        for run in runs(np.abs(speed[:, j]) > limits[j]):
            yield Violation(
                kind=ViolationKind.VELOCITY,
                frame_start=run.start,
                frame_end=run.stop - 1,
                joint=name,
                value=float(np.abs(speed[run, j]).max()),
                limit=float(limits[j]),
            )
