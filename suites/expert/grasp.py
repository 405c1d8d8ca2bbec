"""Gripper dimensions, grasp orientations and waypoint sequences shared by the experts; poses in the base frame B."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.suites.expert.motion import Arc, Waypoint
from kinebench_drake.track import MAX_WIDTH_M

OPEN_M = MAX_WIDTH_M
"""Finger width when fully open."""
SQUEEZE_M = -0.02
"""Commanded finger width past closed: the fingers press on what is between them with their full stiffness."""
TIP_M = 0.0095
"""Distance that the fingertips extend beyond the TCP."""
HALF_TIP_M = 0.0088
"""Half the thickness of the fingertips, perpendicular to the closing axis."""
BACK_M = 0.0165
"""Distance from the TCP to the back of a closed finger, along the closing axis."""
DOWN = (0.0, 0.0, -1.0)
"""Approach direction from above."""


def grasp_rotation(approach: ArrayLike, closing: ArrayLike) -> Array:
    """Return the rotation (3, 3) of panda_hand_tcp with its z along `approach` (3,), closing along `closing` (3,)."""
    z = np.asarray(approach, dtype=np.float64)
    y = np.asarray(closing, dtype=np.float64)
    z = z / np.linalg.norm(z)
    y = y - (y @ z) * z
    y = y / np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=1)


def level_axes(R: ArrayLike) -> Array:
    """Return the four horizontal face normals (4, 3) of a box with rotation `R` (3, 3) that lies flat."""
    R = np.asarray(R, dtype=np.float64)
    level = R[:, np.argsort(np.abs(R[2]))[:2]].T
    level = level * [1.0, 1.0, 0.0]
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    return np.concatenate([level, -level])


def nearest_axis(axes: ArrayLike, direction: ArrayLike) -> Array:
    """Return the row of `axes` (N, 3) closest to `direction` (3,)."""
    axes = np.asarray(axes, dtype=np.float64)
    return np.asarray(axes[np.argmax(axes @ np.asarray(direction, dtype=np.float64))])


def lift(X: ArrayLike, height_m: float) -> Array:
    """Return the pose (4, 4) moved up by `height_m` along B's z."""
    X = np.array(X, dtype=np.float64)
    X[2, 3] += height_m
    return X


def shift(X: ArrayLike, offset_m: ArrayLike) -> Array:
    """Return the pose (4, 4) moved by `offset_m` (3,) in B."""
    X = np.array(X, dtype=np.float64)
    X[:3, 3] += np.asarray(offset_m)
    return X


def swing(X: Array, arc: Arc) -> Array:
    """Return the pose (4, 4) rotated along an arc."""
    R = rotation_exp(arc.angle_rad * arc.axis / np.linalg.norm(arc.axis))
    return make_pose(R @ X[:3, :3], arc.point + R @ (X[:3, 3] - arc.point))


def closed_waypoint(X_BG: Array, *, through: bool = False, arc: Arc | None = None, pace: float = 1.0) -> Waypoint:
    """Return a waypoint with closed fingers; arguments as of `Waypoint`."""
    return Waypoint(X_BG=X_BG, finger_width_m=0.0, through=through, arc=arc, pace=pace)


def closed_passage(*poses: Array) -> list[Waypoint]:
    """Return waypoints with closed fingers at poses (4, 4) that are passed without stopping."""
    return [closed_waypoint(X_BG, through=True) for X_BG in poses]


def pick_and_place(
    above: Array,
    grasp: Array,
    via: Sequence[Array],
    place: Array,
    retreat: Array,
    *,
    open_m: float = OPEN_M,
    release_m: float = OPEN_M,
    then: Sequence[Waypoint] = (),
) -> list[Waypoint]:
    """Return the waypoints that grasp an object, carry it and release it.

    Args:
        above: TCP pose (4, 4) before the grasp, passed without stopping.
        grasp: TCP pose at which the fingers close.
        via: TCP poses passed while carrying.
        place: TCP pose at which the fingers open.
        retreat: TCP pose after the release.
        open_m: finger width before the grasp.
        release_m: finger width after the release.
        then: further waypoints; `retreat` is then passed without stopping.
    """
    return [
        Waypoint(X_BG=above, finger_width_m=open_m, through=True),
        Waypoint(X_BG=grasp, finger_width_m=open_m),
        Waypoint(X_BG=grasp, finger_width_m=SQUEEZE_M),
        *(Waypoint(X_BG=X, finger_width_m=SQUEEZE_M, through=True) for X in via),
        Waypoint(X_BG=place, finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=place, finger_width_m=release_m),
        Waypoint(X_BG=retreat, finger_width_m=release_m, through=bool(then)),
        *then,
    ]
