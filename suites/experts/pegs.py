"""Expert for the two-coloured peg."""

import numpy as np

from kinebench_drake.geometry import make_pose
from kinebench_drake.suites.experts.grasp import DOWN, OPEN_M, grasp_rotation, raised, shifted
from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.tasks.task import Scene

END_M = 0.020
"""How far from the red end the peg is held: that end turns under the palm without touching."""
PRESSED_M = 0.008
"""How much narrower than the peg the fingers are told to be: pads press so lightly (some 4 N each) that the peg turns
between them by its weight."""
HANG_M = 0.006
"""Air under the peg when it hangs."""
DOWN_M = 0.001
"""How far it is pressed down past its height when standing, so that its end lies flat."""
DRIFT_M = 0.06
"""How far the red end moves towards the blue one as it rises; the blue end slides along the table until it hangs."""
DRAG_M = 0.035
"""How far the gripper moves on when the blue end touches the table: friction there holds it back, and the peg, which
the fingers' friction left a little tilted, comes upright."""
ABOVE_M = 0.08
"""How far above the peg the gripper comes in and goes out."""


def lift_peg_upright(scene: Scene) -> list[Waypoint]:
    """Grasp the peg by its red end, raise that end until the peg hangs, set it down, drag it upright, let go.

    The gripper points down all the time: the light grasp is a hinge, and the blue end stays low by its weight. (A firm
    grasp would need the hand to make the whole quarter turn, at the edge of the workspace.)
    """
    X_BP, half = scene.poses["peg"], 0.5 * scene.size("peg", "length_m")
    along = X_BP[:3, 0] * [1.0, 1.0, 0.0]
    along /= np.linalg.norm(along)
    R, grip = grasp_rotation(DOWN, (along[1], -along[0], 0.0)), half - END_M
    hinge = scene.size("peg", "width_m") - PRESSED_M
    grasp = make_pose(R, X_BP[:3, 3] - grip * along)
    standing = grasp.copy()
    standing[:3, 3] += (DRIFT_M + DRAG_M) * along
    standing[2, 3] = half + grip - DOWN_M
    touching = shifted(standing, -DRAG_M * along)
    hanging = raised(touching, HANG_M + DOWN_M)
    return [
        Waypoint(X_BG=raised(grasp, ABOVE_M), finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=grasp, finger_width_m=OPEN_M),
        Waypoint(X_BG=grasp, finger_width_m=hinge),
        Waypoint(X_BG=hanging, finger_width_m=hinge),
        Waypoint(X_BG=touching, finger_width_m=hinge, through=True),
        Waypoint(X_BG=standing, finger_width_m=hinge),
        Waypoint(X_BG=standing, finger_width_m=OPEN_M),
        Waypoint(X_BG=raised(standing, ABOVE_M), finger_width_m=OPEN_M),
    ]


EXPERTS = {"LiftPegUpright-v1": lift_peg_upright}
"""Experts of this family by task id."""
