"""Inverse kinematics of one pose, with the reason why a pose cannot be reached."""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, orthonormalize, pose_difference
from kinebench_drake.kinematics.newton import solve_newton
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import NumericSolver, posture_solver, spread_postures
from kinebench_drake.track import IkStatus

POSITION_TOLERANCE_M = 1e-6
"""Greatest position error of a reached pose [m]."""
ROTATION_TOLERANCE_RAD = 1e-6
"""Greatest rotation error of a reached pose [rad]."""

_SWEEP = 128  # angles of the redundancy (of the Panda: every 2.8 degrees)
_ROUNDS = 5  # halvings of the sweep where postures are far apart
_STARTS = 8  # starts of the numeric search
_NEARLY_M = 0.001  # error from which on it is continued: near singularities a step gains less than half of it
_MOST_STEPS = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class IkSolution:
    """Outcome of inverse kinematics for one pose."""

    q: Array
    """(J,) joint angles within limits [rad]: a solution if the status is ok, else the posture of least pose error."""
    status: IkStatus
    """OK, JOINT_LIMIT (reached only with a joint past its limit) or UNREACHABLE (not even then)."""
    position_error_m: float
    """Position error of the TCP [m]."""
    rotation_error_rad: float
    """Rotation error of the TCP [rad]."""


def find_least_excess(plant: ArmPlant, X_BG: Array) -> Array | None:
    """Find the posture (J,) [rad] that reaches `X_BG` (4, 4) with the least limit excess; None if no posture does.

    All branches on _SWEEP angles of the redundancy, then a finer sweep about the best of them.
    """
    solver = posture_solver(plant)
    q = solver.all(X_BG[None], _SWEEP, _ROUNDS)[0]
    if len(q) == 0:
        return None
    coarse = q[np.argmin(limit_excess(plant, q).max(axis=-1))]
    # Offsets of the finer sweep about the posture of least excess.
    fine = np.vstack([coarse[None], solver.around(X_BG[None], coarse[None], np.linspace(-0.05, 0.05, 41))[0]])
    return np.asarray(fine[np.argmin(limit_excess(plant, fine).max(axis=-1))])


def solve_pose(plant: ArmPlant, X_BG: Array, q_seed: Array) -> IkSolution:
    """Solve joint angles that bring the TCP to `X_BG` (4, 4) [m], made orthonormal first, near `q_seed` (J,) [rad].

    Newton steps from the seed converge in most cases (some 0.15 ms). If not, the posture within limits nearest to the
    seed is used, of all that reach the pose. If there is none, Newton steps start from those of least limit excess;
    if these fail too, the status is JOINT_LIMIT if the pose is reached without limits, else UNREACHABLE.

    Raises:
        InputError: the pose is not a finite 4x4 matrix.
    """
    if X_BG.shape != (4, 4) or not np.isfinite(X_BG).all():
        raise InputError(f"X_BG must be a finite 4x4 pose, found shape {X_BG.shape} with values {X_BG.ravel()[:4]}...")
    X_BG = make_pose(orthonormalize(X_BG[:3, :3]), X_BG[:3, 3])
    near, near_error = solve_newton(plant, X_BG, q_seed, iterations=20)
    solution = _solution(plant, X_BG, near)
    if solution.status is IkStatus.OK:
        return solution
    return _solve_anywhere(plant, X_BG, q_seed, near, near_error)


def _solution(plant: ArmPlant, X_BG: Array, q: Array, failure: IkStatus = IkStatus.UNREACHABLE) -> IkSolution:
    position, rotation = (float(d) for d in pose_difference(plant.forward(q), X_BG))
    reached = position <= POSITION_TOLERANCE_M and rotation <= ROTATION_TOLERANCE_RAD
    status = IkStatus.OK if reached else failure
    return IkSolution(q=q, status=status, position_error_m=position, rotation_error_rad=rotation)


def _solve_anywhere(plant: ArmPlant, X_BG: Array, q_seed: Array, near: Array, near_error: float) -> IkSolution:
    solver = posture_solver(plant)
    if solver.out_of_reach_m(X_BG[None])[0] > 0.0:
        q, error = solve_newton(plant, X_BG, plant.robot.rest_q)
        return _solution(plant, X_BG, q if error < near_error else near)
    candidates = solver.all(X_BG[None], _SWEEP, _ROUNDS)[0]
    worst = limit_excess(plant, candidates).max(axis=-1, initial=0.0)
    inside = candidates[worst <= 0.0]
    if len(inside):
        nearest = inside[np.argmin(np.sum((inside - q_seed) ** 2, axis=-1))]
        return _solution(plant, X_BG, solve_newton(plant, X_BG, nearest)[0])
    if len(candidates):
        starts = [*candidates[np.argsort(worst)[: 2 * _STARTS : 2]]]
        failure = IkStatus.JOINT_LIMIT
    else:
        starts = [*spread_postures(plant, _STARTS)]
        free = [solve_newton(plant, X_BG, start, bounded=False)[0] for start in starts]
        reached = any(_solution(plant, X_BG, q).status is IkStatus.OK for q in free)
        failure = IkStatus.JOINT_LIMIT if reached else IkStatus.UNREACHABLE
        starts = [*starts, *free] if reached else starts
    best = near
    error = near_error
    for start in starts:
        q, e = solve_newton(plant, X_BG, start)
        if e < error:
            best = q
            error = e
    if error < _NEARLY_M and isinstance(solver, NumericSolver):
        best, _ = solve_newton(plant, X_BG, best, iterations=_MOST_STEPS)
    return _solution(plant, X_BG, best, failure)
