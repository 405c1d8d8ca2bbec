"""Experts for the tasks with laptops.

They think in the upright plane across the hinge: forward from the hinge to the laptop's user, and up. The fingers lie
in that plane, spread forward and back, tilted by an angle from pointing straight down towards the hinge.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.experts.grasp import CLOSED_M, OPEN_M, TIP_M, grasp_rotation, shifted
from kinebench_drake.suites.experts.motion import Arc, Waypoint
from kinebench_drake.suites.tasks.task import Scene

FINGER_M = 0.0152
"""How thick one fingertip is along the closing axis."""
TILT_RAD = np.deg2rad(40.0)
"""Tilt of the hand while a fingertip lifts the lid's edge."""
TABLE_M = 0.004
"""Room left between fingertip and table."""
UNDER_M = 0.006
"""How far under the lid's edge the fingertip is put at most."""
BELOW_M = 0.006
"""How far below the edge of a lid that stands open the fingertip goes in."""
WEDGE_M = 0.002
"""How far under the edge it goes from where its slant would touch: so much it lifts by wedging."""
HOLD_M = 0.016
"""How far from the lid's edge the fingertip pushes it."""
TURN_RAD = np.deg2rad(46.0)
"""Lid angle from which on the hand turns with the lid."""
OPENED_RAD = np.deg2rad(108.0)
"""Lid angle to which the expert opens."""
PRESS_M = 0.003
"""How far the fingertips are sent below the shut lid's outside."""
BEHIND_M = 0.022
"""How far below the upper edge of a wide open lid the fingertips reach behind it."""
OVER_M = 0.05
"""How far above that edge the TCP passes over it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Hinge:
    """A laptop's hinge and the plane across it."""

    point: Array
    """(3,) middle of the axis in B [m]."""
    forward: Array
    """(3,) level unit vector in B across the axis, towards where a shut lid's edge is."""
    closing: Array
    """(3,) `forward` or its opposite: which of the fingers is in front."""

    @classmethod
    def of(cls, scene: Scene) -> "_Hinge":
        X_BS = scene.site("laptop", "hinge")
        forward = X_BS[:3, 0]
        return cls(
            point=X_BS[:3, 3], forward=forward, closing=forward * (1.0 if forward @ scene.X_BG[:3, 1] >= 0.0 else -1.0)
        )

    def direction(self, forward_up: ArrayLike) -> Array:
        """(3,) in B of a vector (2,) forward and up."""
        f, u = np.asarray(forward_up, dtype=np.float64)
        return np.asarray(f * self.forward + [0.0, 0.0, u])

    def hand(self, corner: ArrayLike, tilt_rad: float, width_m: float, *, front: bool) -> Array:
        """Pose (4, 4) of the TCP that brings an edge of a fingertip to a place (2,) forward and up of the axis [m].

        `front`: the front finger's edge in front; else that edge of it that the lid lies on when it is lifted.
        """
        s, c = np.sin(tilt_rad), np.cos(tilt_rad)
        approach, out = np.array([-s, -c]), np.array([c, -s])
        aside = 0.5 * width_m + (FINGER_M if front else 0.0)
        tcp = np.asarray(corner, dtype=np.float64) - TIP_M * approach - aside * out
        return make_pose(grasp_rotation(self.direction(approach), self.closing), self.point + self.direction(tcp))

    def place(self, X_BG: Array) -> Array:
        """(2,) forward and up of the axis [m]: where the TCP is."""
        offset = X_BG[:3, 3] - self.point
        return np.array([self.forward @ offset, offset[2]])

    def arc(self, angle_rad: float, moved: ArrayLike = (0.0, 0.0)) -> Arc:
        """The turn that opens the lid by an angle, about the axis moved (2,) forward and up."""
        axis = np.cross(self.forward, [0.0, 0.0, 1.0])
        return Arc(point=self.point + self.direction(moved), axis=axis, angle_rad=angle_rad)


def _on_lid(angle_rad: float, along_m: float, height_m: float) -> Array:
    """(2,) forward and up of the axis [m]: a place of the lid, along it and above it as if it were shut."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([along_m * c - height_m * s, along_m * s + height_m * c])


def _moved(place: Array, forward_m: float, up_m: float) -> Array:
    return np.asarray(place + np.array([forward_m, up_m]))


def open_laptop(scene: Scene) -> list[Waypoint]:
    """Put the tip of one finger under the lid's edge, lift it, then swing the hand with it about the hinge."""
    hinge, angle = _Hinge.of(scene), scene.joints["laptop"]
    reach, inside = scene.size("laptop", "reach_m"), scene.size("laptop", "inside_m")
    edge = _on_lid(angle, reach, inside)
    height = max(edge[1] - BELOW_M, TABLE_M + FINGER_M * np.sin(TILT_RAD) - hinge.point[2])
    under = np.array([edge[0] - min(UNDER_M, (edge[1] - height) * np.tan(TILT_RAD) + WEDGE_M), height])
    turn = max(TURN_RAD, angle + 0.2)
    corner = _on_lid(turn, reach - HOLD_M, inside - 0.001)
    poses = [
        hinge.hand(place, TILT_RAD, OPEN_M, front=False)
        for place in (_moved(under, 0.05, 0.07), _moved(under, 0.02, 0.0), under, corner)
    ]
    X_lifted, tilt = poses[-1], TILT_RAD - (OPENED_RAD - turn)
    lifting = hinge.arc(turn - angle, hinge.place(X_lifted) - corner)
    opened, away = (
        hinge.hand(_on_lid(OPENED_RAD, reach - HOLD_M, inside - gap), tilt, OPEN_M, front=False)
        for gap in (0.001, 0.02)
    )
    up = shifted(away, hinge.direction([0.03, 0.09]))
    return [
        Waypoint(X_BG=poses[0], finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=poses[1], finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=poses[2], finger_width_m=OPEN_M, pace=1.5),
        Waypoint(X_BG=X_lifted, finger_width_m=OPEN_M, arc=lifting, through=True),
        Waypoint(X_BG=opened, finger_width_m=OPEN_M, arc=hinge.arc(OPENED_RAD - turn), pace=1.3),
        Waypoint(X_BG=away, finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=up, finger_width_m=OPEN_M),
    ]


def close_laptop_easy(scene: Scene) -> list[Waypoint]:
    """Press the lid down with shut fingers until it lies on the base."""
    hinge, angle = _Hinge.of(scene), scene.joints["laptop"]
    along, outside = scene.size("laptop", "reach_m") - 0.03, scene.size("laptop", "outside_m")
    return [
        *_above(hinge, _on_lid(angle, along, outside), 0.07),
        *_press(hinge, angle, along, outside),
    ]


def close_laptop_hard(scene: Scene) -> list[Waypoint]:
    """Reach behind the lid with shut fingers, bring it forward over the vertical, then press it down."""
    hinge, angle = _Hinge.of(scene), scene.joints["laptop"]
    reach, outside = scene.size("laptop", "reach_m"), scene.size("laptop", "outside_m")
    upright = np.pi / 2.0
    if angle < upright:
        return close_laptop_easy(scene)
    behind = _moved(_on_lid(angle, reach, outside), 0.0, -BEHIND_M)
    over = scene.X_BG.copy()
    over[2, 3] = max(over[2, 3], hinge.point[2] + behind[1] + BEHIND_M + OVER_M)
    waypoints = [
        Waypoint(X_BG=X_BG, finger_width_m=CLOSED_M, through=True)
        for X_BG in (
            over,
            hinge.hand(_moved(behind, -0.04, 0.05), 0.0, CLOSED_M, front=True),
            hinge.hand(_moved(behind, -0.02, 0.0), 0.0, CLOSED_M, front=True),
            hinge.hand(behind, 0.0, CLOSED_M, front=True),
        )
    ]
    straight = hinge.hand(_on_lid(upright, reach - BEHIND_M, outside), 0.0, CLOSED_M, front=True)
    moved = hinge.place(straight) - _on_lid(upright, reach, outside)
    waypoints.append(
        Waypoint(X_BG=straight, finger_width_m=CLOSED_M, arc=hinge.arc(upright - angle, moved), through=True)
    )
    return [*waypoints, *_press(hinge, upright, reach - BEHIND_M, outside)]


def _above(hinge: _Hinge, corner: Array, height_m: float) -> list[Waypoint]:
    """Come down to just above a place (2,) of the lid."""
    return [
        Waypoint(
            X_BG=hinge.hand(_moved(corner, 0.0, z), 0.0, CLOSED_M, front=True), finger_width_m=CLOSED_M, through=True
        )
        for z in (height_m, 0.01)
    ]


def _press(hinge: _Hinge, angle_rad: float, along_m: float, outside_m: float) -> list[Waypoint]:
    """Turn the lid shut from an angle with the fingertips at a place along it, then leave."""
    corner = _on_lid(0.0, along_m, outside_m)
    shut = hinge.hand(_moved(corner, 0.0, -PRESS_M), 0.0, CLOSED_M, front=True)
    moved = _moved(hinge.place(shut) - corner, 0.0, PRESS_M)
    return [
        Waypoint(X_BG=shut, finger_width_m=CLOSED_M, arc=hinge.arc(-angle_rad, moved), pace=1.2),
        Waypoint(X_BG=hinge.hand(_moved(corner, 0.0, 0.12), 0.0, CLOSED_M, front=True), finger_width_m=CLOSED_M),
    ]


EXPERTS = {
    "CloseLaptopEasy-v1": close_laptop_easy,
    "CloseLaptopHard-v1": close_laptop_hard,
    "OpenLaptopEasy-v1": open_laptop,
    "OpenLaptopHard-v1": open_laptop,
}
"""Experts of this family by task id."""
