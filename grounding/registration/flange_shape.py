"""Contours at the flange: those of the last links and, where its CAD model is known, of the gripper."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from kinebench_drake.geometry import Array, make_pose, rotation_z
from kinebench_drake.grounding.registration.edges import EdgeMatcher, GradientImage
from kinebench_drake.models.panda.robot import RobotPart
from kinebench_drake.models.robotiq.cad import CLOSED_RAD, robotiq_mesh

OPENINGS = 5
"""Openings at which the contours of a gripper are known, from open to closed."""
_TOLERANCE_PX = 2.0  # standard deviation of the gripper's contours: openings between two of them fit either
_GRIPPER = (RobotPart.HAND,)
_BODY_RADIUS_M, _BODY_LENGTH_M = 0.038, 0.09  # body that hides the flange where an unknown gripper would


@dataclass(frozen=True, slots=True, kw_only=True)
class FlangeShape:
    """Contours that tell where the flange is: of the links alone, or with a gripper at one or several openings."""

    edges: tuple[EdgeMatcher, ...]
    """One for each opening."""
    gripper: tuple[RobotPart, ...] = ()
    """Parts whose contours count besides those of the links."""

    def agreement(self, image: GradientImage, X_CP: Array, links: tuple[RobotPart, ...]) -> float:
        """Return the share of the contours of `links` on edges of the image, or its mean with that of the gripper.

        A hidden gripper has none on edges: a posture that hides one must not look better.

        Args:
            image: gradients of the image.
            X_CP: (PARTS, 4, 4) poses of the parts in the camera frame [m].
            links: links whose contours count.
        """
        of_links = self.edges[0].agreement(image, X_CP, links)
        return float(0.5 * (of_links + self.gripper_agreement(image, X_CP).max())) if self.gripper else of_links

    def gripper_agreement(self, image: GradientImage, X_CP: Array) -> Array:
        """Return the share (OPENINGS,) of the gripper's contours on edges of the image.

        Args:
            image: gradients of the image.
            X_CP: (PARTS, 4, 4) poses of the parts in the camera frame [m].
        """
        return np.array([edges.agreement(image, X_CP, self.gripper, _TOLERANCE_PX) for edges in self.edges])

    def at_likeliest(self, image: GradientImage, X_CP: Array) -> "FlangeShape":
        """Return the shape at the opening alone whose contours lie best on edges of the image."""
        if len(self.edges) == 1:
            return self
        return replace(self, edges=(self.edges[int(self.gripper_agreement(image, X_CP).argmax())],))


def links_shape() -> FlangeShape:
    """Return the shape of the links alone; a round body hides them where an unknown gripper would.

    Raises:
        SetupError: Open3D's native libraries or mani_skill's meshes are missing.
    """
    body = trimesh.creation.cylinder(_BODY_RADIUS_M, _BODY_LENGTH_M)
    return FlangeShape(edges=(EdgeMatcher({_GRIPPER[0]: body.apply_translation([0.0, 0.0, _BODY_LENGTH_M / 2])}),))


def robotiq_shape(turn_rad: float, offset_m: float, openings: int = OPENINGS) -> FlangeShape:
    """Return the shape of a Robotiq 2F-85 on the flange, at some openings.

    Args:
        turn_rad: turn of its mounting face against panda_hand, about z [rad].
        offset_m: its distance from panda_hand along z, the thickness of an adapter [m].
        openings: number of openings, evenly spaced in the turn of its knuckles.

    Raises:
        SetupError: Open3D's native libraries or mani_skill's meshes are missing.
    """
    X_HR = make_pose(rotation_z(turn_rad), [0.0, 0.0, offset_m])
    meshes = [robotiq_mesh(knuckle).apply_transform(X_HR) for knuckle in np.linspace(0.0, CLOSED_RAD, openings)]
    return FlangeShape(edges=tuple(EdgeMatcher({_GRIPPER[0]: mesh}) for mesh in meshes), gripper=_GRIPPER)
