"""How badly numbers fit a robot when they are read in one way: one cost, comparable between readings of a file.

A wrong unit, order of rotations or frame leaves the numbers smooth, but moves the gripper out of reach or below the
table, turns it upwards or lets it turn a lot. The cost sums what speaks against a reading, each as a share of frames
times a weight. It compares readings; it is no verdict on a motion.
"""

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.path import grid_postures, limit_excess, within_limits
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.noise import rotation_steps
from kinebench_drake.segments import evenly, finite_rows

UNREACHED, UPWARD, BELOW, CLOSE, TURNING, TILTED, SLOW = 1.0, 0.5, 0.5, 0.5, 1.0, 0.4, 1.0
"""Costs of motions that are out of reach, point upwards, run below the table, stay close to the base, turn all the
time, are never vertical, and last for ever."""


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
    t_s, frames = t_s[valid], evenly(int(valid.sum()), 64)  # on which reach is tested
    X = np.asarray(X_BG)[valid] if q is None else plant.forward_path(q[valid])
    distance = np.hypot(X[:, 0, 3], X[:, 1, 3])
    upward, height = X[:, 2, 2], X[:, 2, 3] - table_height_m
    duration = max(float(t_s[-1] - t_s[0]), 1e-9)
    turned = float(np.linalg.norm(rotation_steps(X[:, :3, :3]), axis=-1).sum())
    moved = float(np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=-1).sum())
    vertical = upward < -np.cos(np.deg2rad(1.0))  # as simulators and scripts hold it
    step = float(np.median(np.diff(t_s)))
    # Robots are recorded faster than every 5 s; every 0.9 s in a motion below 2 mm/s means a smaller unit of time.
    slow = step > 5.0 or (step > 0.9 and 0.01 < moved < 0.002 * duration)
    cost = (
        UPWARD * (upward > 0.5).mean()  # within 60 degrees of straight up
        + BELOW * (height < -0.03).mean()  # no calibration error
        + CLOSE * (distance < 0.3).mean()  # hardly anybody works there
        + TURNING * min(turned / duration / 2.0, 1.0)  # [rad/s]; the limit of the hand is 2.5
        + TILTED * (1.0 - vertical.mean())
        + SLOW * slow
    )
    # A gripper that starts upright, but turned by 45 degrees, and comes no nearer to the table than a flange whose
    # fingers work on it, may be the flange: so it is in the Panda's rest postures.
    if q is None and upward[0] < -np.cos(np.deg2rad(6.0)) and 0.1 < height.min() < 0.21:
        yaw = np.arctan2(X[0, 1, 0], X[0, 0, 0]) % (np.pi / 2)
        cost += 0.4 * (abs(yaw - np.pi / 4) < np.deg2rad(2.5))
    if cost >= enough:
        return float(cost)
    if q is not None:
        reached = limit_excess(plant, q[valid][frames]).max(axis=-1) <= 1e-3
    else:
        reached = np.array([len(own) > 0 for own in within_limits(plant, grid_postures(plant, X[frames], 36))])
    reached &= ~((distance < 0.15) & (X[:, 2, 3] < 0.3))[frames]  # inside of the base
    return float(cost + UNREACHED * (1.0 - reached.mean()))
