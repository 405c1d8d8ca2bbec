"""Random motions of the arm."""

import numpy as np
from scipy.interpolate import CubicSpline

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import rest_q


def random_path(n: int, seed: int = 0) -> Array:
    """Joint angles (n, 7) along a spline through four postures near the rest posture."""
    rng = np.random.default_rng(seed)
    knots = rest_q() + rng.uniform(-0.4, 0.4, size=(4, 7))
    return np.asarray(CubicSpline(np.linspace(0, 1, 4), knots)(np.linspace(0, 1, n)))


def poses_of(plant: ArmPlant, q: Array) -> Array:
    return np.array([plant.forward(row) for row in q])
