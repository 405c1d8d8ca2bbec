"""Experts for the tasks with small cubes."""

import numpy as np

from kinebench_drake.geometry import make_pose
from kinebench_drake.suites.experts.grasp import (
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


def stack_cube(scene: Scene) -> list[Waypoint]:
    """Put the green cube on the red one and let go."""
    X_BA, X_BT = scene.poses["green"], scene.poses["red"]
    between = X_BT[:3, 3] - X_BA[:3, 3]
    axes = level_axes(X_BA[:3, :3])
    if np.linalg.norm(between) < NEIGHBOUR_M:  # close across the line to the other cube, so that no finger hits it
        axes = axes[np.abs(axes @ between) <= np.abs(axes @ between).min() + 1e-9]
    closing = nearest_axis(axes, scene.X_BG[:3, 1])
    grasp = make_pose(grasp_rotation(DOWN, closing), X_BA[:3, 3])
    landing = nearest_axis(level_axes(X_BT[:3, :3]), closing)
    height = 0.5 * (scene.size("green", "edge_m") + scene.size("red", "edge_m"))
    place = make_pose(grasp_rotation(DOWN, landing), X_BT[:3, 3] + [0.0, 0.0, height + PLACE_GAP_M])
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


EXPERTS = {"StackCube-v1": stack_cube}
"""Experts of this family by task id."""
