"""Experts for the tasks with drawers.

Positions are in the cabinet's frame M: x the direction in which the drawer opens, y along its front, z up.
"""

from collections.abc import Callable

import numpy as np

from kinebench_drake.geometry import Array, invert, make_pose
from kinebench_drake.suites.expert.grasp import (
    DOWN,
    HALF_TIP_M,
    TIP_M,
    closed_waypoint,
    grasp_rotation,
    level_axes,
    lift,
    nearest_axis,
    pick_and_place,
)
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.task import Scene

HOOK_M = 0.032
"""Depth of the fingertips below the upper edge of the drawer's front."""
ABOVE_M = 0.05
"""Height of the fingertips above objects they pass over."""
PASS_M = 0.03
"""Gap between a carried cube, or the fingers, and what they pass over."""
DROP_M = 0.012
"""Height above the tray's floor from which a cube is released."""
RELEASE_M = 0.03
"""Finger width in excess of the cube's edge at the release in the tray."""
BEHIND_M = 0.012
"""Gap between the fingers and the cube behind which they come down."""
DRAG_M = 0.006
"""Distance past the edge to which the fingers drag a cube."""
DRAG_HEIGHT_M = 0.005
"""Height of the fingertips above the cabinet's top while dragging."""


def _rotation(scene: Scene) -> Array:
    """Return the rotation (3, 3) of a gripper that points down and closes along the drawer's front."""
    across = scene.poses["cabinet"][:3, 1]
    # Of two opposite closing directions, the one closer to this keeps the wrist far from its limits.
    return grasp_rotation(DOWN, nearest_axis([across, -across], (1.0, -1.0, 0.0)))


def _pose(scene: Scene, x_m: float, y_m: float, tip_m: float) -> Array:
    """Return the TCP pose (4, 4) with the fingertips `tip_m` above the table at a place in the cabinet's frame [m]."""
    X_BM = scene.poses["cabinet"]
    return make_pose(_rotation(scene), X_BM[:3, :3] @ [x_m, y_m, tip_m + TIP_M] + X_BM[:3, 3])


def _local(scene: Scene, X_BS: Array) -> Array:
    """Return the position (3,) of a pose in the cabinet's frame [m]."""
    return np.asarray((invert(scene.poses["cabinet"]) @ X_BS)[:3, 3])


def open_drawer(scene: Scene) -> list[Waypoint]:
    """Reach into the gap, pull the drawer out, retreat."""
    face = _local(scene, scene.site("cabinet", "edge"))[0]
    front = _local(scene, scene.site("cabinet", "pull"))
    last = front[0] - scene.joints["cabinet"] + scene.size("cabinet", "travel_m") - 0.002
    middle = 0.5 * (face + front[0])
    tip = front[2] - HOOK_M
    high = front[2] + ABOVE_M
    return [
        closed_waypoint(_pose(scene, middle, 0.0, high), through=True),
        closed_waypoint(_pose(scene, middle, 0.0, tip), pace=1.5),
        closed_waypoint(_pose(scene, last - HALF_TIP_M, 0.0, tip), pace=2.0),
        closed_waypoint(_pose(scene, last - HALF_TIP_M - 0.012, 0.0, tip)),
        closed_waypoint(_pose(scene, last - HALF_TIP_M - 0.02, 0.0, high)),
    ]


def close_drawer(scene: Scene) -> list[Waypoint]:
    """Push the drawer shut from outside, retreat."""
    front = _local(scene, scene.site("cabinet", "push"))
    start = front[0] + HALF_TIP_M + 0.025
    last = front[0] - scene.joints["cabinet"] + HALF_TIP_M
    low = front[2] - HOOK_M
    high = front[2] + ABOVE_M
    return [
        closed_waypoint(_pose(scene, start, 0.0, high), through=True),
        closed_waypoint(_pose(scene, start, 0.0, low), pace=1.3),
        closed_waypoint(_pose(scene, last - 0.001, 0.0, low), pace=2.0),
        closed_waypoint(_pose(scene, last + 0.02, 0.0, low)),
        closed_waypoint(_pose(scene, last, 0.0, high)),
    ]


def _cube_in_tray(scene: Scene) -> bool:
    """Return True if the cube is in the tray."""
    p = (invert(scene.site("cabinet", "tray")) @ scene.poses["cube"])[:3, 3]
    half = 0.5 * np.array([scene.size("cabinet", "tray_length_m"), scene.size("cabinet", "tray_width_m")])
    return bool((np.abs(p[:2]) < half).all() and 0.0 < p[2] < scene.size("cabinet", "wall_m"))


def store_cube_by_dropping(scene: Scene) -> list[Waypoint]:
    """Grasp the cube, drop it into the open drawer, push the drawer shut."""
    if _cube_in_tray(scene):
        return close_drawer(scene)
    X_BC = scene.poses["cube"]
    edge = scene.size("cube", "edge_m")
    grasp = make_pose(grasp_rotation(DOWN, nearest_axis(level_axes(X_BC[:3, :3]), _rotation(scene)[:, 1])), X_BC[:3, 3])
    top = _local(scene, scene.site("cabinet", "edge"))
    front = _local(scene, scene.site("cabinet", "pull"))
    floor = _local(scene, scene.site("cabinet", "tray"))[2]
    middle = 0.5 * (top[0] + front[0])
    return pick_and_place(
        lift(grasp, ABOVE_M),
        grasp,
        [lift(grasp, 2.0 * PASS_M), _pose(scene, middle, 0.0, top[2] + edge / 2.0 + PASS_M)],
        _pose(scene, middle, 0.0, floor + edge / 2.0 + DROP_M - TIP_M),
        _pose(scene, middle, 0.0, front[2] + ABOVE_M),
        release_m=edge + RELEASE_M,
        then=close_drawer(scene),
    )


def store_cube_by_dragging(scene: Scene) -> list[Waypoint]:
    """Drag the cube over the edge into the open drawer, push the drawer shut."""
    if _cube_in_tray(scene):
        return close_drawer(scene)
    cube = _local(scene, scene.poses["cube"])
    edge = _local(scene, scene.site("cabinet", "edge"))
    faces = level_axes((invert(scene.poses["cabinet"]) @ scene.poses["cube"])[:3, :3])
    half = 0.5 * scene.size("cube", "edge_m") * float(np.abs(faces[:2, 0]).sum())
    behind = cube[0] - half - HALF_TIP_M - BEHIND_M
    over = edge[0] - HALF_TIP_M + DRAG_M
    low = edge[2] + DRAG_HEIGHT_M
    high = edge[2] + scene.size("cube", "edge_m") + PASS_M
    return [
        closed_waypoint(_pose(scene, behind, cube[1], high), through=True),
        closed_waypoint(_pose(scene, behind, cube[1], low)),
        closed_waypoint(_pose(scene, over, cube[1], low), pace=1.5),
        closed_waypoint(_pose(scene, over - 0.01, cube[1], edge[2] + ABOVE_M), through=True),
        *close_drawer(scene),
    ]


EXPERTS: dict[str, Callable[[Scene], list[Waypoint]]] = {
    "OpenDrawer-v1": open_drawer,
    "CloseDrawer-v1": close_drawer,
    "StoreCube-v1": store_cube_by_dropping,
    "StoreCube-v2": store_cube_by_dragging,
}
"""Experts of this family by task id."""
