"""Edges of the robot's CAD model matched to edges of the image.

Outlines of hand and links are projected at a posture; each visible point searches the image across the
projected edge for the strongest gradient nearby, and the distance to it is a residual across the edge (Harris and
Stennett, "RAPID", BMVC 1990; Drummond and Cipolla, PAMI 2002). It needs no network, so it also works on looks that the
network was not trained on, from a posture that is right within a few pixels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.registration.image import EdgePoints, GradientImage
from kinebench_drake.grounding.registration.solver import MIN_POINTS, NEAREST_M, Correspondences, edge_frames
from kinebench_drake.grounding.tracking.view import OPENING_SIGNS
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.models.panda.cad import PartCaster, franka_hand, link_meshes
from kinebench_drake.models.panda.description import OPENING_SIGN, RobotPart

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
def _arm_edges() -> dict[int, EdgeMesh]:
    return _edges_of({int(part): mesh for part, mesh in link_meshes().items()})


def _edges_of(meshes: Mapping[int, trimesh.Trimesh]) -> dict[int, EdgeMesh]:
    return {
        body: EdgeMesh(
            ends=np.asarray(mesh.vertices, dtype=np.float64)[mesh.face_adjacency_edges],
            faces=np.ascontiguousarray(mesh.face_adjacency.T, dtype=np.int32),
            normals=np.asarray(mesh.face_normals, dtype=np.float64),
            offsets=np.asarray((mesh.face_normals * mesh.triangles_center).sum(axis=1)),
        )
        for body, mesh in meshes.items()
    }


class EdgeMatcher:
    """Projection of the robot's edges and their search in images."""

    def __init__(self, gripper: GripperModel | None = None) -> None:
        """Build the ray-casting scenes of the arm with a gripper, by default the Franka hand.

        Raises:
            SetupError: Open3D's native libraries or mani_skill's meshes are missing.
        """
        self.gripper = gripper or franka_hand()
        self._edges = {**_edges_of(self.gripper.meshes), **_arm_edges()}
        self.caster = PartCaster(self.gripper, link_meshes())

    def project(
        self, X_CP: Array, camera: Camera, parts: tuple[RobotPart, ...] = ROBOT, points: int = MAX_POINTS
    ) -> EdgePoints | None:
        """Return at most `points` visible contour points of `parts`, which all parts hide; None if there are none.

        Bodies are at `X_CP` (BODIES, 4, 4) in the camera frame [m], here as below; or parts (PARTS, 4, 4) with the
        gripper closed.
        """
        X_CP = self.gripper.complete(X_CP)
        bodies = self.gripper.bodies_of([part for part in parts if part in self._edges])
        contours = [self._edges[p].contour(invert(X_CP[p])[:3, 3]) for p in bodies]
        placed = [ends @ X_CP[p, :3, :3].T + X_CP[p, :3, 3] for p, ends in zip(bodies, contours, strict=True)]
        of = np.repeat(np.array(bodies, np.uint8), [len(ends) for ends in contours])
        a = np.concatenate(placed)
        a_P = np.concatenate(contours)
        z = np.maximum(a[..., 2], 1e-9)
        u = camera.fx * a[..., 0] / z + camera.cx
        v = camera.fy * a[..., 1] / z + camera.cy
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
        kept = np.flatnonzero(side)
        if not len(kept):
            return None
        if len(kept) > points:
            kept = kept[np.linspace(0, len(kept) - 1, points).astype(int)]
        edge = edge[kept]
        t = t[kept]
        p_C = p_C[kept]
        body = of[edge]
        p_P = a_P[edge, 0] + t * (a_P[edge, 1] - a_P[edge, 0])
        if self.gripper.linkage is not None:
            p_P = self.gripper.in_parts(body, p_P, p_C, X_CP)
        return EdgePoints(
            part=self.gripper.part_of[body],
            p_P=p_P,
            p_C=p_C,
            pixel=camera.project(p_C),
            normal=side[kept, None] * normal[kept],
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
        return Correspondences.without_range(
            edge_frames(ray, points.normal[strong]),
            points.p_P[strong],
            np.column_stack([SIGMA_PX / camera.fx * points.p_C[strong, 2], np.full(len(place), np.inf)]),
            points.part[strong],
            INDEPENDENT,
            opening_sign=OPENING_SIGNS[points.part[strong]],
        )


def unknown_gripper() -> GripperModel:
    """Return a round body that hides the last links where an unknown gripper would."""
    body = trimesh.creation.cylinder(_BODY_RADIUS_M, _BODY_LENGTH_M)
    placed = body.apply_translation([0.0, 0.0, _BODY_LENGTH_M / 2])
    return GripperModel(parts={RobotPart.HAND: placed}, max_finger_m=0.0)
