"""How badly numbers fit a robot when they are read in one way: one cost, comparable between readings of a file.

A wrong unit, order of rotations or frame leaves the numbers smooth, but moves the gripper out of reach or below the
table, turns it upwards or lets it turn a lot. The cost sums what speaks against a reading, each as a share of frames
times a weight. It compares readings; it is no verdict on a motion.
"""

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.path import grid_postures, limit_excess, within_limits
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import ClosedFormSolver, posture_solver
from kinebench_drake.metrics.noise import rotation_steps
from kinebench_drake.segments import evenly, finite_rows

UNREACHED = 1.0
UPWARD = 0.5
BELOW = 0.5
CLOSE = 0.5
TURNING = 1.0
TILTED = 0.4
SLOW = 1.0
"""Costs of motions that are out of reach, point upwards, run below the table, stay close to the base, turn all the
time, are never vertical, and last for ever."""
FLANGE = 0.4
"""Cost of a gripper that starts upright, but turned by 45 degrees, and comes no nearer to the table than a flange does:
so is the flange of the Panda in its rest postures."""
OUTSIDE = 2.0
"""Cost of joint angles of which one is mostly outside its limits: more than that of any motion of the arm."""
MOSTLY = 0.6
"""Share of such frames: planted excursions over a limit take at most 0.53."""

_FRAMES = 64  # on which reach is tested
_PAST_RAD = 1e-3  # of joint limits
_FAR_RAD = 0.02  # of joint limits: no noise, no calibration error
_BELOW_M = 0.03  # depth under the table that is no calibration error
# radius and height of the base, in which there is no gripper
_BASE_M = 0.15
_BASE_HEIGHT_M = 0.3
_CLOSE_M = 0.3  # distance from the base's axis at which hardly anybody works
_UP = 0.5  # cosine to the vertical: within 60 degrees of straight up
_VERTICAL = float(np.cos(np.deg2rad(1.0)))  # as simulators and scripts hold it
_UPRIGHT = float(np.cos(np.deg2rad(6.0)))  # at the start, in a rest posture
_TURN_RAD_S = 2.0  # mean angular speed with the full cost; the hand's limit is 2.5
# frames that far apart in a motion that slow are in a smaller unit
_SLOW_STEP_S = 0.9
_SLOW_M_S = 0.002
_LONG_STEP_S = 5.0  # robots are recorded faster
_FLANGE_M = (0.1, 0.21)  # heights of the flange above a table on which the fingers work
_SQUARE_RAD = float(np.deg2rad(2.5))


def misfit(
    plant: ArmPlant,
    t_s: Array,
    X_BG: Array | None,
    q: Array | None,
    *,
    table_height_m: float,
    enough: float = float("inf"),
) -> float:
    """Return the cost of a motion.

    Args:
        t_s: (T,) times [s].
        X_BG: (T, 4, 4) poses of the TCP in B [m]; NaN where unknown.
        q: (T, 7) joint angles [rad] in place of poses; NaN where unknown.
        table_height_m: height of the table top in B [m].
        enough: cost from which a lower bound is returned: inverse kinematics are left out.
    """
    numbers = q if X_BG is None else X_BG
    valid = finite_rows(np.asarray(numbers, dtype=np.float64).reshape(len(t_s), -1))
    t_s = t_s[valid]
    frames = evenly(int(valid.sum()), _FRAMES)
    X = np.asarray(X_BG)[valid] if q is None else plant.forward_path(q[valid])
    distance = np.hypot(X[:, 0, 3], X[:, 1, 3])
    upward = X[:, 2, 2]
    height = X[:, 2, 3] - table_height_m
    duration = max(float(t_s[-1] - t_s[0]), 1e-9)
    turned = float(np.linalg.norm(rotation_steps(X[:, :3, :3]), axis=-1).sum())
    moved = float(np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=-1).sum())
    vertical = upward < -_VERTICAL
    step = float(np.median(np.diff(t_s)))
    slow = step > _LONG_STEP_S or (step > _SLOW_STEP_S and 0.01 < moved < _SLOW_M_S * duration)
    is_franka = isinstance(posture_solver(plant), ClosedFormSolver)
    cost = TURNING * min(turned / duration / _TURN_RAD_S, 1.0) + SLOW * slow
    if is_franka:  # how Franka's arms are used
        cost = (
            UPWARD * (upward > _UP).mean()
            + BELOW * (height < -_BELOW_M).mean()
            + CLOSE * (distance < _CLOSE_M).mean()
            + TURNING * min(turned / duration / _TURN_RAD_S, 1.0)
            + TILTED * (1.0 - vertical.mean())
            + SLOW * slow
        )
    if is_franka and q is None and upward[0] < -_UPRIGHT and _FLANGE_M[0] < height.min() < _FLANGE_M[1]:
        yaw = np.arctan2(X[0, 1, 0], X[0, 0, 0]) % (np.pi / 2)
        cost += FLANGE * (abs(yaw - np.pi / 4) < _SQUARE_RAD)
    if cost >= enough:
        return float(cost)
    if q is not None:
        excess = limit_excess(plant, q[valid][frames])
        reached = excess.max(axis=-1) <= _PAST_RAD
        cost += OUTSIDE * ((excess > _FAR_RAD).mean(axis=0).max() > MOSTLY)
    else:
        reached = np.array([len(own) > 0 for own in within_limits(plant, grid_postures(plant, X[frames], 36))])
    if is_franka:
        reached &= ~((distance < _BASE_M) & (X[:, 2, 3] < _BASE_HEIGHT_M))[frames]
    return float(cost + UNREACHED * (1.0 - reached.mean()))
