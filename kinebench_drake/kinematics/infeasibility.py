"""Why no trajectory stays within a tube about a track: the requirement that is violated most."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.newton import solve_newton
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.trajectory import Contact, JointTrajectory, TubeProblem
from kinebench_drake.kinematics.violation import ViolationKind

_WORST_FRAMES = 10  # frames of the greatest errors whose poses are solved one by one
_LEAST_EXCESS = 1e-3  # of a limit, above which it counts as broken

_UNITS = {
    ViolationKind.UNREACHABLE: "m",
    ViolationKind.JOINT_LIMIT: "rad",
    ViolationKind.VELOCITY: "rad/s",
    ViolationKind.ACCELERATION: "rad/s^2",
    ViolationKind.JERK: "rad/s^3",
    ViolationKind.SELF_COLLISION: "m",
    ViolationKind.TABLE_COLLISION: "m",
    ViolationKind.TORQUE: "N m",
}
_RATES = (ViolationKind.VELOCITY, ViolationKind.ACCELERATION, ViolationKind.JERK)


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeViolation:
    """Requirement that no trajectory within the tube meets, where it is violated most."""

    kind: ViolationKind
    frame: int
    """Nearest frame, as a row of the input arrays."""
    joint: str | None
    """Name of the joint; None if it concerns no single joint."""
    value: float
    """Value there: error [m], angle [rad], speed [rad/s] and so on, distance [m], torque [N m]."""
    limit: float
    """Limit of the value, in the same unit."""

    def __str__(self) -> str:
        """Format as one line."""
        joint, unit = f" of {self.joint}" if self.joint else "", _UNITS[self.kind]
        return (
            f"{self.kind.value.replace('_', ' ')}{joint} near frame {self.frame}: {self.value:.4g} {unit}, "
            f"limit {self.limit:.4g} {unit}"
        )


def find_pose_violation(problem: TubeProblem, tube_limit_m: float, margin: float = 1.0) -> TubeViolation | None:
    """Find the worst frame whose pose the arm cannot take near its posture, whatever the time; None if there is none.

    The error is the root of both squared errors, rotation by its arm: up to sqrt(2) times the radius of a tube.

    Args:
        problem: the track.
        tube_limit_m: greatest allowed error [m].
        margin: factor of the limit above which an error is reported.
    """
    least_m = margin * tube_limit_m
    plant = problem.plant
    error = np.linalg.norm(problem.errors(np.clip(problem.q, plant.lower, plant.upper)), axis=-1)
    for i in np.argsort(-error, kind="stable")[:_WORST_FRAMES]:
        if error[i] <= least_m:
            return None
        _, bounded = solve_newton(plant, problem.X_BG[i], problem.q[i])
        if bounded <= least_m:
            continue
        q, free = solve_newton(plant, problem.X_BG[i], problem.q[i], bounded=False)
        past = limit_excess(plant, q)
        j = int(np.argmax(past))
        frame = int(problem.frames[i])
        if free > least_m or past[j] <= 0.0:
            kind, limit = ViolationKind.UNREACHABLE, tube_limit_m
            return TubeViolation(kind=kind, frame=frame, joint=None, value=bounded, limit=limit)
        return _joint_limit_violation(plant, frame, j, float(q[j]))
    return None


def find_start_violation(problem: TubeProblem) -> TubeViolation | None:
    """Find the joint angle of the initial path that is farthest past its limit; None if all are within limits."""
    plant = problem.plant
    past = np.maximum(plant.lower - problem.q, problem.q - plant.upper)
    i, j = np.unravel_index(np.argmax(past), past.shape)
    if past[i, j] <= 0.0:
        return None
    return _joint_limit_violation(plant, int(problem.frames[i]), int(j), float(problem.q[i, j]))


def _joint_limit_violation(plant: ArmPlant, frame: int, joint: int, value: float) -> TubeViolation:
    return TubeViolation(
        kind=ViolationKind.JOINT_LIMIT,
        frame=frame,
        joint=plant.robot.joints[joint],
        value=value,
        limit=float(plant.upper[joint] if value > plant.upper[joint] else plant.lower[joint]),
    )


def find_rate_violation(
    problem: TubeProblem, basis: SplineBasis, ratios: Sequence[Array | None], offset: float = 0.0
) -> TubeViolation | None:
    """Find the rate that exceeds its limit most, relative to it; None if none does.

    Args:
        problem: the track.
        basis: spline of the trajectory.
        ratios: (n - k, 7) control points of the k-th derivative / limit, less `offset`, k = 1..3; None without a limit.
        offset: 1 if the ratios are excesses over the limit.
    """
    worst, least = None, 1.0 - offset + _LEAST_EXCESS
    for k, (kind, ratio, limit) in enumerate(zip(_RATES, ratios, problem.limits.rates, strict=True)):
        if ratio is None or limit is None or ratio.max(initial=0.0) <= least:
            continue
        i, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        least = float(ratio[i, j])
        worst = TubeViolation(
            kind=kind,
            frame=problem.nearest_frame(float(basis.centres(k + 1)[i])),
            joint=problem.plant.robot.joints[j],
            value=float(limit[j] * (offset + least)),
            limit=float(limit[j]),
        )
    return worst


def find_contact_violation(problem: TubeProblem, contact: Contact | None) -> TubeViolation | None:
    """Return a contact as a violation; None if its distance is kept."""
    if contact is None or not contact.violated:
        return None
    return TubeViolation(
        kind=ViolationKind.TABLE_COLLISION if contact.table else ViolationKind.SELF_COLLISION,
        frame=problem.nearest_frame(contact.t_s),
        joint=None,
        value=contact.distance_m,
        limit=contact.least_m,
    )


def find_torque_violation(trajectory: JointTrajectory) -> TubeViolation | None:
    """Find the torque farthest beyond its limit; None if all are within limits."""
    problem = trajectory.problem
    ratio = np.abs(trajectory.torque / problem.plant.effort_limits)
    k, j = np.unravel_index(np.argmax(ratio), ratio.shape)
    if ratio[k, j] <= 1.0:
        return None
    return TubeViolation(
        kind=ViolationKind.TORQUE,
        frame=problem.nearest_frame(float(trajectory.samples_s[k])),
        joint=problem.plant.robot.joints[j],
        value=float(trajectory.torque[k, j]),
        limit=float(problem.plant.effort_limits[j]),
    )
