"""Experts for the tasks with faucets."""

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.experts.grasp import BACK_M, CLOSED_M, grasp_rotation, raised
from kinebench_drake.suites.experts.motion import Arc, Waypoint
from kinebench_drake.suites.tasks.task import Scene

GRIP_PART = 0.75
"""Where along the lever the finger pushes."""
HALF_FINGERS_M = (0.0105, BACK_M)
"""Half sizes of the closed fingers along the TCP frame's x and y."""
AIR_M = 0.018
"""Gap between finger and lever before the push."""
BELOW_M = 0.002
"""How far the TCP is below the lever's middle line."""
ABOVE_M = 0.075
"""How far above its lever the gripper comes in and goes out."""
BACK_OFF_M = 0.015
"""How far the finger leaves the lever before it goes up."""
OPEN_GOAL, CLOSED_GOAL = 0.96, 0.01
"""Parts of the travel to which the lever is pushed."""
LEAN_RAD = 0.3
"""How far the hand leans to the side that the lever points to, so that handle and fingers stay in view."""
SIDE = (0.0, -1.0, 0.0)
"""The fingers side by side as seen from the camera."""


def open_faucet(scene: Scene) -> list[Waypoint]:
    """Sweep the lever counter-clockwise."""
    return _sweep(scene, OPEN_GOAL)


def close_faucet(scene: Scene) -> list[Waypoint]:
    """Sweep the lever clockwise."""
    return _sweep(scene, CLOSED_GOAL)


def _sweep(scene: Scene, goal: float) -> list[Waypoint]:
    """Come down behind the lever, carry it along on an arc about the axis to a part of its travel, back off, go up."""
    turn = goal * scene.size("faucet", "range_rad") - scene.joints["faucet"]
    way = float(np.sign(turn))
    axis = scene.poses["faucet/handle"][:3, 3]
    lever = scene.poses["faucet/handle"][:2, 0]
    start = float(np.arctan2(lever[1], lever[0]))
    aside = float(np.sign(scene.poses["faucet"][1, 0]))
    R = grasp_rotation([0.0, -aside * np.sin(LEAN_RAD), -np.cos(LEAN_RAD)], SIDE)

    def touching(angle: float, gap_m: float) -> Array:
        """The TCP's pose with the fingers' side `gap_m` behind the lever at an angle."""
        ahead = way * np.array([-np.sin(angle), np.cos(angle), 0.0])
        behind = scene.size("faucet", "half_width_m") + np.abs(R[:, :2].T @ ahead) @ HALF_FINGERS_M + gap_m
        along = GRIP_PART * scene.size("faucet", "lever_m") * np.array([np.cos(angle), np.sin(angle), 0.0])
        return make_pose(R, axis + along - behind * ahead - [0.0, 0.0, BELOW_M])

    first, last, clear = touching(start, AIR_M), touching(start + turn, 0.0), touching(start + turn, BACK_OFF_M)
    a, b = first[:2, 3] - axis[:2], last[:2, 3] - axis[:2]
    swing = float(np.arctan2(way * (a[0] * b[1] - a[1] * b[0]), a @ b))
    about = Arc(point=axis, axis=np.array([0.0, 0.0, 1.0]), angle_rad=way * (swing % (2.0 * np.pi)))
    return [
        Waypoint(X_BG=raised(first, ABOVE_M), finger_width_m=CLOSED_M, through=True),
        Waypoint(X_BG=first, finger_width_m=CLOSED_M),
        Waypoint(X_BG=last, finger_width_m=CLOSED_M, arc=about, pace=1.3),
        Waypoint(X_BG=clear, finger_width_m=CLOSED_M, through=True),
        Waypoint(X_BG=raised(clear, ABOVE_M), finger_width_m=CLOSED_M),
    ]


EXPERTS = {"CloseFaucet-v1": close_faucet, "OpenFaucet-v1": open_faucet}
"""Experts of this family by task id."""
