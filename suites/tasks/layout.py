"""Helpers to lay out scenes in the robot base frame."""

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.tasks.state import State


def turned(yaw_rad: float) -> Array:
    """Rotation (3, 3) about z."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def resting(x_m: float, y_m: float, z_m: float, yaw_rad: float = 0.0) -> Array:
    """Pose (4, 4) of something upright at a point of B, turned about z."""
    return make_pose(turned(yaw_rad), [x_m, y_m, z_m])


def scattered(rng: np.random.Generator, count: int, low: ArrayLike, high: ArrayLike, apart_m: float) -> Array:
    """Points (count, 2) in a rectangle, all at least `apart_m` apart: drawn anew until they are.

    The distance asked for gives way a little with each try, so that it always ends.
    """
    low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    while True:
        for _ in range(200):
            points = rng.uniform(low, high, size=(count, 2))
            gaps = np.linalg.norm(points[:, None] - points, axis=-1) + np.diag(np.full(count, np.inf))
            if gaps.min() >= apart_m:
                return points
        apart_m *= 0.95


UPRIGHT_RAD = np.deg2rad(10.0)
"""How far an obstacle's own z axis may lean from the vertical."""
MOVED_M = 0.02
"""How far an obstacle may be from where it stood, sideways."""


def undisturbed(state: State, name: str) -> dict[str, Tensor]:
    """Whether (N,) the thing of a name still stands (`NAME_upright`), and where it stood (`NAME_in_place`)."""
    way = state.position(name)[:, :2] - state.starts[name][:, :2, 3]
    return {
        f"{name}_upright": state.poses[name][:, 2, 2] >= float(np.cos(UPRIGHT_RAD)),
        f"{name}_in_place": torch.linalg.norm(way, dim=-1) <= MOVED_M,
    }
