"""Experts for the tasks with drawers.

Places are given in the cabinet's frame: how far out along the drawer's way, how far aside, how high.
"""

from collections.abc import Callable

import numpy as np

from kinebench_drake.geometry import Array, invert, make_pose
from kinebench_drake.suites.experts.grasp import (
    CLOSED_M,
    DOWN,
    HALF_TIP_M,
    OPEN_M,
    SQUEEZE_M,
    TIP_M,
    grasp_rotation,
    level_axes,
    nearest_axis,
    raised,
)
from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.tasks.task import Scene

HOOK_M = 0.032
"""How deep the fingertips go below the upper edge of the drawer's front."""
ABOVE_M = 0.05
"""Height of the fingertips above things they pass over."""
PASS_M = 0.03
"""Gap between a carried cube, or the fingers, and what they pass over."""
DROP_M = 0.012
"""Height above the tray's floor from which a cube is let go."""
RELEASE_M = 0.03
"""How much wider than the cube the fingers open in the tray."""
BEHIND_M = 0.012
"""Room between the fingers and the cube as they come down behind it."""
SKIM_M = 0.005
"""Height of the fingertips above the cabinet's top as they drag."""
BEYOND_M = 0.006
"""How far past the edge the fingers drag a cube."""
EASY = (1.0, -1.0, 0.0)
"""Of two opposite ways to close the fingers the one nearer to this keeps the wrist far from its ends."""


def _rotation(scene: Scene) -> Array:
    """Rotation (3, 3) of a gripper that points down, fingers closing along the drawer's front."""
    across = scene.poses["cabinet"][:3, 1]
    return grasp_rotation(DOWN, nearest_axis([across, -across], EASY))


def _pose(scene: Scene, out_m: float, aside_m: float, tip_m: float) -> Array:
    """Pose (4, 4) with the fingertips `tip_m` above the table at a place in the cabinet's frame [m]."""
    X_BM = scene.poses["cabinet"]
    return make_pose(_rotation(scene), X_BM[:3, :3] @ [out_m, aside_m, tip_m + TIP_M] + X_BM[:3, 3])


def _local(scene: Scene, X_BS: Array) -> Array:
    """Where (3,) something is in the cabinet's frame [m]."""
    return np.asarray((invert(scene.poses["cabinet"]) @ X_BS)[:3, 3])


def open_drawer(scene: Scene) -> list[Waypoint]:
    """Reach into the gap, pull the drawer out, leave."""
    face, front = _local(scene, scene.site("cabinet", "edge"))[0], _local(scene, scene.site("cabinet", "pull"))
    last = front[0] - scene.joints["cabinet"] + scene.size("cabinet", "travel_m") - 0.002
    middle, tip = 0.5 * (face + front[0]), front[2] - HOOK_M
    above = _pose(scene, middle, 0.0, front[2] + ABOVE_M)
    return [
        Waypoint(X_BG=above, finger_width_m=CLOSED_M, through=True),
        Waypoint(X_BG=_pose(scene, middle, 0.0, tip), finger_width_m=CLOSED_M, pace=1.5),
        Waypoint(X_BG=_pose(scene, last - HALF_TIP_M, 0.0, tip), finger_width_m=CLOSED_M, pace=2.0),
        Waypoint(X_BG=_pose(scene, last - HALF_TIP_M - 0.012, 0.0, tip), finger_width_m=CLOSED_M),
        Waypoint(X_BG=_pose(scene, last - HALF_TIP_M - 0.02, 0.0, front[2] + ABOVE_M), finger_width_m=CLOSED_M),
    ]


def _push_shut(scene: Scene) -> list[Waypoint]:
    """Push the drawer in from outside, leave."""
    front = _local(scene, scene.site("cabinet", "push"))
    start, last = front[0] + HALF_TIP_M + 0.025, front[0] - scene.joints["cabinet"] + HALF_TIP_M
    low, high = front[2] - HOOK_M, front[2] + ABOVE_M
    return [
        Waypoint(X_BG=_pose(scene, start, 0.0, high), finger_width_m=CLOSED_M, through=True),
        Waypoint(X_BG=_pose(scene, start, 0.0, low), finger_width_m=CLOSED_M, pace=1.3),
        Waypoint(X_BG=_pose(scene, last - 0.001, 0.0, low), finger_width_m=CLOSED_M, pace=2.0),
        Waypoint(X_BG=_pose(scene, last + 0.02, 0.0, low), finger_width_m=CLOSED_M),
        Waypoint(X_BG=_pose(scene, last, 0.0, high), finger_width_m=CLOSED_M),
    ]


def close_drawer(scene: Scene) -> list[Waypoint]:
    """Push the drawer in."""
    return _push_shut(scene)


def _stored(scene: Scene) -> bool:
    """Whether the cube is in the tray."""
    p = (invert(scene.site("cabinet", "tray")) @ scene.poses["cube"])[:3, 3]
    half = 0.5 * np.array([scene.size("cabinet", "tray_length_m"), scene.size("cabinet", "tray_width_m")])
    return bool((np.abs(p[:2]) < half).all() and 0.0 < p[2] < scene.size("cabinet", "wall_m"))


def store_cube_by_dropping(scene: Scene) -> list[Waypoint]:
    """Grasp the cube, drop it into the open drawer, push the drawer in."""
    if _stored(scene):
        return _push_shut(scene)
    X_BC, edge = scene.poses["cube"], scene.size("cube", "edge_m")
    grasp = make_pose(grasp_rotation(DOWN, nearest_axis(level_axes(X_BC[:3, :3]), _rotation(scene)[:, 1])), X_BC[:3, 3])
    top, front = _local(scene, scene.site("cabinet", "edge")), _local(scene, scene.site("cabinet", "pull"))
    floor = _local(scene, scene.site("cabinet", "tray"))[2]
    middle = 0.5 * (top[0] + front[0])
    drop = floor + edge / 2.0 + DROP_M - TIP_M
    high, free = top[2] + edge / 2.0 + PASS_M, edge + RELEASE_M
    return [
        Waypoint(X_BG=raised(grasp, ABOVE_M), finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=grasp, finger_width_m=OPEN_M),
        Waypoint(X_BG=grasp, finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=raised(grasp, 2.0 * PASS_M), finger_width_m=SQUEEZE_M, through=True),
        Waypoint(X_BG=_pose(scene, middle, 0.0, high), finger_width_m=SQUEEZE_M, through=True),
        Waypoint(X_BG=_pose(scene, middle, 0.0, drop), finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=_pose(scene, middle, 0.0, drop), finger_width_m=free),
        Waypoint(X_BG=_pose(scene, middle, 0.0, front[2] + ABOVE_M), finger_width_m=free, through=True),
        *_push_shut(scene),
    ]


def store_cube_by_dragging(scene: Scene) -> list[Waypoint]:
    """Drag the cube over the edge into the open drawer, push the drawer in."""
    if _stored(scene):
        return _push_shut(scene)
    cube, edge = _local(scene, scene.poses["cube"]), _local(scene, scene.site("cabinet", "edge"))
    out = level_axes((invert(scene.poses["cabinet"]) @ scene.poses["cube"])[:3, :3])
    half = 0.5 * scene.size("cube", "edge_m") * float(np.abs(out[:2, 0]).sum())
    behind, over = cube[0] - half - HALF_TIP_M - BEHIND_M, edge[0] - HALF_TIP_M + BEYOND_M
    low, high = edge[2] + SKIM_M, edge[2] + scene.size("cube", "edge_m") + PASS_M
    return [
        Waypoint(X_BG=_pose(scene, behind, cube[1], high), finger_width_m=CLOSED_M, through=True),
        Waypoint(X_BG=_pose(scene, behind, cube[1], low), finger_width_m=CLOSED_M),
        Waypoint(X_BG=_pose(scene, over, cube[1], low), finger_width_m=CLOSED_M, pace=1.5),
        Waypoint(X_BG=_pose(scene, over - 0.01, cube[1], edge[2] + ABOVE_M), finger_width_m=CLOSED_M, through=True),
        *_push_shut(scene),
    ]


EXPERTS: dict[str, Callable[[Scene], list[Waypoint]]] = {
    "OpenDrawer-v1": open_drawer,
    "CloseDrawer-v1": close_drawer,
    "StoreCube-v1": store_cube_by_dropping,
    "StoreCube-v2": store_cube_by_dragging,
}
"""Experts of this family by task id."""
