"""Manipulability: volume and condition number of the velocity ellipsoid of the TCP."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.segments import spread

COST_OFFSET = 1e-6
"""Offset of the manipulability in PyRoki's cost, which is then at most 1e6."""


def cost(w_translation: Array) -> Array:
    """Return PyRoki's manipulability cost 1 / (w + 1e-6) (...,) of translational manipulabilities; lower is better.

    Source: `manipulability_residual` of PyRoki (C. M. Kim et al., "PyRoki: A Modular Toolkit for Robot Kinematic
    Optimization", 2025), with w of the translational 3xJ Jacobian.
    """
    return np.asarray(1.0 / (w_translation + COST_OFFSET))


def limit_weight(q: Array, lower: Array, upper: Array) -> Array:
    """Return a factor (..., n) in 0..1 per joint at `q` (..., n) [rad]: 1 mid-range, 0 at either limit and past it.

    p = 1 / sqrt(1 + |dH/dq|) with dH/dq = (upper - lower)^2 (2 q - upper - lower) / (4 (upper - q)^2 (q - lower)^2);
    here sqrt(d / (d + n)) with dH/dq = n / d. Sources: H of T. F. Chan and R. V. Dubey, "A Weighted Least-Norm Solution
    Based Scheme for Avoiding Joint Limits for Redundant Joint Manipulators", IEEE Trans. Robotics and Automation 11(2),
    1995; p of N. Vahrenkamp and T. Asfour, "Representing the robot's workspace through constrained manipulability
    analysis", Autonomous Robots 38, 2015.
    """
    n = (upper - lower) ** 2 * np.abs(2.0 * q - upper - lower)
    d = 4.0 * (upper - q) ** 2 * (q - lower) ** 2
    inside = (q > lower) & (q < upper)
    return np.sqrt(np.divide(d, d + n, out=np.where(np.isnan(q), np.nan, np.zeros_like(d)), where=inside))


def characteristic_length(plant: ArmPlant) -> float:
    """Return the length [m] that scales metres to radians: root mean square distance of the TCP from the joint axes.

    At the rest posture (0.48 m for the Panda). Source: J. Angeles' characteristic length as described in L. Stocco, S.
    E. Salcudean and F. Sassani, "Matrix Normalization for Optimal Robot Design", ICRA 1998.
    """
    return float(np.sqrt(np.mean(np.sum(plant.jacobian(plant.robot.rest_q)[3:] ** 2, axis=0))))


@dataclass(frozen=True, slots=True, kw_only=True)
class Manipulability:
    """Manipulability of the TCP along a joint path, of Jacobians expressed in B; NaN where q is NaN.

    w = sqrt(det(J J^T)), the product of the singular values of J (T. Yoshikawa, "Manipulability of Robotic Mechanisms",
    Int. J. Robotics Research 4(2), 1985, eq. (6)). The condition number, greatest over least singular value, is 1 where
    every direction of motion needs the same joint speed, and infinite at a singular posture (J. K. Salisbury and J. J.
    Craig, "Articulated Hands: Force Control and Kinematic Issues", Int. J. Robotics Research 1(1), 1982).
    """

    full: Array
    """(T,) w of the full 6xJ Jacobian in radians and metres [m^3 rad^3 / rad^6]."""
    translation: Array
    """(T,) w of the three rows of linear velocity [m^3 / rad^3]."""
    rotation: Array
    """(T,) w of the three rows of angular velocity, dimensionless."""
    limited: Array
    """(T,) `full` times the joints' `limit_weight`: 0 with any joint at its limit."""
    cost: Array
    """(T,) PyRoki's cost of `translation`."""
    condition: Array
    """(T,) condition number of the full Jacobian, its linear rows divided by `characteristic_length`."""


def compute_manipulability(plant: ArmPlant, q: ArrayLike, J: ArrayLike | None = None) -> Manipulability:
    """Compute the manipulability at each row of `q` (T, J) [rad], NaN where unknown.

    `J` (T, 6, J) are its Jacobians (`LinkChain.jacobians`), computed if None. `limited`: scaling the columns of a
    square J by the limit weights multiplies w by their product, which is used here too.

    Raises:
        UsageError: the shapes do not fit.
    """
    J = np.asarray(plant.chain.jacobians(q) if J is None else J, dtype=np.float64)
    q = np.asarray(q, dtype=np.float64)
    n = plant.chain.n_joints
    if q.ndim != 2 or q.shape[1] != n or J.shape != (len(q), 6, n):
        raise UsageError(f"J has shape {J.shape} and q {q.shape}, expected (T, 6, {n}) and (T, {n})")
    finite = np.isfinite(q).all(axis=-1) & np.isfinite(J).all(axis=(1, 2))
    J_finite = J[finite]
    scale = np.repeat([1.0, 1.0 / characteristic_length(plant)], 3)[:, None]
    parts = (scale * J_finite, J_finite[:, :3], J_finite[:, 3:])
    full, rotation, linear = (np.linalg.svd(part, compute_uv=False) for part in parts)  # greatest first
    if n < 6:  # no determinant that the scale would factor out of
        w = np.prod(np.linalg.svd(J_finite, compute_uv=False), axis=-1)
    else:
        w = np.prod(full, axis=-1) / scale[3:].prod()
    w_linear = np.prod(linear, axis=-1)
    values = {
        "full": w,
        "translation": w_linear,
        "rotation": np.prod(rotation, axis=-1),
        "limited": w * limit_weight(q[finite], plant.lower, plant.upper).prod(axis=-1),
        "cost": cost(w_linear),
        "condition": np.divide(full[:, 0], full[:, -1], out=np.full(len(full), np.inf), where=full[:, -1] > 0.0),
    }
    return Manipulability(**{name: spread(value, finite, len(q)) for name, value in values.items()})


def time_integral(t_s: Array, values: Array) -> float | None:
    """Integrate `values` (T,) over `t_s` (T,) [s] by the trapezoid rule, in the values' unit times seconds.

    NaN values are left out and interpolated linearly; None if fewer than two values are finite.
    """
    finite = np.isfinite(values)
    return float(np.trapezoid(values[finite], t_s[finite])) if int(finite.sum()) > 1 else None
