"""How freely the gripper can move at a posture: volume and roundness of its velocity ellipsoid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.robot import N_JOINTS

COST_OFFSET = 1e-6
"""Added to the manipulability in PyRoki's cost, which is then at most 1e6."""


def yoshikawa(J: ArrayLike) -> Array:
    """Manipulability w = sqrt(det(J J^T)) (...,) of Jacobians `J` (..., m, n), m <= n: 0 at a singular posture.

    Source: T. Yoshikawa, "Manipulability of Robotic Mechanisms", Int. J. Robotics Research 4(2), 1985, eq. (6). It is
    the product of the singular values of J, and computed so; its value depends on the units of J's rows and on nothing
    else.
    """
    return np.asarray(np.prod(_stretches(J), axis=-1))


def condition_number(J: ArrayLike) -> Array:
    """Greatest over least singular value (...,) of Jacobians `J` (..., m, n), m <= n.

    It is 1 where every direction of motion costs the same joint speed, and infinite at a singular posture. It means
    something only if the rows of J share one unit. Source: J. K. Salisbury and J. J. Craig, "Articulated Hands: Force
    Control and Kinematic Issues", Int. J. Robotics Research 1(1), 1982.
    """
    return _ratio(_stretches(J))


def cost(w_translation: ArrayLike) -> Array:
    """PyRoki's manipulability cost 1 / (w + 1e-6) (...,) of translational manipulabilities; lower is better.

    Source: `manipulability_residual` of PyRoki (C. M. Kim et al., "PyRoki: A Modular Toolkit for Robot Kinematic
    Optimization", 2025), with w of the translational 3x7 Jacobian.
    """
    return np.asarray(1.0 / (np.asarray(w_translation, dtype=np.float64) + COST_OFFSET))


def limit_weight(q: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> Array:
    """Factor (..., n) in 0..1 of each joint at `q` (..., n) [rad]: 1 mid-way, 0 at either limit and past it.

    p = 1 / sqrt(1 + |dH/dq|) with dH/dq = (upper - lower)^2 (2 q - upper - lower) / (4 (upper - q)^2 (q - lower)^2), q
    in radians. Sources: H of T. F. Chan and R. V. Dubey, "A Weighted Least-Norm Solution Based Scheme for Avoiding
    Joint Limits for Redundant Joint Manipulators", IEEE Trans. Robotics and Automation 11(2), 1995; p of N. Vahrenkamp
    and T. Asfour, "Representing the robot's workspace through constrained manipulability analysis", Autonomous Robots
    38, 2015. Written as sqrt(d / (d + n)) with dH/dq = n / d, so that nothing is divided by 0 at a limit.
    """
    q, lower, upper = (np.asarray(a, dtype=np.float64) for a in (q, lower, upper))
    n = (upper - lower) ** 2 * np.abs(2.0 * q - upper - lower)
    d = 4.0 * (upper - q) ** 2 * (q - lower) ** 2
    inside = (q > lower) & (q < upper)
    return np.sqrt(np.divide(d, d + n, out=np.where(np.isnan(q), np.nan, np.zeros_like(d)), where=inside))


def characteristic_length(plant: ArmPlant) -> float:
    """Length [m] that turns metres into radians: root mean square distance of the TCP from the seven joint axes.

    Taken at the robot's rest posture (0.48 m for the Panda), so that it is one number for all postures. Dividing the
    linear rows of J by it makes them of the angular rows' unit and, there, of the same mean size. Sources: J. Angeles'
    characteristic length as described in L. Stocco, S. E. Salcudean and F. Sassani, "Matrix Normalization for Optimal
    Robot Design", ICRA 1998.
    """
    J = plant.jacobian(plant.robot.rest_q)
    return float(np.sqrt(np.mean(np.sum(J[3:] ** 2, axis=0))))


@dataclass(frozen=True, slots=True, kw_only=True)
class Manipulability:
    """Manipulability of the TCP along a joint path, of Jacobians expressed in B; NaN where q is NaN."""

    full: Array
    """(T,) w of the whole 6x7 Jacobian, radians and metres mixed as they are [m^3 rad^3 / rad^6]."""
    translation: Array
    """(T,) w of its three rows of linear velocity [m^3 / rad^3]."""
    rotation: Array
    """(T,) w of its three rows of angular velocity, without unit."""
    limited: Array
    """(T,) `full` times the seven joints' `limit_weight`: 0 with any joint at its limit."""
    cost: Array
    """(T,) PyRoki's cost of `translation`."""
    condition: Array
    """(T,) condition number of the whole Jacobian, its linear rows divided by `characteristic_length`."""
    condition_translation: Array
    """(T,) condition number of the linear rows."""
    condition_rotation: Array
    """(T,) condition number of the angular rows."""


def manipulability(plant: ArmPlant, q: ArrayLike) -> Manipulability:
    """Manipulability at each row of `q` (T, 7) [rad].

    Raises:
        UsageError: `q` is not (T, 7).
    """
    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != N_JOINTS:
        raise UsageError(f"q has shape {q.shape}, expected (T, {N_JOINTS})")
    return manipulability_of(plant, plant.chain.jacobians(q), q)


def manipulability_of(plant: ArmPlant, J: ArrayLike, q: ArrayLike) -> Manipulability:
    """The same from Jacobians `J` (T, 6, 7) of `q` (T, 7) [rad] that are at hand already (`LinkChain.jacobians`).

    `limited`: scaling the columns of a square J by the limit weights multiplies w by their product. The product is
    taken here too, though a redundant arm with one joint at its limit may still move the TCP every way.

    Raises:
        UsageError: the shapes do not fit.
    """
    J, q = np.asarray(J, dtype=np.float64), np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != N_JOINTS or J.shape != (len(q), 6, N_JOINTS):
        raise UsageError(f"J has shape {J.shape} and q {q.shape}, expected (T, 6, {N_JOINTS}) and (T, {N_JOINTS})")
    known = np.isfinite(q).all(axis=-1) & np.isfinite(J).all(axis=(1, 2))
    J_known = J[known]
    scale = np.repeat([1.0, 1.0 / characteristic_length(plant)], 3)[:, None]
    full, rotation, linear = (_stretches(part) for part in (scale * J_known, J_known[:, :3], J_known[:, 3:]))
    w = np.prod(full, axis=-1) / scale[3:].prod()
    w_linear = np.prod(linear, axis=-1)

    def spread(values: Array) -> Array:
        out = np.full(len(q), np.nan)
        out[known] = values
        return out

    return Manipulability(
        full=spread(w),
        translation=spread(w_linear),
        rotation=spread(np.prod(rotation, axis=-1)),
        limited=spread(w * limit_weight(q[known], plant.lower, plant.upper).prod(axis=-1)),
        cost=spread(cost(w_linear)),
        condition=spread(_ratio(full)),
        condition_translation=spread(_ratio(linear)),
        condition_rotation=spread(_ratio(rotation)),
    )


def time_integral(t_s: ArrayLike, values: ArrayLike) -> float | None:
    """Integral of `values` (T,) over `t_s` (T,) [s] by the trapezoid rule, in the values' unit times seconds.

    NaN values are left out and the gap is bridged by a straight line; None where fewer than two values are known.
    """
    t_s, values = np.asarray(t_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    known = np.isfinite(values)
    return float(np.trapezoid(values[known], t_s[known])) if int(known.sum()) > 1 else None


def _stretches(J: ArrayLike) -> Array:
    """Singular values (..., m) of `J` (..., m, n), greatest first."""
    return np.asarray(np.linalg.svd(np.asarray(J, dtype=np.float64), compute_uv=False))


def _ratio(stretches: Array) -> Array:
    greatest, least = stretches[..., 0], stretches[..., -1]
    return np.divide(greatest, least, out=np.full_like(greatest, np.inf), where=least > 0.0)
