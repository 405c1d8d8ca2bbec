"""Local inverse kinematics: from a starting posture to a near one that reaches a pose, within joint limits."""

import numpy as np

from kinebench_drake.geometry import Array, rotation_log
from kinebench_drake.kinematics.plant import ArmPlant

ROTATION_ARM_M = 0.1
"""Length that weighs rotation error against position error [m/rad]: 10 mm weigh as much as 5.7 degrees."""

REACHED_M = 1e-10
"""Weighted error [m] below which the pose counts as reached and the iteration ends."""
ROWS_STEPS = 25
"""Greatest number of steps from a posture far from the pose."""
SLOW_GAIN = 1e-4
"""Relative gain below which a step counts as slow; three slow steps end the iteration."""

# Newton steps for a whole path
_PATH_STEPS = 6
_PATH_STEP_RAD = 0.5
_PATH_DAMPING = 1e-6
_ROWS_STEP_RAD = 0.7
_LEAST_DAMPING = 1e-12
_LEAST_SIN = 1e-9
_LEAST_TURN = 1e-6  # angular part of a left null vector below which there is no axis
_ROWS_DAMPING = 1e-4  # far from the pose, relative to the square of the error [m]


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


def _errors(X_BG: Array, X_now: Array) -> Array:
    """Return `_error` of rows (n, 4, 4), less exact near half a turn: several times as fast as `pose_twists`."""
    R = X_BG[:, :3, :3] @ np.swapaxes(X_now[:, :3, :3], -1, -2)
    e = np.empty((len(R), 6))
    e[:, 0] = R[:, 2, 1] - R[:, 1, 2]
    e[:, 1] = R[:, 0, 2] - R[:, 2, 0]
    e[:, 2] = R[:, 1, 0] - R[:, 0, 1]
    sin = 0.5 * np.sqrt((e[:, :3] * e[:, :3]).sum(axis=-1))
    angle = np.arctan2(sin, 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0))
    e[:, :3] *= np.where(sin > _LEAST_SIN, 0.5 * angle / np.maximum(sin, _LEAST_SIN), 0.5)[:, None]
    e[:, 3:] = X_BG[:, :3, 3] - X_now[:, :3, 3]
    return e


def followed_error(J: Array, e: Array) -> tuple[Array, Array]:
    """Return the errors (..., 6) that an arm has to remove, and those that its joints are moved by.

    With six joints and more both are the errors `e` (..., 6) themselves. Five joints reach a position and the
    direction of one axis: their Jacobian (6, 5) leaves out the motion along its left null vector, whose angular part is
    that axis.
    The turn about it does not count, and is the one that comes with the rest of the motion.
    """
    if J.shape[-1] > 5:
        return e, e
    missing = np.linalg.svd(J)[0][..., -1]
    turn = missing[..., :3] / np.maximum(np.linalg.norm(missing[..., :3], axis=-1, keepdims=True), _LEAST_TURN)
    counted = e.copy()
    counted[..., :3] -= turn * (turn * e[..., :3]).sum(axis=-1, keepdims=True)
    moved = counted.copy()
    share = np.maximum(np.linalg.norm(missing[..., :3], axis=-1, keepdims=True), _LEAST_TURN)
    moved[..., :3] -= turn * (missing[..., 3:] * e[..., 3:]).sum(axis=-1, keepdims=True) / share
    return counted, moved


def _step(J: Array, e: Array, damping: float, below: Array, above: Array) -> Array:
    """Return the least damped change (J,) of the joints that removes `e`, within the bounds `below`, `above` (J,).

    A joint that would pass its bound is set to it; the other joints correct the remaining error.
    """
    dq = np.zeros(J.shape[1])
    free = np.ones(J.shape[1], dtype=bool)
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
        q: starting posture (J,) [rad]; clipped to the limits when `bounded`.
        bounded: True to keep joint limits.
        iterations: greatest number of Jacobians to compute.

    Returns:
        The best posture (J,) [rad] and its weighted error [m].
    """
    lower, upper = (plant.lower, plant.upper) if bounded else (np.full(len(q), -np.inf), np.full(len(q), np.inf))
    weight = np.array([ROTATION_ARM_M] * 3 + [1.0] * 3)
    q = np.clip(q, lower, upper)
    X_now, J = plant.forward_and_jacobian(q)
    counted, e = followed_error(weight[:, None] * J, weight * _error(X_BG, X_now))
    cost = float(counted @ counted)
    damping = 1e-8
    slow = 0
    for _ in range(iterations):
        if cost < REACHED_M**2:
            break
        step = _step(weight[:, None] * J, e, damping, lower - q, upper - q)
        size = float(np.abs(step).max())
        q_new = np.clip(q + step * min(1.0, 0.7 / max(size, 1e-12)), lower, upper)
        X_new, J_new = plant.forward_and_jacobian(q_new)
        counted, e_new = followed_error(weight[:, None] * J_new, weight * _error(X_BG, X_new))
        cost_new = float(counted @ counted)
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


def solve_newton_rows(
    plant: ArmPlant, X_BG: Array, q: Array, *, bounded: bool = False, iterations: int = ROWS_STEPS
) -> Array:
    """Solve poses `X_BG` (n, 4, 4), each from a posture of `q` (n, J) [rad]: (n, J), NaN where steps do not converge.

    Newton steps for all rows at once, damped by the error (N. Yamashita and M. Fukushima, "On the rate of convergence
    of the Levenberg-Marquardt method", Computing Supplement 15, 2001); `bounded` clips postures to the limits.
    """
    q = q.copy()
    solved = np.full_like(q, np.nan)
    rows = np.flatnonzero(np.isfinite(q).all(axis=-1))
    weight = np.repeat([ROTATION_ARM_M, 1.0], 3)
    for _ in range(iterations):
        X_now, J = plant.chain.poses_and_jacobians(q[rows])
        counted, e = followed_error(weight[:, None] * J, weight * _errors(X_BG[rows], X_now))
        square = (counted * counted).sum(axis=-1)
        reached = square < REACHED_M**2
        solved[rows[reached]] = q[rows[reached]]
        rows = rows[~reached]
        if not len(rows):
            break
        A = weight[:, None] * J[~reached]
        A_T = np.swapaxes(A, -1, -2)
        damping = (_ROWS_DAMPING * square[~reached] + _LEAST_DAMPING)[:, None, None] * np.eye(6)
        step = (A_T @ np.linalg.solve(A @ A_T + damping, e[~reached][..., None]))[..., 0]
        q[rows] += step * np.minimum(1.0, _ROWS_STEP_RAD / np.abs(step).max(axis=-1, initial=1e-12, keepdims=True))
        if bounded:
            q[rows] = np.clip(q[rows], plant.lower, plant.upper)
    return solved


def solve_newton_path(plant: ArmPlant, X_BG: Array, q: Array) -> Array:
    """Solve poses `X_BG` (n, 4, 4) from the postures of a path `q` (n, J) [rad], limits ignored; NaN rows stay NaN.

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
    """Return damped pseudo-inverses (n, J, 6) of Jacobians (n, 6, J)."""
    J_T = np.swapaxes(J, -1, -2)
    return np.asarray(J_T @ np.linalg.inv(J @ J_T + _PATH_DAMPING * np.eye(6)))


def pose_twists(X_from: Array, X_to: Array) -> Array:
    """Return the twists (n, 6) [rad; m] from poses to poses (n, 4, 4), expressed in B, angular part first."""
    turn = rotation_log(X_to[:, :3, :3] @ np.swapaxes(X_from[:, :3, :3], -1, -2))
    return np.concatenate([turn, X_to[:, :3, 3] - X_from[:, :3, 3]], axis=-1)
