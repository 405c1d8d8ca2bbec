"""Expert for the two-coloured peg."""

from collections.abc import Mapping

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.experts.grasp import DOWN, OPEN_M, grasp_rotation, raised
from kinebench_drake.suites.experts.motion import Waypoint

HALF_LENGTH_M, WIDTH_M = 0.12, 0.05
"""The peg lies along x; its red end points at the robot."""
GRIP_M = 0.10
"""Where it is held: this far from its middle, near the red end, which turns under the palm without touching."""
HINGE_M = WIDTH_M - 0.010
"""Finger width asked for: pads press so lightly (some 5 N each) that the peg turns between them by its weight."""
HANG_M = 0.008
"""Air under the peg when it hangs."""
PRESS_M = 0.001
"""How far it is pressed down past its height when standing, so that its end lies flat."""
DRIFT_M = 0.06
"""How far the red end moves away from the robot as it rises; the blue end slides along the table until it hangs."""
ABOVE_M = 0.08
"""How far above the peg the gripper comes in and goes out."""


def lift_peg_upright(X_BG: Array, objects: Mapping[str, Array]) -> list[Waypoint]:
    """Grasp the peg by its red end, raise that end until the peg hangs upright, set it down, let go.

    The gripper points down all the time: the light grasp is a hinge, and the blue end stays low by its weight. (A firm
    grasp would need the hand to make the whole quarter turn, at the edge of the workspace.)

    Args:
        X_BG: pose (4, 4) of panda_hand_tcp at the start [m]; not used, the peg always points at the robot.
        objects: pose (4, 4) in B [m] of `peg`.
    """
    X_BP = objects["peg"]
    R = grasp_rotation(DOWN, (0.0, -1.0, 0.0))
    grasp = make_pose(R, X_BP[:3, 3] - GRIP_M * X_BP[:3, 0])
    standing = make_pose(R, [grasp[0, 3] + DRIFT_M, grasp[1, 3], HALF_LENGTH_M + GRIP_M - PRESS_M])
    hanging = raised(standing, HANG_M + PRESS_M)
    return [
        Waypoint(X_BG=raised(grasp, ABOVE_M), finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=grasp, finger_width_m=OPEN_M),
        Waypoint(X_BG=grasp, finger_width_m=HINGE_M),
        Waypoint(X_BG=hanging, finger_width_m=HINGE_M),
        Waypoint(X_BG=standing, finger_width_m=HINGE_M),
        Waypoint(X_BG=standing, finger_width_m=OPEN_M),
        Waypoint(X_BG=raised(standing, ABOVE_M), finger_width_m=OPEN_M),
    ]
