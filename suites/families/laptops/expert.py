"""Experts for the tasks with laptops.

Points are given in the vertical plane across the hinge: forward from the hinge to the laptop's user, and up, relative
to the hinge's axis. The fingers lie in that plane, one in front of the other; their tilt is the angle from pointing
straight down, with the fingertips towards the hinge.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.expert.grasp import (
    OPEN_M,
    TIP_M,
    closed_passage,
    closed_waypoint,
    grasp_rotation,
    shift,
)
from kinebench_drake.suites.expert.motion import Arc, Waypoint
from kinebench_drake.suites.families.task import Scene

FINGER_M = 0.0152
"""Thickness of one fingertip along the closing axis."""
TILT_RAD = np.deg2rad(40.0)
"""Tilt of the hand while a fingertip lifts the lid's edge."""
BELOW_M = 0.006
"""Depth of the fingertip below the edge of a lid that is ajar."""
HOLD_M = 0.016
"""Distance from the lid's edge at which the fingertip pushes it."""
OPENED_RAD = np.deg2rad(108.0)
"""Opening to which the lid is pushed."""
PRESS_M = 0.003
"""Commanded depth of the fingertips below the shut lid's outer face."""
BEHIND_M = 0.022
"""Depth below the upper edge of a wide open lid to which the fingertips reach behind it."""
OVER_M = 0.05
"""Height above that edge at which the TCP passes over it."""
TABLE_GAP_M = 0.004
"""Gap between fingertip and table."""
UNDER_M = 0.006
"""Greatest depth of the fingertip under the lid's edge."""
WEDGE_M = 0.002
"""Depth under the edge beyond the first contact of the slanted finger, which lifts the lid by wedging."""
TURN_RAD = np.deg2rad(46.0)
"""Least opening from which on the hand rotates with the lid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _HingePlane:
    """The vertical plane across a laptop's hinge."""

    point: Array
    """(3,) middle of the axis in B [m]."""
    forward: Array
    """(3,) horizontal unit vector in B across the axis, towards the edge of a shut lid."""
    closing: Array
    """(3,) closing direction: `forward` or its opposite, whichever is closer to the current one."""

    @classmethod
    def of(cls, scene: Scene) -> "_HingePlane":
        """Return the plane of a scene's laptop."""
        X_BS = scene.site("laptop", "hinge")
        forward = X_BS[:3, 0]
        return cls(
            point=X_BS[:3, 3], forward=forward, closing=forward * (1.0 if forward @ scene.X_BG[:3, 1] >= 0.0 else -1.0)
        )

    def direction(self, forward_up: ArrayLike) -> Array:
        """Return the vector (3,) in B of a vector (2,) in the plane."""
        f, u = np.asarray(forward_up, dtype=np.float64)
        return np.asarray(f * self.forward + [0.0, 0.0, u])

    def open_pose(self, corner: ArrayLike, tilt_rad: float) -> Array:
        """Return the TCP pose (4, 4) of open fingers whose rear tip has its lifting edge at `corner` (2,)."""
        return self._tcp(corner, tilt_rad, 0.5 * OPEN_M)

    def closed_pose(self, corner: ArrayLike) -> Array:
        """Return the TCP pose (4, 4) of closed, vertical fingers with the front edge of the tips at `corner` (2,)."""
        return self._tcp(corner, 0.0, FINGER_M)

    def _tcp(self, corner: ArrayLike, tilt_rad: float, offset_m: float) -> Array:
        s = np.sin(tilt_rad)
        c = np.cos(tilt_rad)
        approach = np.array([-s, -c])
        tcp = np.asarray(corner, dtype=np.float64) - TIP_M * approach - offset_m * np.array([c, -s])
        return make_pose(grasp_rotation(self.direction(approach), self.closing), self.point + self.direction(tcp))

    def project(self, X_BG: Array) -> Array:
        """Return the position (2,) of the TCP in the plane [m]."""
        offset = X_BG[:3, 3] - self.point
        return np.array([self.forward @ offset, offset[2]])

    def arc(self, angle_rad: float, offset: ArrayLike = (0.0, 0.0)) -> Arc:
        """Return the rotation that opens the lid by an angle, about the axis displaced by `offset` (2,)."""
        return Arc(
            point=self.point + self.direction(offset), axis=np.cross(self.forward, [0.0, 0.0, 1.0]), angle_rad=angle_rad
        )


def _on_lid(angle_rad: float, along_m: float, height_m: float) -> Array:
    """Return a point (2,) of a lid opened by an angle, from its distance along the lid and height above it if shut."""
    c = np.cos(angle_rad)
    s = np.sin(angle_rad)
    return np.array([along_m * c - height_m * s, along_m * s + height_m * c])


def open_laptop(scene: Scene) -> list[Waypoint]:
    """Put the tip of one finger under the lid's edge, lift it, then rotate the hand with it about the hinge."""
    plane = _HingePlane.of(scene)
    angle = scene.joints["laptop"]
    reach = scene.size("laptop", "reach_m")
    inside = scene.size("laptop", "inside_m")
    edge = _on_lid(angle, reach, inside)
    height = max(edge[1] - BELOW_M, TABLE_GAP_M + FINGER_M * np.sin(TILT_RAD) - plane.point[2])
    under = np.array([edge[0] - min(UNDER_M, (edge[1] - height) * np.tan(TILT_RAD) + WEDGE_M), height])
    turn = max(TURN_RAD, angle + 0.2)
    corner = _on_lid(turn, reach - HOLD_M, inside - 0.001)
    above, before, start, lifted = (
        plane.open_pose(p, TILT_RAD) for p in (np.add(under, [0.05, 0.07]), np.add(under, [0.02, 0.0]), under, corner)
    )
    tilt = TILT_RAD - (OPENED_RAD - turn)
    lifting = plane.arc(turn - angle, plane.project(lifted) - corner)
    opened, away = (plane.open_pose(_on_lid(OPENED_RAD, reach - HOLD_M, inside - gap), tilt) for gap in (0.001, 0.02))
    return [
        Waypoint(X_BG=above, finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=before, finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=start, finger_width_m=OPEN_M, pace=1.5),
        Waypoint(X_BG=lifted, finger_width_m=OPEN_M, arc=lifting, through=True),
        Waypoint(X_BG=opened, finger_width_m=OPEN_M, arc=plane.arc(OPENED_RAD - turn), pace=1.3),
        Waypoint(X_BG=away, finger_width_m=OPEN_M, through=True),
        Waypoint(X_BG=shift(away, plane.direction([0.03, 0.09])), finger_width_m=OPEN_M),
    ]


def close_laptop_easy(scene: Scene) -> list[Waypoint]:
    """Press the lid down from above with closed fingers until it lies on the base."""
    plane = _HingePlane.of(scene)
    angle = scene.joints["laptop"]
    along = scene.size("laptop", "reach_m") - 0.03
    outside = scene.size("laptop", "outside_m")
    corner = _on_lid(angle, along, outside)
    return [
        *closed_passage(*(plane.closed_pose(np.add(corner, [0.0, z])) for z in (0.07, 0.01))),
        *_press(plane, angle, along, outside),
    ]


def close_laptop_hard(scene: Scene) -> list[Waypoint]:
    """Reach behind the lid with closed fingers, pull it forward over the vertical, then press it down."""
    plane = _HingePlane.of(scene)
    angle = scene.joints["laptop"]
    reach = scene.size("laptop", "reach_m")
    outside = scene.size("laptop", "outside_m")
    upright = np.pi / 2.0
    if angle < upright:
        return close_laptop_easy(scene)
    behind = np.add(_on_lid(angle, reach, outside), [0.0, -BEHIND_M])
    over = scene.X_BG.copy()
    over[2, 3] = max(over[2, 3], plane.point[2] + behind[1] + BEHIND_M + OVER_M)
    approach = [plane.closed_pose(behind + offset) for offset in ([-0.04, 0.05], [-0.02, 0.0], [0.0, 0.0])]
    straight = plane.closed_pose(_on_lid(upright, reach - BEHIND_M, outside))
    offset = plane.project(straight) - _on_lid(upright, reach, outside)
    return [
        *closed_passage(over, *approach),
        closed_waypoint(straight, arc=plane.arc(upright - angle, offset), through=True),
        *_press(plane, upright, reach - BEHIND_M, outside),
    ]


def _press(plane: _HingePlane, angle_rad: float, along_m: float, outside_m: float) -> list[Waypoint]:
    """Rotate the lid shut from an angle with the fingertips at a distance along it, then retreat."""
    corner = _on_lid(0.0, along_m, outside_m)
    shut = plane.closed_pose(np.add(corner, [0.0, -PRESS_M]))
    offset = plane.project(shut) - corner + np.array([0.0, PRESS_M])
    return [
        closed_waypoint(shut, arc=plane.arc(-angle_rad, offset), pace=1.2),
        closed_waypoint(plane.closed_pose(np.add(corner, [0.0, 0.12]))),
    ]


EXPERTS = {
    "CloseLaptopEasy-v1": close_laptop_easy,
    "CloseLaptopHard-v1": close_laptop_hard,
    "OpenLaptopEasy-v1": open_laptop,
    "OpenLaptopHard-v1": open_laptop,
}
"""Experts of this family by task id."""
