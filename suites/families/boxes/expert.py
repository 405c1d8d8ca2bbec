"""Experts for the tasks with boxes with hinged lids: the closed fingers act as a lever under or against the lid.

Positions are in the hinge's frame H: x from the hinge to the front of the box, y along the hinge, z out of the opening.
A lid opened by `angle` extends from the hinge along (cos, 0, sin).
"""

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.expert.grasp import (
    HALF_TIP_M,
    closed_passage,
    closed_waypoint,
    grasp_rotation,
    lift,
    shift,
    swing,
)
from kinebench_drake.suites.expert.motion import Arc, Waypoint
from kinebench_drake.suites.families.task import Scene

TIP_M = 0.0092
HALF_Y_M = 0.0150
"""Contact geometry of the closed fingertips: extent beyond the TCP, and half extent along the closing axis."""
BESIDE_WALL_M = 0.003
"""Gap between the fingertips under a rim and the wall of the box."""
CLEAR_M = 0.002
"""Gap between lid and fingers before the push."""
PRIED_RAD = np.radians(30.0)
"""Opening to which the lid is pried before the fingers reach deeper under it."""
RETREAT_M = 0.09
"""Distance by which the gripper retreats from an open lid."""
GOAL_FRACTION = 0.97
"""Opening to which the lid is pushed, as a fraction of its range."""
PUSH_DEPTH_M = 0.022
PUSH_TILT_RAD = np.radians(-12.0)
"""Depth and tilt of the fingers under the front edge while pushing."""
SIDE_TILT_RAD = np.radians(60.0)
PRY_SIDE_TILT_RAD = np.radians(48.0)
"""Angle of the fingers from the vertical at the side of a lid while pushing and while prying."""
SIDE_DEPTH_M = 0.024
"""Depth of the fingers under the side of a lid while pushing, along the fingers."""
PRESS_M = 0.003
"""Commanded distance past shut."""
CONTACT_M = 0.03
"""Distance of the contact at the side of a lid from its front edge."""
BELOW_EDGE_M = 0.030
"""Distance of the TCP below the upper edge of a lying box's lid: the greatest at which the palm stays clear of it."""
PRESS_FRACTION = 0.78
"""Point of the lid where the fingers press, as a fraction of the way from hinge to edge."""


def _rotation(scene: Scene, approach: Array, closing: Array) -> Array:
    """Return the rotation (3, 3) of the gripper, choosing the sign of `closing` that is closer to the current pose."""
    return grasp_rotation(approach, closing if closing @ scene.X_BG[:3, 1] > 0.0 else -closing)


def _under_front(scene: Scene, angle: float, depth_m: float, tilt: float) -> Array:
    """Return the TCP pose with the fingertips under the front edge of a lid opened by `angle` [rad].

    The fingertips are `depth_m` from the edge; `tilt` is the angle [rad] between the fingers and the lid, positive if
    the hand is above it.
    """
    X_BH = scene.site("box", "hinge")
    out = np.array([np.cos(angle), 0.0, np.sin(angle)])
    below = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    up_finger = np.cos(tilt) * out - np.sin(tilt) * below
    to_lid = -np.cos(tilt) * below - np.sin(tilt) * out
    corner = (scene.size("box", "lid_m") - depth_m) * out + (CLEAR_M + depth_m * max(0.0, np.tan(tilt))) * below
    p_H = corner + TIP_M * up_finger - HALF_Y_M * to_lid
    R_BH = X_BH[:3, :3]
    return make_pose(_rotation(scene, -R_BH @ up_finger, R_BH @ to_lid), X_BH[:3, 3] + R_BH @ p_H)


def _opening_arc(scene: Scene, angle: float) -> Arc:
    """Return the rotation about the hinge that opens the lid by `angle` [rad]."""
    X_BH = scene.site("box", "hinge")
    return Arc(point=X_BH[:3, 3], axis=-X_BH[:3, 1], angle_rad=angle)


def _push_front(scene: Scene, angle: float) -> list[Waypoint]:
    """Push a lid opened by `angle` fully open from under its front edge, and retreat."""
    start = _under_front(scene, angle, PUSH_DEPTH_M, PUSH_TILT_RAD)
    goal = GOAL_FRACTION * scene.size("box", "open_rad")
    arc = _opening_arc(scene, goal - angle)
    end = swing(start, arc)
    away = scene.site("box", "hinge")[:3, :3] @ [np.sin(goal), 0.0, -np.cos(goal)]
    return [
        closed_waypoint(start, through=True),
        closed_waypoint(end, arc=arc),
        closed_waypoint(shift(end, RETREAT_M * away)),
    ]


def open_ajar_front(scene: Scene) -> list[Waypoint]:
    """Put the fingertips under the front edge of the lid and push it open."""
    angle = scene.joints["box"]
    inside = _under_front(scene, angle, PUSH_DEPTH_M, PUSH_TILT_RAD)
    R_BH = scene.site("box", "hinge")[:3, :3]
    before = shift(inside, R_BH @ [0.06, 0.0, 0.0])
    return [*closed_passage(shift(before, R_BH @ [0.05, 0.0, 0.04]), before), *_push_front(scene, angle)]


def open_shut_front(scene: Scene) -> list[Waypoint]:
    """Pry the lid up at the front edge by rotating the gripper upwards, then push it open."""
    depth = scene.size("box", "overhang_m") - BESIDE_WALL_M
    under = _under_front(scene, 0.0, depth, np.radians(45.0))  # tilt of the fingers under the front edge before prying
    R_BH = scene.site("box", "hinge")[:3, :3]
    before = shift(under, R_BH @ [0.04, 0.0, 0.0])
    pried = _under_front(scene, PRIED_RAD, depth, PUSH_TILT_RAD)
    return [
        *closed_passage(shift(before, R_BH @ [0.05, 0.0, 0.05]), before),
        closed_waypoint(under),
        closed_waypoint(pried, arc=_opening_arc(scene, PRIED_RAD), pace=1.3),
        *_push_front(scene, PRIED_RAD),
    ]


def _under_side(scene: Scene, angle: float, depth_m: float, tilt: float) -> tuple[Array, Array]:
    """Return the TCP pose with the fingertips under the side of a lid opened by `angle`, and the contact point (3,).

    The fingertips are `depth_m` from the lid's edge, along the fingers; `tilt` is their angle [rad] from the vertical.
    """
    X_BH = scene.site("box", "hinge")
    side = -1.0 if X_BH[:3, 1] @ [0.0, X_BH[1, 3], 0.0] > 0.0 else 1.0  # towards y = 0, where there is more room
    out = np.array([np.cos(angle), 0.0, np.sin(angle)])
    edge = side * (0.5 * scene.size("box", "width_m") + scene.size("box", "overhang_m"))
    contact = (scene.size("box", "lid_m") - CONTACT_M) * out + [0.0, edge, 0.0]
    up_finger = np.array([0.0, side * np.sin(tilt), np.cos(tilt)])
    to_lid = np.array([0.0, -side * np.cos(tilt), np.sin(tilt)])
    p_H = contact + (TIP_M - depth_m) * up_finger - (HALF_Y_M + CLEAR_M) * to_lid + [HALF_TIP_M, 0.0, 0.0]
    R_BH = X_BH[:3, :3]
    X = make_pose(_rotation(scene, -R_BH @ up_finger, R_BH @ to_lid), X_BH[:3, 3] + R_BH @ p_H)
    return X, X_BH[:3, 3] + R_BH @ contact


def _carry_side(scene: Scene, start: float, end: float, depth_m: float, tilt: float) -> Waypoint:
    """Return the move that takes the side of the lid from one angle to another without rotating the gripper."""
    X_1, contact = _under_side(scene, start, depth_m, tilt)
    X_2, _ = _under_side(scene, end, depth_m, tilt)
    X_BH = scene.site("box", "hinge")
    return closed_waypoint(
        X_2, arc=Arc(point=X_BH[:3, 3] + X_1[:3, 3] - contact, axis=-X_BH[:3, 1], angle_rad=end - start)
    )


def _push_side(scene: Scene, angle: float) -> list[Waypoint]:
    """Push a lid opened by `angle` fully open from under its side, and retreat."""
    push = _carry_side(scene, angle, GOAL_FRACTION * scene.size("box", "open_rad"), SIDE_DEPTH_M, SIDE_TILT_RAD)
    away = shift(push.X_BG, scene.site("box", "hinge")[:3, :3] @ [RETREAT_M, 0.0, 0.02])
    start, _ = _under_side(scene, angle, SIDE_DEPTH_M, SIDE_TILT_RAD)
    return [closed_waypoint(start, through=True), push, closed_waypoint(away)]


def _approach_side(X: Array) -> list[Waypoint]:
    """Return the way to a pose under the side of the lid, from outside and above."""
    outwards = -X[:3, 2] * [1.0, 1.0, 0.0]
    outwards /= np.linalg.norm(outwards)
    before = shift(X, 0.04 * outwards)
    return closed_passage(lift(shift(before, 0.05 * outwards), 0.05), before)


def open_ajar_side(scene: Scene) -> list[Waypoint]:
    """Put the fingertips under the side of the lid and push it open."""
    angle = scene.joints["box"]
    inside, _ = _under_side(scene, angle, SIDE_DEPTH_M, SIDE_TILT_RAD)
    return [*_approach_side(inside), *_push_side(scene, angle)]


def open_shut_side(scene: Scene) -> list[Waypoint]:
    """Pry the lid up at its side, then put the fingertips deeper under it and push it open."""
    tilt = PRY_SIDE_TILT_RAD
    depth = (scene.size("box", "overhang_m") - BESIDE_WALL_M) / np.sin(tilt)
    under, _ = _under_side(scene, 0.0, depth, tilt)
    pry = _carry_side(scene, 0.0, PRIED_RAD, depth, tilt)
    return [*_approach_side(under), closed_waypoint(under), pry, *_push_side(scene, PRIED_RAD)]


def close_lying(scene: Scene) -> list[Waypoint]:
    """Fold the lid of a lying box shut from outside, press, and retreat."""
    X_BH = scene.site("box", "hinge")
    angle = scene.joints["box"]
    R_BH = X_BH[:3, :3]
    height = X_BH[2, 3] + 0.5 * scene.size("box", "width_m") - BELOW_EDGE_M
    R = _rotation(scene, np.array([0.0, 0.0, -1.0]), R_BH[:, 0])

    def outside(angle: float, gap_m: float) -> Array:
        """Return the TCP pose with the fingers outside the lid opened by `angle`, at a gap."""
        out = np.array([np.cos(angle), 0.0, np.sin(angle)])
        normal = np.array([-np.sin(angle), 0.0, np.cos(angle)])
        half = HALF_TIP_M * abs(normal[2]) + HALF_Y_M * abs(normal[0])
        p_H = PRESS_FRACTION * scene.size("box", "lid_m") * out
        p_H = p_H + (scene.size("box", "lid_thickness_m") + half + gap_m) * normal
        p = X_BH[:3, 3] + R_BH @ p_H
        return make_pose(R, [p[0], p[1], height])

    start = outside(angle, 0.004)
    last = outside(0.0, -PRESS_M)
    before = outside(angle, 0.05)
    return [
        *closed_passage(lift(scene.X_BG, 0.04), lift(before, 0.09), before, start),
        closed_waypoint(last, arc=_opening_arc(scene, -angle)),
        closed_waypoint(shift(last, 0.05 * R_BH[:, 2]), through=True),
        closed_waypoint(lift(shift(last, 0.06 * R_BH[:, 2]), 0.08)),
    ]


EXPERTS = {
    "CloseBox-v1": close_lying,
    "OpenBoxEasy-v1": open_ajar_side,
    "OpenBoxEasy-v2": open_ajar_front,
    "OpenBoxHard-v1": open_shut_side,
    "OpenBoxHard-v2": open_shut_front,
}
"""Experts of this family by task id."""
