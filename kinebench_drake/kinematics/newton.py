"""Local inverse kinematics: from a starting posture to a near one that reaches a pose, within joint limits."""

import numpy as np

from kinebench_drake.geometry import Array, rotation_log
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.robot import N_JOINTS

ROTATION_ARM_M = 0.1
"""Length that weighs rotation error against position error [m/rad]: 10 mm weigh as much as 5.7 degrees."""

REACHED_M = 1e-10
"""Weighted error [m] below which the pose counts as reached and the iteration ends."""
SLOW_GAIN = 1e-4
"""Relative gain below which a step counts as slow; three slow steps end the iteration."""

# Newton steps for a whole path
_PATH_STEPS = 6
_PATH_STEP_RAD = 0.5
_PATH_DAMPING = 1e-6


def _error(X_BG: Array, X_now: Array) -> Array:
    """Return the twist (6,) [rad; m] from `X_now` to `X_BG`, expressed in B."""
    R = X_BG[:3, :3] @ X_now[:3, :3].T
    twice_sin = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    cos = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    e = np.empty(6)
    e[3:] = X_BG[:3, 3] - X_now[:3, 3]
    if cos > -0.9:
        sin = 0.5 * float(np.sqrt(twice_sin @ twice_sin))
        e[:3] = twice_sin * (0.5 if sin < 1e-9 else 0.5 * np.arctan2(sin, cos) / sin)
    else:  # near half a turn the formula above loses the axis to rounding
        e[:3] = rotation_log(R)
    return e


def _step(J: Array, e: Array, damping: float, below: Array, above: Array) -> Array:
    """Return the least damped change (7,) of the joints that removes `e`, within the bounds `below`, `above` (7,).

    A joint that would pass its bound is set to it; the other joints correct the remaining error.
    """
    dq = np.zeros(N_JOINTS)
    free = np.ones(N_JOINTS, dtype=bool)
    while free.any():
        A = J[:, free]
        M = A @ A.T
        M.flat[::7] += damping
        dq[free] = A.T @ np.linalg.solve(M, e)
        past = free & ((dq < below) | (dq > above))
        if not past.any():
            return dq
        dq[past] = np.clip(dq[past], below[past], above[past])
        e = e - J[:, past] @ dq[past]
        free &= ~past
    return dq


def solve_newton(
    plant: ArmPlant, X_BG: Array, q: Array, *, bounded: bool = True, iterations: int = 40
) -> tuple[Array, float]:
    """Solve a pose by damped Newton (Levenberg-Marquardt) steps on Drake's Jacobian, with an active set of limits.

    Minimises |dp|^2 + (ROTATION_ARM_M |dtheta|)^2. Each step is the joint change of least norm, so that the result
    stays near the start (damped pseudo-inverse: Y. Nakamura and H. Hanafusa, "Inverse Kinematic Solutions With
    Singularity Robustness for Robot Manipulator Control", J. Dyn. Syst. Meas. Control 108, 1986).

    Args:
        plant: the robot.
        X_BG: wanted pose (4, 4) of the TCP in the base [m].
        q: starting posture (7,) [rad]; clipped to the limits when `bounded`.
        bounded: True to keep joint limits.
        iterations: greatest number of Jacobians to compute.

    Returns:
        The best posture (7,) [rad] and its weighted error [m].
    """
    lower, upper = (plant.lower, plant.upper) if bounded else (np.full(N_JOINTS, -np.inf), np.full(N_JOINTS, np.inf))
    weight = np.array([ROTATION_ARM_M] * 3 + [1.0] * 3)
    q = np.clip(q, lower, upper)
    X_now, J = plant.forward_and_jacobian(q)
    e = weight * _error(X_BG, X_now)
    cost = float(e @ e)
    damping = 1e-8
    slow = 0
    for _ in range(iterations):
        if cost < REACHED_M**2:
            break
        step = _step(weight[:, None] * J, e, damping, lower - q, upper - q)
        size = float(np.abs(step).max())
        q_new = np.clip(q + step * min(1.0, 0.7 / max(size, 1e-12)), lower, upper)
        X_new, J_new = plant.forward_and_jacobian(q_new)
        e_new = weight * _error(X_BG, X_new)
        cost_new = float(e_new @ e_new)
        if cost_new < cost:
            slow = slow + 1 if cost_new > (1.0 - SLOW_GAIN) * cost else 0
            q = q_new
            J = J_new
            e = e_new
            cost = cost_new
            damping = max(damping * 0.1, 1e-12)
        else:
            slow += damping > 1.0
            damping = max(damping * 30.0, 1e-6)
        if slow >= 3:
            break
    return q, float(np.sqrt(cost))


def solve_newton_path(plant: ArmPlant, X_BG: Array, q: Array) -> Array:
    """Solve poses `X_BG` (n, 4, 4) from the postures of a path `q` (n, 7) [rad], limits ignored; NaN rows stay NaN.

    Newton steps of least joint motion for all frames at once. Frames that do not converge keep the last step's posture.
    """
    q = q.copy()
    rows = np.flatnonzero(np.isfinite(q).all(axis=-1))
    for _ in range(_PATH_STEPS if len(rows) else 0):
        X_now, J = plant.chain.poses_and_jacobians(q[rows])
        error = pose_twists(X_now, X_BG[rows])
        if np.abs(error).max() < REACHED_M:
            break
        step = (damped_pseudoinverses(J) @ error[..., None])[..., 0]
        q[rows] += np.clip(step, -_PATH_STEP_RAD, _PATH_STEP_RAD)
    return q


def damped_pseudoinverses(J: Array) -> Array:
    """Return damped pseudo-inverses (n, 7, 6) of Jacobians (n, 6, 7)."""
    J_T = np.swapaxes(J, -1, -2)
    return np.asarray(J_T @ np.linalg.inv(J @ J_T + _PATH_DAMPING * np.eye(6)))


def pose_twists(X_from: Array, X_to: Array) -> Array:
    """Return the twists (n, 6) [rad; m] from poses to poses (n, 4, 4), expressed in B, angular part first."""
    turn = rotation_log(X_to[:, :3, :3] @ np.swapaxes(X_from[:, :3, :3], -1, -2))
    return np.concatenate([turn, X_to[:, :3, 3] - X_from[:, :3, 3]], axis=-1)
