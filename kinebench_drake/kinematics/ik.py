"""Inverse kinematics of one pose and of a whole track, with a verdict on why a pose cannot be reached."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, orthonormalize, pose_difference
from kinebench_drake.kinematics.branches import excess, postures, smooth, smoothest_path, speed_ratios
from kinebench_drake.kinematics.newton import REACHED_M, newton, snopt
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.robot import rest_q
from kinebench_drake.products import GripperTrack, IkStatus, JointTrack

POSITION_TOLERANCE_M = 1e-6
"""Greatest distance [m] from the wanted TCP of a pose that counts as reached."""
ROTATION_TOLERANCE_RAD = 1e-6
"""Greatest angle [rad] from the wanted TCP of a pose that counts as reached."""

_STARTS = 8  # postures tried as starts before a pose is given up
_SMOOTHING = 10  # passes of smoothing, each followed by a return to the poses


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


def _rigid(X_BG: ArrayLike) -> Array:
    X_BG = np.asarray(X_BG, dtype=np.float64)
    if X_BG.shape != (4, 4) or not np.isfinite(X_BG).all():
        raise InputError(f"X_BG must be a finite 4x4 pose, found shape {X_BG.shape} with values {X_BG.ravel()[:4]}...")
    return make_pose(orthonormalize(X_BG[:3, :3]), X_BG[:3, 3])


def _solution(plant: ArmPlant, X_BG: Array, q: Array, failure: IkStatus = IkStatus.UNREACHABLE) -> IkSolution:
    position, rotation = (float(d) for d in pose_difference(plant.forward(q), X_BG))
    reached = position <= POSITION_TOLERANCE_M and rotation <= ROTATION_TOLERANCE_RAD
    return IkSolution(
        q=q,
        status=IkStatus.OK if reached else failure,
        position_error_m=position,
        rotation_error_rad=rotation,
    )


def solve_pose(plant: ArmPlant, X_BG: ArrayLike, q_seed: ArrayLike) -> IkSolution:
    """Joint angles that bring panda_hand_tcp to a pose, near `q_seed` where there is a choice.

    Newton steps from the seed do it as a rule (some 0.15 ms). If not, all postures that reach the pose come from the
    closed form, joint 7 swept over its turn: the one within limits nearest to the seed is taken. If none is within
    limits, Newton steps start from those least past their limits, then SNOPT, before the pose is given up; the
    verdict is JOINT_LIMIT if the closed form (or Newton without limits) reaches it, else UNREACHABLE.

    Args:
        plant: the robot.
        X_BG: wanted pose (4, 4) of panda_hand_tcp in panda_link0 [m]; its rotation is made orthonormal first.
        q_seed: (7,) posture [rad] to start from.

    Raises:
        InputError: the pose is not a finite 4x4 matrix.
    """
    X_BG, q_seed = _rigid(X_BG), np.asarray(q_seed, dtype=np.float64)
    near, near_error = newton(plant, X_BG, q_seed, iterations=20)
    solution = _solution(plant, X_BG, near)
    if solution.status is IkStatus.OK:
        return solution
    return _solve_anywhere(plant, X_BG, q_seed, near, near_error)


def _solve_anywhere(plant: ArmPlant, X_BG: Array, q_seed: Array, near: Array, near_error: float) -> IkSolution:
    candidates = postures(X_BG)
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
    return [rest_q(), *rng.uniform(plant.lower, plant.upper, size=(_STARTS - 1, 7))]


def solve_track(plant: ArmPlant, track: GripperTrack) -> JointTrack:
    """Joint angles along a track, continuous from frame to frame wherever the poses and limits allow it.

    The first frame takes the posture nearest to ManiSkill's rest posture, every later one starts from the frame
    before. If that path asks a joint for more than its speed (a dead end at a limit, so that the arm must fall into
    another posture), the smoothest of all paths is looked for (`branches.smoothest_path`) and its ends are followed
    forward and backward; of these paths the one with the fewest failed frames, then the lowest peak speed, is
    returned. Frames that are not tracked are left out, their time counted.

    Args:
        plant: the robot.
        track: the gripper's path; `t_s`, `X_BG` and `tracked` are used.

    Raises:
        InputError: a tracked frame's pose is not finite, or the times do not increase.
    """
    if not (np.diff(track.t_s) > 0.0).all():
        raise InputError("t_s must increase from frame to frame")
    frames = np.flatnonzero(track.tracked)
    poses, t_s = [_rigid(track.X_BG[i]) for i in frames], track.t_s[frames]
    solutions = _follow(plant, poses, _first_seed(plant, poses[0])) if poses else []
    peak = _peak_speed(plant, t_s, solutions)
    if peak > 1.0:
        smoothest = _follow_smoothest(plant, t_s, poses)
        forward = _follow(plant, poses, smoothest[0].q)
        backward = _follow(plant, poses[::-1], smoothest[-1].q)[::-1]
        paths = (solutions, smoothest, forward, backward)
        solutions = min(paths, key=lambda path: (_failures(path), _peak_speed(plant, t_s, path)))
    return _joint_track(track, frames, solutions)


def _first_seed(plant: ArmPlant, X_BG: Array) -> Array:
    candidates = postures(X_BG)
    inside = candidates[excess(plant, candidates).max(axis=-1, initial=0.0) <= 0.0]
    return inside[np.argmin(np.sum((inside - rest_q()) ** 2, axis=-1))] if len(inside) else rest_q()


def _failures(solutions: list[IkSolution]) -> int:
    return sum(s.status is not IkStatus.OK for s in solutions)


def _peak_speed(plant: ArmPlant, t_s: Array, solutions: list[IkSolution]) -> float:
    q = [s.q if s.status is IkStatus.OK else np.full(7, np.nan) for s in solutions]
    return float(speed_ratios(plant, t_s, np.reshape(q, (-1, 7))).max(initial=0.0))


def _follow(plant: ArmPlant, poses: list[Array], seed: Array) -> list[IkSolution]:
    """Solutions of `poses`, each started from the one before, the first from `seed`."""
    solutions = []
    for X_BG in poses:
        solutions.append(solve_pose(plant, X_BG, seed))
        seed = solutions[-1].q
    return solutions


def _follow_smoothest(plant: ArmPlant, t_s: Array, poses: list[Array]) -> list[IkSolution]:
    """Solutions near the smoothest path of the grid, smoothed further; gaps in it start from their neighbours."""
    grid = smoothest_path(plant, t_s, np.array(poses), rest_q())
    kept = np.flatnonzero(np.isfinite(grid[:, 0]))
    if len(kept) == 0:
        return _follow(plant, poses, rest_q())
    nearest = kept[np.argmin(np.abs(np.arange(len(poses))[:, None] - kept), axis=-1)]
    solutions = [solve_pose(plant, X_BG, q) for X_BG, q in zip(poses, grid[nearest], strict=True)]
    path = np.array([s.q for s in solutions])
    for _ in range(_SMOOTHING):
        for i, q in enumerate(smooth(path)):
            q_new, error = newton(plant, poses[i], q, iterations=20)
            if error <= REACHED_M:
                path[i] = q_new
    return [
        _solution(plant, X, q) if s.status is IkStatus.OK else s for X, q, s in zip(poses, path, solutions, strict=True)
    ]


def _joint_track(track: GripperTrack, frames: NDArray[np.intp], solutions: list[IkSolution]) -> JointTrack:
    n = len(track.t_s)
    q = np.full((n, 7), np.nan)
    position, rotation = np.full(n, np.nan), np.full(n, np.nan)
    status = [IkStatus.NOT_TRACKED] * n
    for i, solution in zip(frames, solutions, strict=True):
        q[i], status[i] = solution.q, solution.status
        position[i], rotation[i] = solution.position_error_m, solution.rotation_error_rad
    return JointTrack(t_s=track.t_s, q=q, status=tuple(status), position_error_m=position, rotation_error_rad=rotation)
