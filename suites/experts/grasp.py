"""Gripper orientations and object poses that the experts share. All poses are in the robot base frame B."""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose, rotation_exp

OPEN_M = 0.08
"""Fingers wide open."""
CLOSED_M = 0.0
"""Fingers shut on nothing."""
SQUEEZE_M = -0.02
"""Fingers told to close past shut: they press on what is between them with their full stiffness."""
TIP_M = 0.0095
"""How far the fingertips reach below the TCP."""
HALF_TIP_M = 0.0088
"""Half the thickness of the fingertips, across the way they close."""
BACK_M = 0.0165
"""From the TCP to the back of a closed finger, along the way they close."""
DOWN = (0.0, 0.0, -1.0)
"""Approach direction from above."""


def grasp_rotation(approach: ArrayLike, closing: ArrayLike) -> Array:
    """Rotation (3, 3) of panda_hand_tcp that looks along `approach` (3,), fingers closing along `closing` (3,)."""
    z = np.asarray(approach, dtype=np.float64)
    y = np.asarray(closing, dtype=np.float64)
    z = z / np.linalg.norm(z)
    y = y - (y @ z) * z
    y = y / np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=1)


def level_axes(R: ArrayLike) -> Array:
    """The four level directions (4, 3) across the faces of a box with rotation `R` (3, 3) that lies flat."""
    R = np.asarray(R, dtype=np.float64)
    level = R[:, np.argsort(np.abs(R[2]))[:2]].T
    level = level * [1.0, 1.0, 0.0]
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    return np.concatenate([level, -level])


def nearest_axis(axes: ArrayLike, wanted: ArrayLike) -> Array:
    """The row of `axes` (N, 3) that points most along `wanted` (3,)."""
    axes = np.asarray(axes, dtype=np.float64)
    return np.asarray(axes[np.argmax(axes @ np.asarray(wanted, dtype=np.float64))])


def raised(X: ArrayLike, height_m: float) -> Array:
    """The pose (4, 4) moved up by `height_m` along B's z."""
    X = np.array(X, dtype=np.float64)
    X[2, 3] += height_m
    return X


def shifted(X: ArrayLike, offset_m: ArrayLike) -> Array:
    """The pose (4, 4) moved by `offset_m` (3,) in B."""
    X = np.array(X, dtype=np.float64)
    X[:3, 3] += np.asarray(offset_m)
    return X


def swung(X: ArrayLike, point: ArrayLike, axis: ArrayLike, angle_rad: float) -> Array:
    """The pose (4, 4) turned by an angle about the line through `point` (3,) along `axis` (3,), as a lid carries it."""
    X, p = np.asarray(X, dtype=np.float64), np.asarray(point, dtype=np.float64)
    R = rotation_exp(angle_rad * np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis))
    return make_pose(R @ X[:3, :3], p + R @ (X[:3, 3] - p))
