"""Experts for the tasks with small cubes."""

import numpy as np

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.suites.experts.grasp import (
    BACK_M,
    CLOSED_M,
    DOWN,
    OPEN_M,
    SQUEEZE_M,
    grasp_rotation,
    level_axes,
    nearest_axis,
    raised,
)
from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.tasks.task import Scene

NEIGHBOUR_M = 0.10
"""Centre distance below which the open fingers could touch the cube beside."""
ABOVE_M = 0.10
"""How far above a cube the gripper comes in and goes out."""
PLACE_GAP_M = 0.002
"""Height from which a cube is let go."""
OVER_M = 0.06
"""How far above an obstacle's top the TCP passes: half a cube and air."""
HAND_M = 0.045
"""Half the hand's thickness and air."""
UNWIND_RAD = 0.5
"""How far the hand would rather be turned than at rest, towards the middle of the wrist's range, before a wide turn."""
SLANT_RAD = 0.3
"""How much a finger's back slants against the approach direction."""
LEAN_RAD = 0.55
"""How far the hand leans aside while pulling."""
AIR_M = 0.014
"""Air between the cube and the fingers that touch down behind it."""
PULL_HEIGHT_M = 0.018
"""Height of the TCP above the table while pulling."""


def stack_cube(scene: Scene) -> list[Waypoint]:
    """Put the green cube on the red one and let go; pass high over an obstacle."""
    X_BA, X_BT = scene.poses["green"], scene.poses["red"]
    height = 0.5 * (scene.size("green", "edge_m") + scene.size("red", "edge_m"))
    axes, landings = level_axes(X_BA[:3, :3]), level_axes(X_BT[:3, :3])
    over, wanted = ABOVE_M, scene.X_BG[:3, 1]
    if "obstacle" in scene.poses:
        over = max(over, scene.size("obstacle", "height_m") + OVER_M - X_BA[2, 3])
        obstacle, room = scene.poses["obstacle"][:3, 3], scene.size("obstacle", "radius_m") + HAND_M
        axes = _clear(axes, obstacle - X_BA[:3, 3], room)
        landings = _clear(landings, obstacle - X_BT[:3, 3], room)
        wanted = rotation_exp(np.array([0.0, 0.0, UNWIND_RAD])) @ wanted
    elif np.linalg.norm(X_BT[:3, 3] - X_BA[:3, 3]) < NEIGHBOUR_M:
        axes = _clear(axes, X_BT[:3, 3] - X_BA[:3, 3], NEIGHBOUR_M)
    closing = nearest_axis(axes, wanted)
    landing = nearest_axis(landings, closing)
    grasp = make_pose(grasp_rotation(DOWN, closing), X_BA[:3, 3])
    place = make_pose(grasp_rotation(DOWN, landing), X_BT[:3, 3] + [0.0, 0.0, height + PLACE_GAP_M])
    return [
        Waypoint(X_BG=raised(grasp, over), finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=grasp, finger_width_m=OPEN_M),
        Waypoint(X_BG=grasp, finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=raised(grasp, over), finger_width_m=SQUEEZE_M, through=True),
        Waypoint(X_BG=raised(place, max(0.8 * ABOVE_M, over - height)), finger_width_m=SQUEEZE_M, through=True),
        Waypoint(X_BG=place, finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=place, finger_width_m=OPEN_M),
        Waypoint(X_BG=raised(place, 1.2 * ABOVE_M), finger_width_m=OPEN_M),
    ]


def _clear(axes: Array, other: Array, room_m: float) -> Array:
    """Those of the closing directions (N, 3) with something at `other` (3,) at least `room_m` beside the hand's plane.

    If there are none, those with it farthest beside.
    """
    beside = np.linalg.norm(np.cross(axes, other * [1.0, 1.0, 0.0]), axis=1)
    return np.asarray(axes[beside >= min(room_m, beside.max() - 1e-9)])


def pull_cube(scene: Scene) -> list[Waypoint]:
    """Drag the cube onto the middle of the target with the closed gripper behind it.

    The hand leans aside, away from the middle, so that the cube can be seen from the front; and forward, so that the
    slanting back of the finger that touches the cube is upright.
    """
    cube, goal = scene.poses["cube"][:3, 3], scene.poses["target"][:3, 3]
    back = (goal - cube) * [1.0, 1.0, 0.0]
    back /= np.linalg.norm(back)
    outward = np.cross(back, [0.0, 0.0, 1.0]) * (1.0 if cube[1] >= 0.0 else -1.0)
    down = -np.sin(LEAN_RAD) * outward - np.cos(LEAN_RAD) * np.array([0.0, 0.0, 1.0])
    R = grasp_rotation(np.cos(SLANT_RAD) * down + np.sin(SLANT_RAD) * back, -back)
    half = 0.5 * scene.size("cube", "edge_m")
    reach = half * np.abs(level_axes(scene.poses["cube"][:3, :3])[:2] @ back).sum()
    behind = make_pose(R, [*(cube - (reach + BACK_M + AIR_M) * back)[:2], PULL_HEIGHT_M])
    pulled = make_pose(R, [*(goal - (half + BACK_M) * back)[:2], PULL_HEIGHT_M])
    return [
        Waypoint(X_BG=raised(behind, ABOVE_M), finger_width_m=CLOSED_M, through=True),
        Waypoint(X_BG=behind, finger_width_m=CLOSED_M),
        Waypoint(X_BG=pulled, finger_width_m=CLOSED_M, pace=1.3),
        Waypoint(X_BG=raised(pulled, ABOVE_M), finger_width_m=CLOSED_M),
    ]


EXPERTS = {"PullCube-v1": pull_cube, "StackCube-v1": stack_cube}
"""Experts of this family by task id."""
