"""Manipulability: volume of the velocity ellipsoid of the TCP."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Manipulability:
    """Manipulability of the TCP along a joint path, of Jacobians expressed in B; NaN where q is NaN.

    w = sqrt(det(J J^T)), the product of the singular values of J (T. Yoshikawa, "Manipulability of Robotic Mechanisms",
    Int. J. Robotics Research 4(2), 1985, eq. (6)).
    """

    full: Array
    """(T,) w of the full 6xJ Jacobian in radians and metres [m^3 rad^3 / rad^6]."""
    translation: Array
    """(T,) w of the three rows of linear velocity [m^3 / rad^3]."""
    cost: Array
    """(T,) PyRoki's cost of `translation`."""


def compute_manipulability(plant: ArmPlant, q: ArrayLike, J: ArrayLike | None = None) -> Manipulability:
    """Compute the manipulability at each row of `q` (T, J) [rad], NaN where unknown.

    `J` (T, 6, J) are its Jacobians (`LinkChain.jacobians`), computed if None.

    Raises:
        UsageError: the shapes do not fit.
    """
    J = np.asarray(plant.chain.jacobians(q) if J is None else J, dtype=np.float64)
    q = np.asarray(q, dtype=np.float64)
    n = plant.chain.n_joints
    if q.ndim != 2 or q.shape[1] != n or J.shape != (len(q), 6, n):
        raise UsageError(f"J has shape {J.shape} and q {q.shape}, expected (T, 6, {n}) and (T, {n})")
    finite = np.isfinite(q).all(axis=-1) & np.isfinite(J).all(axis=(1, 2))
    full, translation = (np.prod(np.linalg.svd(part, compute_uv=False), axis=-1) for part in (J[finite], J[finite, 3:]))
    values = {"full": full, "translation": translation, "cost": cost(translation)}
    return Manipulability(**{name: spread(value, finite, len(q)) for name, value in values.items()})


def time_integral(t_s: Array, values: Array) -> float | None:
    """Integrate `values` (T,) over `t_s` (T,) [s] by the trapezoid rule, in the values' unit times seconds.

    NaN values are left out and interpolated linearly; None if fewer than two values are finite.
    """
    finite = np.isfinite(values)
    return float(np.trapezoid(values[finite], t_s[finite])) if int(finite.sum()) > 1 else None
