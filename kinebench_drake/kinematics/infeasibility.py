"""Why no trajectory follows a course within a tube: the requirement that gives way first."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from kinebench_drake.kinematics.newton import newton
from kinebench_drake.kinematics.path import excess
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.trajectory import Contact, Course, JointTrajectory
from kinebench_drake.kinematics.tube import TubeSolution

_STATIC = 10  # worst frames whose posture is looked at for itself
_LEAST_EXCESS = 1e-3  # of a limit, from which on it counts as broken


class TubeFailure(Enum):
    """Which requirement no trajectory within the tube meets."""

    UNREACHABLE = "unreachable"
    JOINT_LIMIT = "joint_limit"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    SELF_COLLISION = "self_collision"
    TABLE_COLLISION = "table_collision"
    TORQUE = "torque"


_UNITS = {
    TubeFailure.UNREACHABLE: "m",
    TubeFailure.JOINT_LIMIT: "rad",
    TubeFailure.VELOCITY: "rad/s",
    TubeFailure.ACCELERATION: "rad/s^2",
    TubeFailure.JERK: "rad/s^3",
    TubeFailure.SELF_COLLISION: "m",
    TubeFailure.TABLE_COLLISION: "m",
    TubeFailure.TORQUE: "N m",
}
_RATES = (TubeFailure.VELOCITY, TubeFailure.ACCELERATION, TubeFailure.JERK)


@dataclass(frozen=True, slots=True, kw_only=True)
class TubeViolation:
    """The requirement that is broken, where it is broken most."""

    kind: TubeFailure
    frame: int
    """The frame nearest to it: a row of the arrays given."""
    joint: str | None
    """Name of the joint; None if no single joint is at fault."""
    value: float
    """What it comes to there: error [m], angle [rad], speed [rad/s] and so on, distance [m], torque [N m]."""
    limit: float
    """What it may be, in the same unit."""

    def __str__(self) -> str:
        """One line for people."""
        joint, unit = f" of {self.joint}" if self.joint else "", _UNITS[self.kind]
        return (
            f"{self.kind.value.replace('_', ' ')}{joint} near frame {self.frame}: {self.value:.4g} {unit}, "
            f"limit {self.limit:.4g} {unit}"
        )


def broken_posture(course: Course, tube_limit_m: float, margin: float = 1.0) -> TubeViolation | None:
    """The worst frame whose pose the arm cannot take, near its posture, even if it had all the time; None if all can.

    Judged by the root of both squared errors, rotation by its arm: up to sqrt(2) times what a tube counts.

    Args:
        course: the track.
        tube_limit_m: greatest error allowed [m].
        margin: only what is worse than this many times the limit is told.
    """
    told_m = margin * tube_limit_m
    plant = course.plant
    error = np.linalg.norm(course.errors(np.clip(course.q, plant.lower, plant.upper)), axis=-1)
    for i in np.argsort(-error, kind="stable")[:_STATIC]:
        if error[i] <= told_m:
            return None
        _, least = newton(plant, course.X_BG[i], course.q[i])
        if least <= told_m:
            continue
        q, free = newton(plant, course.X_BG[i], course.q[i], bounded=False)
        past = excess(plant, q)
        j = int(np.argmax(past))
        frame = int(course.frames[i])
        if free > told_m or past[j] <= 0.0:
            kind, limit = TubeFailure.UNREACHABLE, tube_limit_m
            return TubeViolation(kind=kind, frame=frame, joint=None, value=least, limit=limit)
        return TubeViolation(
            kind=TubeFailure.JOINT_LIMIT,
            frame=frame,
            joint=plant.robot.joints[j],
            value=float(q[j]),
            limit=float(plant.upper[j] if q[j] > plant.upper[j] else plant.lower[j]),
        )
    return None


def broken_start(course: Course) -> TubeViolation | None:
    """The angle farthest past its limit in the joint path to start from; None if all are within."""
    plant = course.plant
    past = np.maximum(plant.lower - course.q, course.q - plant.upper)
    i, j = np.unravel_index(np.argmax(past), past.shape)
    if past[i, j] <= 0.0:
        return None
    value = float(course.q[i, j])
    return TubeViolation(
        kind=TubeFailure.JOINT_LIMIT,
        frame=int(course.frames[i]),
        joint=plant.robot.joints[j],
        value=value,
        limit=float(plant.upper[j] if value > plant.upper[j] else plant.lower[j]),
    )


def broken_rate(course: Course, basis: SplineBasis, solution: TubeSolution | None) -> TubeViolation | None:
    """The rate that an elastic solution exceeds most, relative to its limit; None if it exceeds none.

    Args:
        course: the track.
        basis: the solution's spline.
        solution: of `solve_tube` with `elastic`.
    """
    return None if solution is None else _worst(course, basis, solution.excess, _LEAST_EXCESS, above=1.0)


def steepest_rate(trajectory: JointTrajectory) -> TubeViolation | None:
    """The rate that a trajectory exceeds most, relative to its limit; None if it exceeds none."""
    return _worst(trajectory.course, trajectory.basis, trajectory.usage, 1.0 + _LEAST_EXCESS, above=0.0)


def _worst(
    course: Course,
    basis: SplineBasis,
    ratios: tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None],
    least: float,
    above: float,
) -> TubeViolation | None:
    worst = None
    for k, (kind, ratio, limit) in enumerate(zip(_RATES, ratios, course.limits.rates, strict=True)):
        if ratio is None or limit is None or ratio.max(initial=0.0) <= least:
            continue
        i, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        least = float(ratio[i, j])
        worst = TubeViolation(
            kind=kind,
            frame=course.nearest(float(basis.centres(k + 1)[i])),
            joint=course.plant.robot.joints[j],
            value=float(limit[j] * (above + least)),
            limit=float(limit[j]),
        )
    return worst


def broken_distance(course: Course, contact: Contact | None) -> TubeViolation | None:
    """A contact as a violation; None if its distance is kept."""
    if contact is None or not contact.broken:
        return None
    return TubeViolation(
        kind=TubeFailure.TABLE_COLLISION if contact.table else TubeFailure.SELF_COLLISION,
        frame=course.nearest(contact.t_s),
        joint=None,
        value=contact.distance_m,
        limit=contact.least_m,
    )


def broken_torque(trajectory: JointTrajectory) -> TubeViolation | None:
    """The torque farthest beyond its limit; None if all are kept."""
    course = trajectory.course
    ratio = np.abs(trajectory.torque / course.plant.effort_limits)
    k, j = np.unravel_index(np.argmax(ratio), ratio.shape)
    if ratio[k, j] <= 1.0:
        return None
    return TubeViolation(
        kind=TubeFailure.TORQUE,
        frame=course.nearest(float(trajectory.samples_s[k])),
        joint=course.plant.robot.joints[j],
        value=float(trajectory.torque[k, j]),
        limit=float(course.plant.effort_limits[j]),
    )
