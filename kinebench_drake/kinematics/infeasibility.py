"""Why no trajectory stays within a tube about a track: the requirement that is violated most."""

from collections.abc import Sequence

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.joint_trajectory import TubeProblem
from kinebench_drake.kinematics.newton import solve_newton
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.kinematics.violation import RATES, Violation, ViolationKind


def describe_violation(violation: Violation) -> str:
    """Describe a violation at one frame in a line."""
    kind = violation.kind.value.replace("_", " ")
    unit = violation.unit
    joint = f" of {violation.joint}" if violation.joint else ""
    return (
        f"{kind}{joint} near frame {violation.frame_start}: {violation.value:.4g} {unit}, "
        f"limit {violation.limit:.4g} {unit}"
    )


def find_pose_violation(problem: TubeProblem, tube_limit_m: float, margin: float = 1.0) -> Violation | None:
    """Find the worst frame whose pose the arm cannot take near its posture, whatever the time; None if there is none.

    The error is the root of both squared errors, rotation by its arm: up to sqrt(2) times the radius of a tube. It is
    reported above `margin` times its limit `tube_limit_m` [m].
    """
    least_m = margin * tube_limit_m
    plant = problem.plant
    error = np.linalg.norm(problem.errors(np.clip(problem.q, plant.lower, plant.upper)), axis=-1)
    for i in np.argsort(-error, kind="stable")[:10]:  # frames of the greatest errors whose poses are solved one by one
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
            return Violation.at(ViolationKind.UNREACHABLE, frame, None, bounded, tube_limit_m)
        return _joint_limit_violation(plant, frame, j, float(q[j]))
    return None


def find_start_violation(problem: TubeProblem) -> Violation | None:
    """Find the joint angle of the initial path that is farthest past its limit; None if all are within limits."""
    past = limit_excess(problem.plant, problem.q)
    i, j = np.unravel_index(np.argmax(past), past.shape)
    if past[i, j] <= 0.0:
        return None
    return _joint_limit_violation(problem.plant, int(problem.frames[i]), int(j), float(problem.q[i, j]))


def _joint_limit_violation(plant: ArmPlant, frame: int, joint: int, value: float) -> Violation:
    limit = float(plant.upper[joint] if value > plant.upper[joint] else plant.lower[joint])
    return Violation.at(ViolationKind.JOINT_LIMIT, frame, plant.robot.joints[joint], value, limit)


def find_rate_violation(
    problem: TubeProblem, basis: SplineBasis, ratios: Sequence[Array | None], offset: float = 0.0
) -> Violation | None:
    """Find the rate that exceeds its limit most, relative to it; None if none does.

    `ratios` are the control points (n - k, 7) of the k-th derivative of the spline / limit, less `offset`, for k =
    1..3; None without a limit. `offset` is 1 if they are excesses over the limit.
    """
    # of a limit, above which it counts as broken
    worst = None
    least = 1.0 - offset + 1e-3
    for k, (kind, ratio, limit) in enumerate(zip(RATES, ratios, problem.limits.rates, strict=True)):
        if ratio is None or limit is None or ratio.max(initial=0.0) <= least:
            continue
        i, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        least = float(ratio[i, j])
        frame = problem.nearest_frame(float(basis.centres(k + 1)[i]))
        value = float(limit[j] * (offset + least))
        worst = Violation.at(kind, frame, problem.plant.robot.joints[j], value, float(limit[j]))
    return worst
