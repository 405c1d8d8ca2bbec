"""Experts for the tasks with boxes with hinged lids: the closed fingers as a lever under or against the lid.

Everything is reckoned in the hinge's frame H: x from the hinge to the front of the box, y along the hinge, z out of the
opening. The lid, `angle` open, lies along (cos, 0, sin) from the hinge.
"""

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.experts.grasp import CLOSED_M, HALF_TIP_M, grasp_rotation, raised, shifted, swung
from kinebench_drake.suites.experts.motion import Arc, Waypoint
from kinebench_drake.suites.tasks.task import Scene

TIP_M, HALF_Y_M = 0.0092, 0.0150
"""The closed fingertips as lids meet them: how far they reach below the TCP, and half their size along the closing
axis."""
BESIDE_WALL_M = 0.003
"""Gap between the fingertips under a rim and the wall of the box."""
CLEAR_M = 0.002
"""Gap between lid and fingers before these push."""
PRIED_RAD = np.radians(30.0)
"""How far the lid is pried open before the fingers go deeper under it."""
RETREAT_M = 0.09
"""How far the gripper draws back from an open lid."""
GOAL_PART = 0.97
"""Part of its range to which the lid is pushed open."""


def _hinge(scene: Scene) -> Array:
    return scene.site("box", "hinge")


def _hand(scene: Scene, approach: Array, closing: Array) -> Array:
    """Rotation of the gripper; of the two that look the same the one nearer to now."""
    return grasp_rotation(approach, closing if closing @ scene.X_BG[:3, 1] > 0.0 else -closing)


def _go(X: Array, *, through: bool = False, arc: Arc | None = None, pace: float = 1.0) -> Waypoint:
    return Waypoint(X_BG=X, finger_width_m=CLOSED_M, through=through, arc=arc, pace=pace)


def _under_front(scene: Scene, angle: float, depth_m: float, tilt: float) -> Array:
    """TCP pose with the fingertips under the front edge of a lid that is `angle` [rad] open.

    Args:
        scene: where the box is.
        angle: of the lid.
        depth_m: from the lid's edge to the tip.
        tilt: angle [rad] between the fingers and the lid, positive if the hand is above it.
    """
    X_BH = _hinge(scene)
    out = np.array([np.cos(angle), 0.0, np.sin(angle)])
    below = np.array([np.sin(angle), 0.0, -np.cos(angle)])
    up_finger = np.cos(tilt) * out - np.sin(tilt) * below
    to_lid = -np.cos(tilt) * below - np.sin(tilt) * out
    sunk = CLEAR_M + depth_m * max(0.0, np.tan(tilt))
    corner = (scene.size("box", "lid_m") - depth_m) * out + sunk * below
    p_H = corner + TIP_M * up_finger - HALF_Y_M * to_lid
    R_BH = X_BH[:3, :3]
    return make_pose(_hand(scene, -R_BH @ up_finger, R_BH @ to_lid), X_BH[:3, 3] + R_BH @ p_H)


def _lift(scene: Scene, X: Array, angle: float) -> tuple[Array, Arc]:
    """Where the lid takes a pose when it opens by `angle`, and the way there."""
    X_BH = _hinge(scene)
    point, axis = X_BH[:3, 3], -X_BH[:3, 1]
    return swung(X, point, axis, angle), Arc(point=point, axis=axis, angle_rad=angle)


PUSH_DEPTH_M, PUSH_TILT_RAD = 0.022, np.radians(-12.0)
"""How the fingers are under the front edge while they push."""
PRY_TILT_RAD = np.radians(45.0)
"""The same before they pry."""


def _push_front(scene: Scene, angle: float) -> list[Waypoint]:
    """From under the front edge of a lid, `angle` open, until it is fully open, and away."""
    start = _under_front(scene, angle, PUSH_DEPTH_M, PUSH_TILT_RAD)
    goal = GOAL_PART * scene.size("box", "open_rad")
    end, arc = _lift(scene, start, goal - angle)
    R_BH = _hinge(scene)[:3, :3]
    away = R_BH @ [np.sin(goal), 0.0, -np.cos(goal)]
    return [_go(start, through=True), _go(end, arc=arc), _go(shifted(end, RETREAT_M * away))]


def open_ajar_front(scene: Scene) -> list[Waypoint]:
    """Put the fingertips under the front edge of the lid and swing it open."""
    angle = scene.joints["box"]
    inside = _under_front(scene, angle, PUSH_DEPTH_M, PUSH_TILT_RAD)
    R_BH = _hinge(scene)[:3, :3]
    before = shifted(inside, R_BH @ [0.06, 0.0, 0.0])
    return [
        _go(shifted(before, R_BH @ [0.05, 0.0, 0.04]), through=True),
        _go(before, through=True),
        *_push_front(scene, angle),
    ]


def open_shut_front(scene: Scene) -> list[Waypoint]:
    """Pry the lid up at the front edge by turning the gripper up, then swing it open."""
    depth = scene.size("box", "overhang_m") - BESIDE_WALL_M
    under = _under_front(scene, 0.0, depth, PRY_TILT_RAD)
    R_BH = _hinge(scene)[:3, :3]
    before = shifted(under, R_BH @ [0.04, 0.0, 0.0])
    pried = _under_front(scene, PRIED_RAD, depth, PUSH_TILT_RAD)
    arc = _lift(scene, under, PRIED_RAD)[1]
    return [
        _go(shifted(before, R_BH @ [0.05, 0.0, 0.05]), through=True),
        _go(before, through=True),
        _go(under),
        _go(pried, arc=arc, pace=1.3),
        *_push_front(scene, PRIED_RAD),
    ]


SIDE_TILT_RAD, PRY_SIDE_TILT_RAD = np.radians(60.0), np.radians(48.0)
"""Angle of the fingers from the vertical while they push at the side of a lid, and while they pry."""
SIDE_DEPTH_M = 0.024
"""How far along them the fingers are under the side while they push."""
SIDE_FROM_FRONT_M = 0.03
"""Where along the side they do: how far behind the front edge."""


def _under_side(scene: Scene, angle: float, depth_m: float, tilt: float) -> tuple[Array, Array]:
    """TCP pose with the fingertips under the side of a lid that is `angle` [rad] open, and where they touch it (3,).

    Args:
        scene: where the box is.
        angle: of the lid.
        depth_m: from the lid's edge to the tip, along the fingers.
        tilt: of the fingers from the vertical.
    """
    X_BH = _hinge(scene)
    side = -1.0 if X_BH[:3, 1] @ [0.0, X_BH[1, 3], 0.0] > 0.0 else 1.0  # towards the middle, where there is more room
    out = np.array([np.cos(angle), 0.0, np.sin(angle)])
    edge = side * (0.5 * scene.size("box", "width_m") + scene.size("box", "overhang_m"))
    touch = (scene.size("box", "lid_m") - SIDE_FROM_FRONT_M) * out + [0.0, edge, 0.0]
    up_finger = np.array([0.0, side * np.sin(tilt), np.cos(tilt)])
    to_lid = np.array([0.0, -side * np.cos(tilt), np.sin(tilt)])
    p_H = touch + (TIP_M - depth_m) * up_finger - (HALF_Y_M + CLEAR_M) * to_lid + [HALF_TIP_M, 0.0, 0.0]
    R_BH = X_BH[:3, :3]
    X = make_pose(_hand(scene, -R_BH @ up_finger, R_BH @ to_lid), X_BH[:3, 3] + R_BH @ p_H)
    return X, X_BH[:3, 3] + R_BH @ touch


def _carry_side(scene: Scene, start: float, end: float, depth_m: float, tilt: float) -> Waypoint:
    """The move that takes the side of the lid from one angle to another; the gripper keeps its direction."""
    X_1, touch = _under_side(scene, start, depth_m, tilt)
    X_2, _ = _under_side(scene, end, depth_m, tilt)
    X_BH = _hinge(scene)
    arc = Arc(point=X_BH[:3, 3] + X_1[:3, 3] - touch, axis=-X_BH[:3, 1], angle_rad=end - start)
    return _go(X_2, arc=arc)


def _push_side(scene: Scene, angle: float) -> list[Waypoint]:
    """From under the side of a lid, `angle` open, until it is fully open, and away."""
    goal = GOAL_PART * scene.size("box", "open_rad")
    push = _carry_side(scene, angle, goal, SIDE_DEPTH_M, SIDE_TILT_RAD)
    away = shifted(push.X_BG, _hinge(scene)[:3, :3] @ [RETREAT_M, 0.0, 0.02])
    return [_go(_under_side(scene, angle, SIDE_DEPTH_M, SIDE_TILT_RAD)[0], through=True), push, _go(away)]


def _beside(scene: Scene, X: Array) -> list[Waypoint]:
    """The way to a pose under the side of the lid, from outside and above."""
    outwards = -X[:3, 2] * [1.0, 1.0, 0.0]
    outwards /= np.linalg.norm(outwards)
    before = shifted(X, 0.04 * outwards)
    return [_go(raised(shifted(before, 0.05 * outwards), 0.05), through=True), _go(before, through=True)]


def open_ajar_side(scene: Scene) -> list[Waypoint]:
    """Put the fingertips under the side of the lid and swing it open."""
    angle = scene.joints["box"]
    inside, _ = _under_side(scene, angle, SIDE_DEPTH_M, SIDE_TILT_RAD)
    return [*_beside(scene, inside), *_push_side(scene, angle)]


def open_shut_side(scene: Scene) -> list[Waypoint]:
    """Pry the lid up at its side, then put the fingertips deeper under it and swing it open."""
    tilt = PRY_SIDE_TILT_RAD
    depth = (scene.size("box", "overhang_m") - BESIDE_WALL_M) / np.sin(tilt)
    under, _ = _under_side(scene, 0.0, depth, tilt)
    pry = _carry_side(scene, 0.0, PRIED_RAD, depth, tilt)
    return [*_beside(scene, under), _go(under), pry, *_push_side(scene, PRIED_RAD)]


def close_lying(scene: Scene) -> list[Waypoint]:
    """Fold the lid of a lying box shut from outside, press, and go back."""
    X_BH, angle = _hinge(scene), scene.joints["box"]
    R_BH = X_BH[:3, :3]
    height = X_BH[2, 3] + 0.5 * scene.size("box", "width_m") - REACH_DOWN_M
    R = _hand(scene, np.array([0.0, 0.0, -1.0]), R_BH[:, 0])

    def outside(angle: float, gap_m: float) -> Array:
        out = np.array([np.cos(angle), 0.0, np.sin(angle)])
        normal = np.array([-np.sin(angle), 0.0, np.cos(angle)])
        half = HALF_TIP_M * abs(normal[2]) + HALF_Y_M * abs(normal[0])
        p_H = CLOSE_PART * scene.size("box", "lid_m") * out
        p_H = p_H + (scene.size("box", "lid_thickness_m") + half + gap_m) * normal
        p = X_BH[:3, 3] + R_BH @ p_H
        return make_pose(R, [p[0], p[1], height])

    at, last = outside(angle, 0.004), outside(0.0, -PRESS_M)
    before = outside(angle, 0.05)
    arc = Arc(point=X_BH[:3, 3], axis=-X_BH[:3, 1], angle_rad=-angle)
    return [
        _go(raised(scene.X_BG, 0.04), through=True),
        _go(raised(before, 0.09), through=True),
        _go(before, through=True),
        _go(at, through=True),
        _go(last, arc=arc),
        _go(shifted(last, 0.05 * R_BH[:, 2]), through=True),
        _go(raised(shifted(last, 0.06 * R_BH[:, 2]), 0.08)),
    ]


REACH_DOWN_M = 0.030
"""How far below the upper edge of a lying box's lid the TCP is: as far as the palm stays clear of it."""
CLOSE_PART = 0.78
"""Where the fingers press on the lid: part of the way from its hinge to its edge."""
PRESS_M = 0.003
"""How far past shut they are told to press."""


EXPERTS = {
    "CloseBox-v1": close_lying,
    "OpenBoxEasy-v1": open_ajar_side,
    "OpenBoxEasy-v2": open_ajar_front,
    "OpenBoxHard-v1": open_shut_side,
    "OpenBoxHard-v2": open_shut_front,
}
"""Experts of this family by task id."""
