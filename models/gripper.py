"""Grippers as data: bodies with their meshes, how far and along which linkage their fingers move.

The frame H of a gripper has z along the fingers, which open along y: the left one towards +y. That of the Franka hand
is panda_hand, that of another gripper its mounting face.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, invert, make_pose, transform_points
from kinebench_drake.models.panda.description import GRIPPER, OPENING_SIGN, RobotPart

PARTS = len(RobotPart)
"""Number of parts; the bodies of a gripper that are no parts of their own come after them."""

X_HALF_TURN = make_pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
"""Pose (4, 4) of a flipped gripper in its frame: 180 degrees about z."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Parallelogram:
    """Linkage of a finger that keeps its direction while knuckles turn about axes parallel to x."""

    lever_m: float
    """Distance between the axes at both ends of a knuckle [m]."""
    offset_m: float
    """Distance of the finger's axis from the knuckle's along y, with the gripper closed [m]."""

    def turn(self, finger_m: ArrayLike) -> Array:
        """Return the turn (...) of a left knuckle about x from closed to open by `finger_m` (...) [rad]."""
        reach = np.asarray(finger_m, dtype=np.float64) + self.offset_m
        return np.asarray(np.arcsin(self.offset_m / self.lever_m) - np.arcsin(reach / self.lever_m))

    def lift(self, finger_m: ArrayLike) -> Array:
        """Return the shift (...) of a finger along z from closed to open by `finger_m` (...) [m]."""
        reach = np.asarray(finger_m, dtype=np.float64) + self.offset_m
        return np.asarray(np.sqrt(self.lever_m**2 - reach**2) - np.sqrt(self.lever_m**2 - self.offset_m**2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Knuckle:
    """Body that turns with a finger."""

    mesh: trimesh.Trimesh
    """Mesh in H, closed."""
    sign: float
    """1 on the left side, -1 on the right one."""
    axis_H: Array
    """(3,) point on its axis [m]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GripperModel:
    """Shape of a gripper at any opening."""

    parts: Mapping[RobotPart, trimesh.Trimesh]
    """Meshes of hand, left and right finger in H, closed."""
    max_finger_m: float
    """Greatest travel of each finger [m]; the gap between the pads is twice the travel."""
    linkage: Parallelogram | None = None
    """Linkage of the fingers; None if they slide along y."""
    knuckles: tuple[Knuckle, ...] = ()
    """Further bodies; their pixels count as the hand."""
    X_MH: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of H in panda_hand [m]: how it is mounted."""
    is_symmetric: bool = False
    """Whether it looks the same after half a turn about z: then links alone tell which way round it is."""
    mounts_vary: bool = False
    """Whether robots carry it in several ways, so that each video has to tell."""

    @property
    def meshes(self) -> dict[int, trimesh.Trimesh]:
        """Meshes by the index of their body, in H, closed: parts of the gripper, then knuckles from `PARTS` on."""
        return {int(part): mesh for part, mesh in self.parts.items()} | {
            PARTS + k: knuckle.mesh for k, knuckle in enumerate(self.knuckles)
        }

    @property
    def part_of(self) -> NDArray[np.uint8]:
        """(BODIES,) values of `RobotPart` that pixels of a body show."""
        return np.array([*range(PARTS), *[RobotPart.HAND] * len(self.knuckles)], dtype=np.uint8)

    def bodies_of(self, parts: Sequence[RobotPart]) -> tuple[int, ...]:
        """Return the bodies of some parts of the robot; knuckles move with the fingers."""
        moves = any(OPENING_SIGN.get(part) for part in parts)
        return (*parts, *(range(PARTS, PARTS + len(self.knuckles)) if moves else ()))

    def complete(self, X_VP: Array) -> Array:
        """Return the poses (BODIES, 4, 4) of all bodies; of the parts alone (PARTS, 4, 4), with the gripper closed."""
        return X_VP if self.linkage is None or len(X_VP) > PARTS else self.open(X_VP, 0.0)

    def in_parts(self, body: NDArray[np.integer[Any]], p_B: Array, p_C: Array, X_CB: Array) -> Array:
        """Return the points (N, 3) of moved bodies in the frames of the parts that they count as [m].

        What does not move along y with the fingers counts as it stands: the turn of knuckles, the lift of fingers.

        Args:
            body: (N,) bodies.
            p_B: (N, 3) points in their frames [m].
            p_C: (N, 3) the same in the camera frame [m].
            X_CB: (BODIES, 4, 4) poses of the bodies in the camera frame [m].
        """
        X_HC = invert(X_CB[RobotPart.HAND])
        in_hand = transform_points(X_HC, p_C)
        knuckle = body >= PARTS
        finger = np.isin(body, (RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER))
        lift = X_HC[2, :3] @ (X_CB[RobotPart.LEFT_FINGER, :3, 3] - X_CB[RobotPart.HAND, :3, 3])
        return np.where(knuckle[:, None], in_hand, p_B + finger[:, None] * np.array([0.0, 0.0, lift]))

    def open(self, X_VP: Array, finger_m: ArrayLike) -> Array:
        """Return the poses (..., BODIES, 4, 4) of all bodies with each finger moved by a travel.

        Args:
            X_VP: (..., PARTS, 4, 4) poses of the parts in any frame V, gripper closed [m].
            finger_m: (...) travel of each finger [m].
        """
        travel = np.asarray(finger_m, dtype=np.float64)[..., None]
        lift = 0.0 if self.linkage is None else self.linkage.lift(travel)
        opened = X_VP.copy()
        for part in GRIPPER:
            if sign := OPENING_SIGN[part]:
                X_VH = X_VP[..., part, :, :]
                opened[..., part, :3, 3] += sign * travel * X_VH[..., :3, 1] + lift * X_VH[..., :3, 2]
        if self.linkage is None:
            return opened
        turn = self.linkage.turn(travel[..., 0])
        turned = [X_VP[..., RobotPart.HAND, :, :] @ _turned(knuckle, turn) for knuckle in self.knuckles]
        return np.concatenate([opened, np.stack(turned, axis=-3)], axis=-3)


def _turned(knuckle: Knuckle, turn_rad: Array) -> Array:
    """Return the poses (..., 4, 4) of a knuckle in H at turns (...) from closed."""
    angle = knuckle.sign * turn_rad
    R = np.zeros((*angle.shape, 3, 3))
    R[..., 0, 0] = 1.0
    R[..., 1, 1] = R[..., 2, 2] = np.cos(angle)
    R[..., 2, 1] = np.sin(angle)
    R[..., 1, 2] = -np.sin(angle)
    return make_pose(R, knuckle.axis_H - R @ knuckle.axis_H)
