"""Joint paths that begin at the posture in which the robot stands, as those do that it is to execute."""

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.ik import IkSolution, postures_of, solve_pose
from kinebench_drake.kinematics.path import continued_path
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.types import IkStatus

ELBOW_S = 2.0
"""Time in which the elbow is turned from where it is to where a path found by search has it."""


def minimum_jerk(s: Array) -> Array:
    """Fraction of the way (...) at fraction `s` (...) of the time, 0 before and 1 after.

    The minimum-jerk profile of Flash and Hogan (1985, eq. 3): 10 s^3 - 15 s^4 + 6 s^5.
    """
    s = np.clip(np.asarray(s, dtype=np.float64), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def stepwise(plant: ArmPlant, X_BG: Array, q_start: Array) -> tuple[Array, IkSolution | None]:
    """Joint path (N, 7) [rad] that solves one pose (N, 4, 4) after the other, each near the one before.

    It ends at the first pose that is not reached, whose solution is returned with it; the rest is NaN.
    """
    q, seed = np.full((len(X_BG), 7), np.nan), q_start
    for i, X in enumerate(X_BG):
        solution = solve_pose(plant, X, seed)
        if solution.status is not IkStatus.OK:
            return q, solution
        q[i] = seed = solution.q
    return q, None


def foreseeing(plant: ArmPlant, t_s: Array, X_BG: Array, q_start: Array) -> Array:
    """Joint path (N, 7) [rad] at times `t_s` (N,) [s] that turns the elbow in time for what comes; NaN where none is.

    The search may begin at another turn of the elbow than the start's, at t = 0: the difference is faded out.
    """
    return eased(plant, t_s, X_BG, continued_path(plant, postures_of(plant), t_s, X_BG, q_start), q_start)


def eased(plant: ArmPlant, t_s: Array, X_BG: Array, q: Array, q_start: Array) -> Array:
    """The path `q` (N, 7) [rad] entered from the posture `q_start` (7,) of t = 0, the elbow turned while it goes on."""
    fade = 1.0 - minimum_jerk(t_s / ELBOW_S)
    return postures_of(plant).nearest(X_BG, q + fade[:, None] * (q_start - q[0]))
