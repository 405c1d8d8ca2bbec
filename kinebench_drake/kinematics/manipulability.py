"""How freely the gripper can move at a posture: the volume of its velocity ellipsoid."""

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
    the product of the singular values of J, so its value depends on the units of J's rows and on nothing else.
    """
    J = np.asarray(J, dtype=np.float64)
    return np.asarray(np.sqrt(np.maximum(np.linalg.det(J @ np.swapaxes(J, -1, -2)), 0.0)))


def cost(w_translation: ArrayLike) -> Array:
    """PyRoki's manipulability cost 1 / (w + 1e-6) (...,) of translational manipulabilities; lower is better.

    Source: `manipulability_residual` of PyRoki (C. M. Kim et al., "PyRoki: A Modular Toolkit for Robot Kinematic
    Optimization", 2025), with w of the translational 3x7 Jacobian.
    """
    return np.asarray(1.0 / (np.asarray(w_translation, dtype=np.float64) + COST_OFFSET))


@dataclass(frozen=True, slots=True, kw_only=True)
class Manipulability:
    """Manipulability of panda_hand_tcp along a joint path, of Jacobians expressed in B; NaN where q is NaN."""

    full: Array
    """(T,) w of the whole 6x7 Jacobian, radians and metres mixed as they are [m^3 rad^3 / rad^6]."""
    translation: Array
    """(T,) w of its three rows of linear velocity [m^3 / rad^3]."""
    cost: Array
    """(T,) PyRoki's cost of `translation`."""


def manipulability(plant: ArmPlant, q: ArrayLike) -> Manipulability:
    """Manipulability at each row of `q` (T, 7) [rad].

    Raises:
        UsageError: `q` is not (T, 7).
    """
    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != N_JOINTS:
        raise UsageError(f"q has shape {q.shape}, expected (T, {N_JOINTS})")
    known = np.isfinite(q).all(axis=-1)
    J = np.reshape([plant.jacobian(row) for row in q[known]], (-1, 6, N_JOINTS))
    full, translation = np.full(len(q), np.nan), np.full(len(q), np.nan)
    full[known], translation[known] = yoshikawa(J), yoshikawa(J[:, 3:])
    return Manipulability(full=full, translation=translation, cost=cost(translation))
