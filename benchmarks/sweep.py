"""Proofs that poses, or the steps between them, are beyond the arm on any joint path.

They rest on geometry, or on a dense sweep of the redundant joint: all postures of a pose to the sweep's fineness, from
a closed form of their own. A step is beyond the arm if no posture of one pose is near
enough, at full speed of every joint, to any posture of the next.
"""

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.motion import Arm, accelerations
from benchmarks.postures import FLANGE_M, OFFSET_M, SHOULDER_M, all_postures
from kinebench_drake.geometry import Array

SWEEP = 4096
"""Angles of joint 7 over a full turn."""
SLACK_RAD = 0.01
"""Postures count as within limits up to this far outside, so that none is missed between two angles of a sweep."""

REACH_M = float(np.hypot(0.316, 0.0825) + np.hypot(0.384, 0.0825))
"""Farthest that the wrist's centre can be from the shoulder [m]: the arm stretched, with the elbow's offset."""

_FINENESS = 0.02  # step of a sweep, as a part of what the slowest joint can move between two frames


def wrist_distance(X_BG: Array) -> Array:
    """Least distance (...) [m] of shoulder and wrist centre that any angle of joint 7 leaves, for poses (..., 4, 4).

    The wrist lies on a circle of radius 0.088 m about the flange axis, 0.2104 m behind the TCP.
    """
    axis = X_BG[..., :3, 2]
    v = X_BG[..., :3, 3] - FLANGE_M * axis - np.array([0.0, 0.0, SHOULDER_M])
    along = np.sum(v * axis, axis=-1)
    across = np.linalg.norm(v - along[..., None] * axis, axis=-1)
    return np.asarray(np.hypot(along, across - OFFSET_M))


def postures(arm: Arm, X_BG: Array, samples: int = SWEEP) -> Array:
    """All postures (N, 7) [rad] of a pose (4, 4) over a full turn of joint 7, limits ignored."""
    q = all_postures(arm.plant, X_BG, np.linspace(-np.pi, np.pi, samples, endpoint=False)).reshape(-1, 7)
    return np.asarray(q[np.isfinite(q[:, 0])])


def excess(arm: Arm, q: Array) -> Array:
    """How far (N,) [rad] the worst joint of postures (N, 7) is past its limit; negative within."""
    return np.asarray(np.maximum(arm.plant.lower - q, q - arm.plant.upper).max(axis=-1, initial=-np.inf))


def least_excess(arm: Arm, X_BG: Array, samples: int = SWEEP) -> float | None:
    """The same [rad] for the best of all postures of a pose (4, 4); None if it has none at all."""
    q = postures(arm, X_BG, samples)
    return float(excess(arm, q).min()) if len(q) else None


def reachable(arm: Arm, X_BG: Array, samples: int = 256) -> bool:
    """Whether all poses (T, 4, 4) have a posture within limits."""
    return all((e := least_excess(arm, X, samples)) is not None and e <= 0.0 for X in X_BG)


def _allowed(arm: Arm, X_BG: Array, period_s: float, most: int) -> Array:
    step = _FINENESS * period_s * float(arm.plant.velocity_limits.min())
    q = postures(arm, X_BG, int(np.clip(2 * np.pi / step, 512, most)))
    return np.asarray(q[excess(arm, q) <= SLACK_RAD])


def least_step(arm: Arm, X_1: Array, X_2: Array, period_s: float) -> float:
    """Least over all pairs of postures of the greatest joint speed / its limit, between two poses (4, 4).

    More than 1: no joint path makes the step in `period_s` [s], to the sweep's fineness (2 % of what the slowest joint
    can move). Infinite where one of the poses has no posture.
    """
    q_1, q_2 = (_allowed(arm, X, period_s, 4 * SWEEP) for X in (X_1, X_2))
    if not len(q_1) or not len(q_2):
        return np.inf
    scale = arm.plant.velocity_limits * period_s
    distance, _ = cKDTree(q_2 / scale).query(q_1 / scale, p=np.inf)
    return float(distance.min())


def least_bend(arm: Arm, X_BG: Array, period_s: float) -> float:
    """Least over all triples of postures of |second difference| / (limit of acceleration * period^2), worst joint.

    More than 1: no joint path within the limits passes three poses (3, 4, 4) at even times, since a second difference
    of a path is a weighted mean of its second derivative times the squared period (its Peano kernel is a hat). Only
    triples whose first step keeps the speed limits count. Values over 2 are told as infinite.
    """
    q_1, q_2, q_3 = (_allowed(arm, X, period_s, 512) for X in X_BG)
    if not len(q_1) or not len(q_2) or not len(q_3):
        return np.inf
    speed, bend = arm.plant.velocity_limits * period_s, accelerations(arm) * period_s**2
    near = cKDTree(q_1 / speed).query_ball_tree(cKDTree(q_2 / speed), 1.0, p=np.inf)
    onward = [2.0 * q_2[j] - q_1[i][None] for i, j in enumerate(near) if j]
    if not onward:
        return np.inf
    distance, _ = cKDTree(q_3 / bend).query(np.concatenate(onward) / bend, p=np.inf, distance_upper_bound=2.0)
    return float(distance.min())
