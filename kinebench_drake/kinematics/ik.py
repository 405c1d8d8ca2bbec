"""Inverse kinematics of one pose and of a whole track, with a verdict on why a pose cannot be reached."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, orthonormalize, pose_difference
from kinebench_drake.kinematics.newton import newton, snopt
from kinebench_drake.kinematics.path import excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import Postures, find_postures
from kinebench_drake.types import IkStatus

POSITION_TOLERANCE_M = 1e-6
"""Greatest distance [m] from the wanted TCP of a pose that counts as reached."""
ROTATION_TOLERANCE_RAD = 1e-6
"""Greatest angle [rad] from the wanted TCP of a pose that counts as reached."""

_SWEEP = 128  # angles of the redundancy tried before a pose is given up (of the Panda: every 2.8 degrees)
_ROUNDS = 5  # times the sweep is halved where postures lie far apart
_REFINED_RAD = np.linspace(-0.05, 0.05, 41)  # finer angles about the least bad of them
_STARTS = 8  # postures tried as starts before a pose is given up


@dataclass(frozen=True, slots=True, kw_only=True)
class IkSolution:
    """Outcome of inverse kinematics for one pose."""

    q: Array
    """(7,) joint angles within limits [rad]: they reach the pose if the status is ok, else come nearest to it."""
    status: IkStatus
    """OK, JOINT_LIMIT (reached only with a joint past its limit) or UNREACHABLE (not even so)."""
    position_error_m: float
    """Distance left between the wanted and the reached TCP [m]."""
    rotation_error_rad: float
    """Angle left between the wanted and the reached TCP [rad]."""


@lru_cache(maxsize=4)
def postures_of(plant: ArmPlant) -> Postures:
    """How the postures of a plant are found: decided once a plant."""
    return find_postures(plant)


def least_excess(plant: ArmPlant, X_BG: Array) -> Array | None:
    """Posture (7,) [rad] that reaches `X_BG` (4, 4) with its worst joint least past its limit; None if none is known.

    All branches on _SWEEP angles of the redundancy, then on finer ones about the least bad of them.
    """
    postures = postures_of(plant)
    q = postures.all(X_BG[None], _SWEEP, _ROUNDS)[0]
    if len(q) == 0:
        return None
    coarse = q[np.argmin(excess(plant, q).max(axis=-1))]
    fine = np.vstack([coarse[None], postures.around(X_BG[None], coarse[None], _REFINED_RAD)[0]])
    return np.asarray(fine[np.argmin(excess(plant, fine).max(axis=-1))])


def solve_pose(plant: ArmPlant, X_BG: ArrayLike, q_seed: ArrayLike) -> IkSolution:
    """Joint angles that bring the TCP to a pose, near `q_seed` where there is a choice.

    Newton steps from the seed do it as a rule (some 0.15 ms). If not, all postures that reach the pose are listed
    (of the Panda in closed form, joint 7 swept over its turn): the one within limits nearest to the seed is taken. If
    none is within limits, Newton steps start from those least past their limits, then SNOPT, before the pose is given
    up; the verdict is JOINT_LIMIT if the pose is reached without limits, else UNREACHABLE.

    Args:
        plant: the robot.
        X_BG: wanted pose (4, 4) of the TCP in the base [m]; its rotation is made orthonormal first.
        q_seed: (7,) posture [rad] to start from.

    Raises:
        InputError: the pose is not a finite 4x4 matrix.
    """
    X_BG, q_seed = np.asarray(X_BG, dtype=np.float64), np.asarray(q_seed, dtype=np.float64)
    if X_BG.shape != (4, 4) or not np.isfinite(X_BG).all():
        raise InputError(f"X_BG must be a finite 4x4 pose, found shape {X_BG.shape} with values {X_BG.ravel()[:4]}...")
    X_BG = make_pose(orthonormalize(X_BG[:3, :3]), X_BG[:3, 3])
    near, near_error = newton(plant, X_BG, q_seed, iterations=20)
    solution = _solution(plant, X_BG, near)
    if solution.status is IkStatus.OK:
        return solution
    return _solve_anywhere(plant, X_BG, q_seed, near, near_error)


def _solution(plant: ArmPlant, X_BG: Array, q: Array, failure: IkStatus = IkStatus.UNREACHABLE) -> IkSolution:
    position, rotation = (float(d) for d in pose_difference(plant.forward(q), X_BG))
    reached = position <= POSITION_TOLERANCE_M and rotation <= ROTATION_TOLERANCE_RAD
    return IkSolution(
        q=q,
        status=IkStatus.OK if reached else failure,
        position_error_m=position,
        rotation_error_rad=rotation,
    )


def _solve_anywhere(plant: ArmPlant, X_BG: Array, q_seed: Array, near: Array, near_error: float) -> IkSolution:
    postures = postures_of(plant)
    if postures.out_of_reach_m(X_BG[None])[0] > 0.0:
        q, error = newton(plant, X_BG, plant.robot.rest_q)
        return _solution(plant, X_BG, q if error < near_error else near)
    candidates = postures.all(X_BG[None], _SWEEP, _ROUNDS)[0]
    worst = excess(plant, candidates).max(axis=-1, initial=0.0)
    inside = candidates[worst <= 0.0]
    if len(inside):
        nearest = inside[np.argmin(np.sum((inside - q_seed) ** 2, axis=-1))]
        return _solution(plant, X_BG, newton(plant, X_BG, nearest)[0])
    if len(candidates):
        starts = [*candidates[np.argsort(worst)[: 2 * _STARTS : 2]]]
        failure = IkStatus.JOINT_LIMIT
    else:
        starts = _spread(plant)
        free = [newton(plant, X_BG, start, bounded=False)[0] for start in starts]
        reached = any(_solution(plant, X_BG, q).status is IkStatus.OK for q in free)
        failure = IkStatus.JOINT_LIMIT if reached else IkStatus.UNREACHABLE
        starts = [*starts, *free] if reached else starts
    best, error = near, near_error
    for start in starts:
        q, e = newton(plant, X_BG, start)
        if e < error:
            best, error = q, e
    solution = _solution(plant, X_BG, best, failure)
    if solution.status is IkStatus.OK or failure is IkStatus.UNREACHABLE:
        return solution
    q, e = newton(plant, X_BG, snopt(plant, X_BG, best))
    return _solution(plant, X_BG, q, failure) if e < error else solution


def _spread(plant: ArmPlant) -> list[Array]:
    """A few fixed postures all over the joint ranges, the rest posture first."""
    rng = np.random.default_rng(0)
    return [plant.robot.rest_q, *rng.uniform(plant.lower, plant.upper, size=(_STARTS - 1, 7))]
