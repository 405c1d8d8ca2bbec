"""Experts for the tasks with small cubes: stack, pull, pick."""

from collections.abc import Mapping

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.experts.grasp import (
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

CUBE_M = 0.04
"""Edge of ManiSkill's cubes."""
NEIGHBOUR_M = 0.10
"""Centre distance below which the open fingers could touch the cube beside."""
ABOVE_M = 0.10
"""How far above a cube the gripper comes in and goes out."""
PLACE_GAP_M = 0.002
"""Height from which a cube is let go."""
BEHIND_M = 0.048
"""How far behind the cube's centre the closed fingers touch down: half a cube, half a finger and some air."""
CONTACT_M = 0.03
"""Distance of cube centre and TCP while the fingers' backs push the cube: half a cube and half a finger."""
PULL_HEIGHT_M = 0.018
"""Height of the TCP above the table while pulling."""
TARGET_OFFSET_M = 0.01
"""How far short of the target's centre the pull ends."""


def stack_cube(X_BG: Array, objects: Mapping[str, Array]) -> list[Waypoint]:
    """Put cubeA (red) on cubeB (green) and let go.

    Args:
        X_BG: pose (4, 4) of panda_hand_tcp at the start [m].
        objects: poses (4, 4) in B [m] of `cubeA` and `cubeB`.
    """
    X_BA, X_BT = objects["cubeA"], objects["cubeB"]
    between = X_BT[:3, 3] - X_BA[:3, 3]
    axes = level_axes(X_BA[:3, :3])
    if np.linalg.norm(between) < NEIGHBOUR_M:  # close across the line to the other cube, so that no finger hits it
        axes = axes[np.abs(axes @ between) <= np.abs(axes @ between).min() + 1e-9]
    closing = nearest_axis(axes, X_BG[:3, 1])
    grasp = make_pose(grasp_rotation(DOWN, closing), X_BA[:3, 3])
    landing = nearest_axis(level_axes(X_BT[:3, :3]), closing)
    place = make_pose(grasp_rotation(DOWN, landing), X_BT[:3, 3] + [0.0, 0.0, CUBE_M + PLACE_GAP_M])
    return [
        Waypoint(X_BG=raised(grasp, ABOVE_M), finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=grasp, finger_width_m=OPEN_M),
        Waypoint(X_BG=grasp, finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=raised(grasp, ABOVE_M), finger_width_m=SQUEEZE_M, through=True),
        Waypoint(X_BG=raised(place, 0.8 * ABOVE_M), finger_width_m=SQUEEZE_M, through=True),
        Waypoint(X_BG=place, finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=place, finger_width_m=OPEN_M),
        Waypoint(X_BG=raised(place, 1.2 * ABOVE_M), finger_width_m=OPEN_M),
    ]


def pull_cube(X_BG: Array, objects: Mapping[str, Array]) -> list[Waypoint]:
    """Drag the cube back onto the target with the closed gripper.

    Args:
        X_BG: pose (4, 4) of panda_hand_tcp at the start [m]; not used, the cube always lies square to the robot.
        objects: poses (4, 4) in B [m] of `cube` and `goal_region`.
    """
    cube, goal = objects["cube"][:3, 3], objects["goal_region"][:3, 3]
    R = grasp_rotation(DOWN, (0.0, -1.0, 0.0))
    behind = make_pose(R, [cube[0] + BEHIND_M, cube[1], PULL_HEIGHT_M])
    pulled = make_pose(R, [goal[0] + CONTACT_M + TARGET_OFFSET_M, goal[1], PULL_HEIGHT_M])
    return [
        Waypoint(X_BG=raised(behind, ABOVE_M), finger_width_m=CLOSED_M, through=True),
        Waypoint(X_BG=behind, finger_width_m=CLOSED_M),
        Waypoint(X_BG=pulled, finger_width_m=CLOSED_M),
        Waypoint(X_BG=raised(pulled, ABOVE_M), finger_width_m=CLOSED_M),
    ]


def pick_cube(X_BG: Array, objects: Mapping[str, Array]) -> list[Waypoint]:
    """Grasp the cube and hold it at the goal in the air.

    Args:
        X_BG: pose (4, 4) of panda_hand_tcp at the start [m].
        objects: poses (4, 4) in B [m] of `cube` and `goal_site`.
    """
    X_BA, goal = objects["cube"], objects["goal_site"][:3, 3]
    R = grasp_rotation(DOWN, nearest_axis(level_axes(X_BA[:3, :3]), X_BG[:3, 1]))
    grasp, hold = make_pose(R, X_BA[:3, 3]), make_pose(R, goal)
    return [
        Waypoint(X_BG=raised(grasp, ABOVE_M), finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=grasp, finger_width_m=OPEN_M),
        Waypoint(X_BG=grasp, finger_width_m=SQUEEZE_M),
        Waypoint(X_BG=raised(grasp, 0.5 * ABOVE_M), finger_width_m=SQUEEZE_M, through=True),
        Waypoint(X_BG=hold, finger_width_m=SQUEEZE_M),
    ]
