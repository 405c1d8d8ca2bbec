"""Proofs that poses, or the steps between them, are beyond the arm on any joint path.

They rest on geometry, or on a dense sweep of the redundant joint: all postures of a pose to the sweep's resolution, by
a closed form of their own. A step is beyond the arm if no posture of the one pose is within reach, at full speed of
every joint, of any posture of the other.
"""

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.motion import Arm
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import HAND_TO_TCP_M

SHOULDER_M = 0.333
OFFSET_M = 0.088
FLANGE_M = 0.107 + HAND_TO_TCP_M
"""Height of the shoulder, distance of wrist and flange axis, distance of wrist and TCP along the flange axis [m]."""

_D3 = 0.316
_D5 = 0.384
_A4 = 0.0825
_HAND_YAW = -np.pi / 4
SWEEP = 4096
"""Angles of joint 7 over a full turn."""
SLACK_RAD = 0.01
"""Tolerance of joint limits, so that no posture is missed between two angles of a sweep [rad]."""

REACH_M = float(np.hypot(0.316, 0.0825) + np.hypot(0.384, 0.0825))
"""Greatest distance of wrist centre and shoulder [m]: the arm stretched, with the elbow's offset."""

_RESOLUTION = 0.02
"""Step of a sweep / what the slowest joint can move between two frames."""


def wrist_distance(X_BG: Array) -> Array:
    """Return the least distance (...) [m] of shoulder and wrist centre over joint 7, for poses (..., 4, 4).

    The wrist lies on a circle of radius 0.088 m about the flange axis, 0.2104 m behind the TCP.
    """
    axis = X_BG[..., :3, 2]
    v = X_BG[..., :3, 3] - FLANGE_M * axis - np.array([0.0, 0.0, SHOULDER_M])
    along = np.sum(v * axis, axis=-1)
    across = np.linalg.norm(v - along[..., None] * axis, axis=-1)
    return np.asarray(np.hypot(along, across - OFFSET_M))


def postures(arm: Arm, X_BG: Array, samples: int = SWEEP) -> Array:
    """Return all postures (N, 7) [rad] of a pose (4, 4) over a full turn of joint 7, limits ignored."""
    q = all_postures(arm.plant, X_BG, np.linspace(-np.pi, np.pi, samples, endpoint=False)).reshape(-1, 7)
    return np.asarray(q[np.isfinite(q[:, 0])])


def excess(arm: Arm, q: Array) -> Array:
    """Return the excess (N,) [rad] of the worst joint of postures (N, 7) over its limit; negative within."""
    return np.asarray(np.maximum(arm.plant.lower - q, q - arm.plant.upper).max(axis=-1, initial=-np.inf))


def least_excess(arm: Arm, X_BG: Array, samples: int = SWEEP) -> float | None:
    """Return the excess [rad] of the best of all postures of a pose (4, 4); None if there is no posture."""
    q = postures(arm, X_BG, samples)
    return float(excess(arm, q).min()) if len(q) else None


def reachable(arm: Arm, X_BG: Array, samples: int = 256) -> bool:
    """Return True if all poses (T, 4, 4) have a posture within limits."""
    return all((e := least_excess(arm, X, samples)) is not None and e <= 0.0 for X in X_BG)


def _allowed(arm: Arm, X_BG: Array, period_s: float, most: int) -> Array:
    step = _RESOLUTION * period_s * float(arm.plant.velocity_limits.min())
    q = postures(arm, X_BG, int(np.clip(2 * np.pi / step, 512, most)))
    return np.asarray(q[excess(arm, q) <= SLACK_RAD])


def least_step(arm: Arm, X_1: Array, X_2: Array, period_s: float) -> float:
    """Return the least, over all pairs of postures of two poses (4, 4), of the greatest joint speed / its limit.

    More than 1: no joint path makes the step in `period_s` [s], to the sweep's resolution (2 % of what the slowest
    joint can move). Infinite if one of the poses has no posture.
    """
    q_1, q_2 = (_allowed(arm, X, period_s, 4 * SWEEP) for X in (X_1, X_2))
    if not len(q_1) or not len(q_2):
        return np.inf
    scale = arm.plant.velocity_limits * period_s
    distance, _ = cKDTree(q_2 / scale).query(q_1 / scale, p=np.inf)
    return float(distance.min())


def least_bend(arm: Arm, X_BG: Array, period_s: float) -> float:
    """Return the least, over all triples of postures, of |second difference| / (acceleration limit * period^2).

    More than 1: no joint path within the limits passes three poses (3, 4, 4) at even times, since a second difference
    of a path is a weighted mean of its second derivative times the squared period (its Peano kernel is a hat). Only
    triples whose first step keeps the speed limits count; the worst joint decides. Values over 2 are infinite.
    """
    q_1, q_2, q_3 = (_allowed(arm, X, period_s, 512) for X in X_BG)
    if not len(q_1) or not len(q_2) or not len(q_3):
        return np.inf
    speed = arm.plant.velocity_limits * period_s
    bend = arm.acceleration_limits * period_s**2
    near = cKDTree(q_1 / speed).query_ball_tree(cKDTree(q_2 / speed), 1.0, p=np.inf)
    onward = [2.0 * q_2[j] - q_1[i][None] for i, j in enumerate(near) if j]
    if not onward:
        return np.inf
    distance, _ = cKDTree(q_3 / bend).query(np.concatenate(onward) / bend, p=np.inf, distance_upper_bound=2.0)
    return float(distance.min())


def all_postures(plant: ArmPlant, X_BG: Array, q7: Array) -> Array:
    """Return joint angles (N, 8, 7) [rad] that reach a pose (4, 4) [m] with joint 7 at `q7` (N,) [rad], limits ignored.

    NaN where there is no solution. Every angle lies within pi of the middle of its joint's range.

    The arm is in modified Denavit-Hartenberg parameters as its maker documents them (Franka Control Interface
    documentation, "Robot and interface specifications"). Joint 7 determines frame 6, in which the shoulder is
    expressed; two equations of the form A cos x + B sin x = C give joints 4 and 6, joint 5 follows, and joints 1 to 3
    are the z-y-z Euler angles of the remaining rotation. The audit solves the same problem in another way, so that
    neither hides the other's errors.
    """
    R_06 = X_BG[:3, :3] @ _about_z(-q7 - _HAND_YAW) @ _about_x(-np.pi / 2)
    wrist = X_BG[:3, 3] - FLANGE_M * X_BG[:3, 2] - OFFSET_M * R_06[:, :, 0]
    to_shoulder = np.array([0.0, 0.0, SHOULDER_M]) - wrist
    x, y, z = np.moveaxis(np.einsum("nji,nj->ni", R_06, to_shoulder), -1, 0)[:, :, None, None]
    sign = np.array([1.0, -1.0])
    with np.errstate(invalid="ignore", divide="ignore"):
        # Joint 4: distance of shoulder and wrist.
        P = 2.0 * (_D3 * _D5 - _A4**2)
        Q = -2.0 * _A4 * (_D3 + _D5)
        C = np.sum(to_shoulder**2, axis=-1)[:, None, None] - (2.0 * _A4**2 + _D3**2 + _D5**2)
        q4 = np.arctan2(Q, P) + sign[:, None] * np.arccos(C / np.hypot(P, Q))  # (n, 2, 1)
        s4_x = _A4 - _A4 * np.cos(q4) - _D3 * np.sin(q4)
        s4_y = _A4 * np.sin(q4) - _D3 * np.cos(q4) - _D5
        # Joint 6: the shoulder's coordinate along joint 5's axis is equal in frames 4 and 5.
        arc = np.arcsin(s4_y / np.hypot(x, y))
        q6 = np.where(sign > 0, arc, np.pi - arc) - np.arctan2(y, x)  # (n, 2, 2)
        # Joint 5: its coordinates across that axis.
        q5 = np.arctan2(z / s4_x, (np.cos(q6) * x - np.sin(q6) * y) / s4_x)
    q4 = np.broadcast_to(q4, q6.shape)
    solved = np.isfinite(q5) & np.isfinite(q6)
    q4, q5, q6 = (np.where(solved, q, 0.0) for q in (q4, q5, q6))
    R_36 = _about_x(np.pi / 2) @ _about_z(q4) @ _about_x(-np.pi / 2) @ _about_z(q5) @ _about_x(np.pi / 2) @ _about_z(q6)
    R = R_06[:, None, None] @ np.swapaxes(R_36, -1, -2)
    q = np.full((len(q7), 2, 2, 2, 7), np.nan)
    for i, s in enumerate(sign):
        q[:, :, :, i, 0] = np.arctan2(s * R[..., 1, 2], s * R[..., 0, 2])
        q[:, :, :, i, 1] = s * np.arctan2(np.hypot(R[..., 0, 2], R[..., 1, 2]), R[..., 2, 2])
        q[:, :, :, i, 2] = np.arctan2(s * R[..., 2, 1], -s * R[..., 2, 0])
        for joint, angle in ((3, q4), (4, q5), (5, q6)):
            q[:, :, :, i, joint] = angle
    q[..., 6] = q7[:, None, None, None]
    q[~solved] = np.nan
    middle = 0.5 * (plant.lower + plant.upper)
    q = (q - middle + np.pi) % (2.0 * np.pi) - np.pi + middle
    return np.asarray(q.reshape(len(q7), 8, 7))


def _about_x(angle: float) -> Array:
    # quarter turns
    c = round(np.cos(angle))
    s = round(np.sin(angle))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_z(angle: Array) -> Array:
    c = np.cos(angle)
    s = np.sin(angle)
    R = np.zeros((*np.shape(angle), 3, 3))
    R[..., 0, 0] = c
    R[..., 0, 1] = -s
    R[..., 1, 0] = s
    R[..., 1, 1] = c
    R[..., 2, 2] = 1.0
    return R
