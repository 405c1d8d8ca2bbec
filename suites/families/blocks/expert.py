"""Experts for the tasks with cubes and the peg."""

import numpy as np

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.suites.expert.grasp import (
    BACK_M,
    DOWN,
    OPEN_M,
    closed_waypoint,
    grasp_rotation,
    level_axes,
    lift,
    nearest_axis,
    pick_and_place,
    shift,
)
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.task import Scene

NEIGHBOUR_M = 0.10
"""Distance between cube centres below which the open fingers could touch the other cube."""
ABOVE_M = 0.10
"""Height above a cube from which the gripper approaches and to which it retreats."""
OVER_M = 0.06
"""Height of the TCP above an obstacle's top when passing: half a cube and clearance."""
HAND_M = 0.045
"""Half the hand's thickness and clearance."""
SLANT_RAD = 0.3
"""Angle between the back of a finger and the approach direction."""
LEAN_RAD = 0.55
"""Sideways tilt of the hand while pulling."""
CLEARANCE_M = 0.014
"""Gap between the cube and the fingers that come down behind it."""
PULL_HEIGHT_M = 0.018
"""Height of the TCP above the table while pulling."""
WIDE_YAW_RAD = 0.5
"""Preferred yaw of the hand before a wide turn, away from rest towards the middle of the wrist's range."""
DROP_M = 0.002
"""Height from which a cube is released."""
GRIP_M = 0.020
"""Distance of the grasp from the peg's red end, so short that this end turns under the palm without touching it."""
PRESS_M = 0.008
"""Commanded finger width below the peg's width: the pads press so lightly (about 4 N each) that the peg turns
between them under its weight."""


def stack_cube(scene: Scene) -> list[Waypoint]:
    """Put the green cube on the red one and release it, passing above an obstacle."""
    X_BA = scene.poses["green"]
    X_BT = scene.poses["red"]
    height = 0.5 * (scene.size("green", "edge_m") + scene.size("red", "edge_m"))
    axes = level_axes(X_BA[:3, :3])
    landings = level_axes(X_BT[:3, :3])
    over = ABOVE_M
    preferred = scene.X_BG[:3, 1]
    if "obstacle" in scene.poses:
        over = max(over, scene.size("obstacle", "height_m") + OVER_M - X_BA[2, 3])
        obstacle = scene.poses["obstacle"][:3, 3]
        room = scene.size("obstacle", "radius_m") + HAND_M
        axes = _clear_axes(axes, obstacle - X_BA[:3, 3], room)
        landings = _clear_axes(landings, obstacle - X_BT[:3, 3], room)
        preferred = rotation_exp(np.array([0.0, 0.0, WIDE_YAW_RAD])) @ preferred
    elif np.linalg.norm(X_BT[:3, 3] - X_BA[:3, 3]) < NEIGHBOUR_M:
        axes = _clear_axes(axes, X_BT[:3, 3] - X_BA[:3, 3], NEIGHBOUR_M)
    closing = nearest_axis(axes, preferred)
    landing = nearest_axis(landings, closing)
    grasp = make_pose(grasp_rotation(DOWN, closing), X_BA[:3, 3])
    place = make_pose(grasp_rotation(DOWN, landing), X_BT[:3, 3] + [0.0, 0.0, height + DROP_M])
    above = lift(grasp, over)
    via = [above, lift(place, max(0.8 * ABOVE_M, over - height))]
    return pick_and_place(above, grasp, via, place, lift(place, 1.2 * ABOVE_M))


def _clear_axes(axes: Array, other: Array, room_m: float) -> Array:
    """Return the closing directions (N, 3) for which a neighbour at `other` (3,) is `room_m` off the hand's plane.

    If there are none, return those with the greatest distance.
    """
    beside = np.linalg.norm(np.cross(axes, other * [1.0, 1.0, 0.0]), axis=1)
    return np.asarray(axes[beside >= min(room_m, beside.max() - 1e-9)])


def pull_cube(scene: Scene) -> list[Waypoint]:
    """Drag the cube onto the centre of the target with the closed gripper behind it.

    The hand tilts sideways, away from the middle, so that the cube is visible from the front; and forward, so that the
    slanted back of the finger that touches the cube is vertical.
    """
    cube = scene.poses["cube"][:3, 3]
    goal = scene.poses["target"][:3, 3]
    back = (goal - cube) * [1.0, 1.0, 0.0]
    back /= np.linalg.norm(back)
    outward = np.cross(back, [0.0, 0.0, 1.0]) * (1.0 if cube[1] >= 0.0 else -1.0)
    down = -np.sin(LEAN_RAD) * outward - np.cos(LEAN_RAD) * np.array([0.0, 0.0, 1.0])
    R = grasp_rotation(np.cos(SLANT_RAD) * down + np.sin(SLANT_RAD) * back, -back)
    half = 0.5 * scene.size("cube", "edge_m")
    reach = half * np.abs(level_axes(scene.poses["cube"][:3, :3])[:2] @ back).sum()
    behind = make_pose(R, [*(cube - (reach + BACK_M + CLEARANCE_M) * back)[:2], PULL_HEIGHT_M])
    end = make_pose(R, [*(goal - (half + BACK_M) * back)[:2], PULL_HEIGHT_M])
    return [
        closed_waypoint(lift(behind, ABOVE_M), through=True),
        closed_waypoint(behind),
        closed_waypoint(end, pace=1.3),
        closed_waypoint(lift(end, ABOVE_M)),
    ]


DOWN_M = 0.001
"""Distance by which the standing peg is pressed down, so that its end lies flat."""
DRIFT_M = 0.06
"""Displacement of the red end towards the blue one as it rises; the blue end slides on the table until it lifts off."""
DRAG_M = 0.035
"""Displacement of the gripper after the blue end touches the table: friction there holds the blue end back, and the
peg, which the friction of the fingers left slightly tilted, comes upright."""
PEG_ABOVE_M = 0.08
"""Height above the peg from which the gripper approaches and to which it retreats."""


def lift_peg_upright(scene: Scene) -> list[Waypoint]:
    """Grasp the peg near its red end, raise that end until the peg hangs, set it down, drag it upright, release it.

    The gripper points down throughout: the light grasp acts as a hinge, and the blue end stays low by its weight. (A
    firm grasp would require the hand to turn by 90 degrees, at the edge of the workspace.)
    """
    X_BP = scene.poses["peg"]
    half = 0.5 * scene.size("peg", "length_m")
    along = X_BP[:3, 0] * [1.0, 1.0, 0.0]
    along /= np.linalg.norm(along)
    R = grasp_rotation(DOWN, (along[1], -along[0], 0.0))
    grip = half - GRIP_M
    width = scene.size("peg", "width_m") - PRESS_M
    grasp = make_pose(R, X_BP[:3, 3] - grip * along)
    standing = grasp.copy()
    standing[:3, 3] += (DRIFT_M + DRAG_M) * along
    standing[2, 3] = half + grip - DOWN_M
    touching = shift(standing, -DRAG_M * along)
    hanging = lift(touching, 0.006 + DOWN_M)  # gap under the hanging peg
    return [
        Waypoint(X_BG=lift(grasp, PEG_ABOVE_M), finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=grasp, finger_width_m=OPEN_M),
        Waypoint(X_BG=grasp, finger_width_m=width),
        Waypoint(X_BG=hanging, finger_width_m=width),
        Waypoint(X_BG=touching, finger_width_m=width, through=True),
        Waypoint(X_BG=standing, finger_width_m=width),
        Waypoint(X_BG=standing, finger_width_m=OPEN_M),
        Waypoint(X_BG=lift(standing, PEG_ABOVE_M), finger_width_m=OPEN_M),
    ]


EXPERTS = {"LiftPegUpright-v1": lift_peg_upright, "PullCube-v1": pull_cube, "StackCube-v1": stack_cube}
"""Experts of this family by task id."""
