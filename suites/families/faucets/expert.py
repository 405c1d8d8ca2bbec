"""Experts for the tasks with faucets."""

from functools import partial

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.expert.grasp import BACK_M, closed_waypoint, grasp_rotation, lift
from kinebench_drake.suites.expert.motion import Arc, Waypoint
from kinebench_drake.suites.families.task import Scene

CLEARANCE_M = 0.018
"""Gap between finger and lever before the push."""
BELOW_M = 0.002
"""Height of the lever's centre line above the TCP."""
ABOVE_M = 0.075
"""Height above the lever from which the gripper approaches and to which it retreats."""
OPEN_GOAL = 0.96
CLOSED_GOAL = 0.01
"""Openings to which the lever is pushed, as fractions of its travel."""
LEAN_RAD = 0.3
"""Tilt of the hand to the side that the lever points to, so that handle and fingers stay visible."""
SIDE = (0.0, -1.0, 0.0)
"""Closing direction: the fingers are side by side as seen from the camera."""
PUSH_FRACTION = 0.75
"""Point of the lever where the finger pushes, as a fraction of its reach."""
FINGERS_M = (0.0105, BACK_M)
"""Half extents of the closed fingers along the TCP frame's x and y."""


def sweep_lever(goal: float, scene: Scene) -> list[Waypoint]:
    """Come down behind the lever, push it along an arc about its axis to a fraction of its travel, back off, go up."""
    turn = goal * scene.size("faucet", "range_rad") - scene.joints["faucet"]
    sense = float(np.sign(turn))
    axis = scene.poses["faucet/handle"][:3, 3]
    lever = scene.poses["faucet/handle"][:2, 0]
    start = float(np.arctan2(lever[1], lever[0]))
    side = float(np.sign(scene.poses["faucet"][1, 0]))
    R = grasp_rotation([0.0, -side * np.sin(LEAN_RAD), -np.cos(LEAN_RAD)], SIDE)

    def touching(angle: float, gap_m: float) -> Array:
        """Return the TCP pose with the fingers' side `gap_m` behind the lever at an angle."""
        ahead = sense * np.array([-np.sin(angle), np.cos(angle), 0.0])
        behind = scene.size("faucet", "half_width_m") + np.abs(R[:, :2].T @ ahead) @ FINGERS_M + gap_m
        along = PUSH_FRACTION * scene.size("faucet", "lever_m") * np.array([np.cos(angle), np.sin(angle), 0.0])
        return make_pose(R, axis + along - behind * ahead - [0.0, 0.0, BELOW_M])

    first = touching(start, CLEARANCE_M)
    last = touching(start + turn, 0.0)
    clear = touching(start + turn, 0.015)  # gap between finger and lever before the gripper moves up
    a = first[:2, 3] - axis[:2]
    b = last[:2, 3] - axis[:2]
    angle = float(np.arctan2(sense * (a[0] * b[1] - a[1] * b[0]), a @ b))
    return [
        closed_waypoint(lift(first, ABOVE_M), through=True),
        closed_waypoint(first),
        closed_waypoint(
            last,
            arc=Arc(point=axis, axis=np.array([0.0, 0.0, 1.0]), angle_rad=sense * (angle % (2.0 * np.pi))),
            pace=1.3,
        ),
        closed_waypoint(clear, through=True),
        closed_waypoint(lift(clear, ABOVE_M)),
    ]


EXPERTS = {"CloseFaucet-v1": partial(sweep_lever, CLOSED_GOAL), "OpenFaucet-v1": partial(sweep_lever, OPEN_GOAL)}
"""Experts of this family by task id."""
