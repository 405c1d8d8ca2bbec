"""Edges of the robot's CAD model matched to edges of the image.

Outlines of hand and links are projected at a posture; each visible point searches the image across the
projected edge for the strongest gradient nearby, and the distance to it is a residual across the edge (Harris and
Stennett, "RAPID", BMVC 1990; Drummond and Cipolla, PAMI 2002). It needs no network, so it also works on looks that the
network was not trained on, from a posture that is right within a few pixels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, make_pose, rotation_z
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage
from kinebench_drake.grounding.registration.solver import MIN_POINTS, NEAREST_M, Correspondences, edge_frames
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS
from kinebench_drake.models.panda.cad import PartCaster, link_meshes, part_meshes
from kinebench_drake.models.panda.description import OPENING_SIGN, RobotPart
from kinebench_drake.models.robotiq.cad import CLOSED_RAD, robotiq_mesh

_HIDDEN = 3
"""Points on edges that are cast for each point that is visible."""
_SPACING_PX = 2.0
"""Least distance of the points along an edge [px]."""
_BEHIND_M = 0.01
"""Depth behind the surface beyond which a point is hidden [m]."""
_BULGE_M = 0.03
"""Greatest difference of depth between a contour and the surface beside it [m]."""
_JUMP_M = 0.015
"""Least jump of the depth at a contour [m]."""
_BESIDE_PX = 1.5
"""Distance from the edge at which the jump is measured [px]."""
SIGMA_PX = 0.7
"""Standard deviation of an image edge across itself [px]."""
INDEPENDENT = 120.0
"""Greatest number of independent measurements that the edges of an image count as."""
LEAST_GRADIENT = 6.0
"""Least gradient of an edge, of an image in 0..255 [1/px]."""
_SEARCH_PX = 8.0
"""Reach within which the agreement looks for the strongest edge [px]."""
_ON_CONTOUR_PX = 1.0
"""Standard deviation of the distance between a contour and its edge [px]."""
MAX_POINTS = 700
"""Points on the contours of an image, where they are compared with those of another camera."""
FIT_POINTS = 350
"""Points on the contours that a posture is fitted to."""
ROBOT = tuple(part for part in RobotPart if part is not RobotPart.BACKGROUND)
"""Hand, fingers and links."""
RIGID = tuple(part for part in ROBOT if not OPENING_SIGN.get(part))
"""Hand and links: fingers are often exchanged for others."""
WRIST = (RobotPart.HAND, RobotPart.LINK5, RobotPart.LINK6, RobotPart.LINK7)
FLANGE = (RobotPart.HAND, RobotPart.LINK7)
"""Parts that look different after half a turn of the last joint."""
OPENINGS = 5
"""Openings at which the contours of a gripper are known, from open to closed."""
_TOLERANCE_PX = 2.0
"""The same of a gripper's contours [px]: openings between two of them fit either."""
_GRIPPER = (RobotPart.HAND,)
_BODY_RADIUS_M = 0.038
"""Radius of the body that hides the flange where an unknown gripper would [m]."""
_BODY_LENGTH_M = 0.09
"""Length of this body [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeMesh:
    """Edges between two faces of a part."""

    ends: Array
    """(E, 2, 3) end points in the frame of the part [m]."""
    faces: NDArray[np.int32]
    """(2, E) adjacent faces."""
    normals: Array
    """(F, 3) unit normals of the faces."""
    offsets: Array
    """(F,) distances of the faces' planes from the origin, along their normals [m]."""

    def contour(self, eye: Array) -> Array:
        """Return the edges (M, 2, 3) at which the surface turns away from an eye at `eye` (3,) in the part's frame."""
        front = self.normals @ eye > self.offsets
        return np.asarray(self.ends[front.take(self.faces[0]) ^ front.take(self.faces[1])])


@cache
def _arm_edges() -> dict[RobotPart, EdgeMesh]:
    return _edges_of(link_meshes())


def _edges_of(meshes: Mapping[RobotPart, trimesh.Trimesh]) -> dict[RobotPart, EdgeMesh]:
    return {
        part: EdgeMesh(
            ends=np.asarray(mesh.vertices, dtype=np.float64)[mesh.face_adjacency_edges],
            faces=np.ascontiguousarray(mesh.face_adjacency.T, dtype=np.int32),
            normals=np.asarray(mesh.face_normals, dtype=np.float64),
            offsets=np.asarray((mesh.face_normals * mesh.triangles_center).sum(axis=1)),
        )
        for part, mesh in meshes.items()
    }


class EdgeMatcher:
    """Projection of the robot's edges and their search in images."""

    def __init__(self, gripper: Mapping[RobotPart, trimesh.Trimesh] | None = None) -> None:
        """Build the ray-casting scenes, with the meshes of another gripper in place of those of the Franka hand.

        Raises:
            SetupError: Open3D's native libraries or mani_skill's meshes are missing.
        """
        meshes = part_meshes() if gripper is None else gripper
        self._edges = {**_edges_of(meshes), **_arm_edges()}
        self.caster = PartCaster({**meshes, **link_meshes()})

    def project(
        self, X_CP: Array, camera: Camera, parts: tuple[RobotPart, ...] = ROBOT, points: int = MAX_POINTS
    ) -> EdgePoints | None:
        """Return at most `points` visible contour points of `parts`, which all parts hide; None if there are none.

        Parts are at `X_CP` (PARTS, 4, 4) in the camera frame [m], here as below.
        """
        contours = [self._edges[p].contour(invert(X_CP[p])[:3, 3]) for p in parts]
        placed = [ends @ X_CP[p, :3, :3].T + X_CP[p, :3, 3] for p, ends in zip(parts, contours, strict=True)]
        of = np.repeat(np.array(parts, np.uint8), [len(ends) for ends in contours])
        a = np.concatenate(placed)
        a_P = np.concatenate(contours)
        x = a[..., 0]
        y = a[..., 1]
        z = np.maximum(a[..., 2], 1e-9)
        u = camera.fx * x / z + camera.cx
        v = camera.fy * y / z + camera.cy
        inside = (z > NEAREST_M) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
        shown = np.flatnonzero(inside[:, 0] & inside[:, 1])
        du, dv = (side[shown, 1] - side[shown, 0] for side in (u, v))
        length = np.sqrt(du**2 + dv**2)
        total = float(length.sum())
        if total < _SPACING_PX:
            return None
        # Points evenly spaced along all edges laid end to end.
        ends_at = np.cumsum(length)
        at = np.arange(0.5 * _SPACING_PX, total, max(_SPACING_PX, total / (_HIDDEN * points)))
        row = np.searchsorted(ends_at, at).clip(max=len(length) - 1)
        edge = shown[row]
        size = np.maximum(length[row], 1e-9)
        t = (1.0 - (ends_at[row] - at) / size).clip(0, 1)[:, None]
        p_C = a[edge, 0] + t * (a[edge, 1] - a[edge, 0])
        normal = np.column_stack([-dv[row] / size, du[row] / size])
        side = self._outer_side(X_CP, p_C, normal, camera)
        contour = side != 0
        edge = edge[contour]
        t = t[contour]
        p_C = p_C[contour]
        normal = (side[:, None] * normal)[contour]
        if len(edge) > points:
            subset = np.linspace(0, len(edge) - 1, points).astype(int)
            edge = edge[subset]
            t = t[subset]
            p_C = p_C[subset]
            normal = normal[subset]
        if not len(edge):
            return None
        return EdgePoints(
            part=of[edge],
            p_P=a_P[edge, 0] + t * (a_P[edge, 1] - a_P[edge, 0]),
            p_C=p_C,
            pixel=camera.project(p_C),
            normal=normal,
        )

    def _outer_side(self, X_CP: Array, p_C: Array, normal: Array, camera: Camera) -> Array:
        """Return on which side (N,) of visible contour points the image shows something farther, or nothing.

        1 in the direction of `normal` (N, 2), -1 against it, 0 at points (N, 3) that are hidden or on both sides of
        which is the same surface.
        """
        side = np.zeros(len(p_C))
        directions = p_C / p_C[:, 2:]
        visible = np.flatnonzero(self.caster.first_hits(X_CP, directions)[0] > p_C[:, 2] - _BEHIND_M)
        if not len(visible):
            return side
        depth = p_C[visible, 2]
        directions = directions[visible]
        beside = np.column_stack([_BESIDE_PX * normal[visible] / [camera.fx, camera.fy], np.zeros(len(visible))])
        sides = np.concatenate([directions - beside, directions + beside])
        against, along = self.caster.first_hits(X_CP, sides)[0].reshape(2, -1)
        surface = np.minimum(against, along)
        beyond = np.maximum(against, along)
        is_contour = (np.abs(surface - depth) < _BULGE_M) & (beyond > np.maximum(surface, depth) + _JUMP_M)
        side[visible] = np.where(is_contour, np.where(along > against, 1.0, -1.0), 0.0)
        return side

    def agreement(
        self,
        image: GradientImage,
        X_CP: Array,
        parts: tuple[RobotPart, ...] = WRIST,
        tolerance_px: float = _ON_CONTOUR_PX,
    ) -> float:
        """Return the share of the contour of `parts` that lies on the strongest image edge nearby.

        A point on an edge is off it by the standard deviation `tolerance_px`.
        """
        return self.agreements(image, X_CP, [parts], tolerance_px)[0]

    def agreements(
        self,
        image: GradientImage,
        X_CP: Array,
        groups: Sequence[tuple[RobotPart, ...]],
        tolerance_px: float = _ON_CONTOUR_PX,
    ) -> list[float]:
        """Return the `agreement` of each group of parts; the first holds the parts of all others."""
        points = self.project(X_CP, image.camera, groups[0], FIT_POINTS)
        if points is None:
            return [0.0] * len(groups)
        shares = self.edge_shares(image, points, tolerance_px)
        own = [np.isin(points.part, group) for group in groups]
        return [float(shares[chosen].mean()) if chosen.any() else 0.0 for chosen in own]

    @staticmethod
    def edge_shares(
        image: GradientImage, points: EdgePoints, tolerance_px: float = _ON_CONTOUR_PX, reach_px: float = _SEARCH_PX
    ) -> Array:
        """Return how surely (N,) contour points lie on the strongest image edge within `reach_px`, 0..1."""
        offset, strength = image.find_edges(points, reach_px)
        return np.asarray(np.exp(-0.5 * (offset / tolerance_px) ** 2) * (strength > LEAST_GRADIENT))

    def match(
        self,
        image: GradientImage,
        X_CP: Array,
        reach_px: float,
        parts: tuple[RobotPart, ...] = ROBOT,
        max_points: int = FIT_POINTS,
    ) -> Correspondences | None:
        """Return correspondences of visible contours of `parts` with edges of the image; None if too few are near."""
        points = self.project(X_CP, image.camera, parts, max_points)
        return None if points is None else self.match_points(image, points, reach_px)

    @staticmethod
    def match_points(image: GradientImage, points: EdgePoints, reach_px: float) -> Correspondences | None:
        """Return correspondences of contour points with edges of the image; None if too few are near."""
        move, strength = image.find_edges(points, reach_px)
        strong = strength > LEAST_GRADIENT
        if strong.sum() < MIN_POINTS:
            return None
        camera = image.camera
        place = (points.pixel + move[:, None] * points.normal)[strong]
        ray = np.column_stack([(place - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(place))])
        sigma_m = SIGMA_PX / camera.fx * points.p_C[strong, 2]
        return Correspondences.without_range(
            edge_frames(ray, points.normal[strong]),
            points.p_P[strong],
            np.column_stack([sigma_m, np.full(len(place), np.inf)]),
            points.part[strong],
            INDEPENDENT,
            opening_sign=OPENING_SIGNS[points.part[strong]],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FlangeShape:
    """Contours that tell where the flange is: of the links alone, or with a gripper at one or several openings.

    Parts are at `X_CP` (PARTS, 4, 4) in the camera frame [m].
    """

    edges: tuple[EdgeMatcher, ...]
    """One for each opening."""
    gripper: tuple[RobotPart, ...] = ()
    """Parts whose contours count besides those of the links."""

    def agreement(self, image: GradientImage, X_CP: Array, links: tuple[RobotPart, ...]) -> float:
        """Return the share of the contours of `links` on edges of the image, or its mean with that of the gripper.

        A hidden gripper has none on edges: a posture that hides one must not look better.
        """
        of_links = self.edges[0].agreement(image, X_CP, links)
        return float(0.5 * (of_links + self.gripper_agreement(image, X_CP).max())) if self.gripper else of_links

    def gripper_agreement(self, image: GradientImage, X_CP: Array) -> Array:
        """Return the share (OPENINGS,) of the gripper's contours on edges of the image."""
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
