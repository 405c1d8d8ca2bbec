"""Edges of the robot's CAD model matched to edges of the image.

Outlines of hand and links are projected at a posture; each visible point searches the image across the
projected edge for the strongest gradient nearby, and the distance to it is a residual across the edge (Harris and
Stennett, "RAPID", BMVC 1990; Drummond and Cipolla, PAMI 2002). It needs no network, so it also works on looks that the
network was not trained on, from a posture that is right within a few pixels.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, cross, invert
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.models.panda.cad import PartCaster, link_meshes, part_meshes
from kinebench_drake.models.panda.robot import OPENING_SIGN, RobotPart

_HIDDEN = 3  # points on edges per point that is seen
_SPACING_PX = 2.0  # distance of the points along an edge
_NEAREST_M = 0.05  # least depth of a contour
_BEHIND_M = 0.01  # a point farther than this behind the surface is hidden
_BULGE_M = 0.03  # greatest difference of depth between a contour and the surface beside it
_JUMP_M = 0.015  # least jump of the depth at a contour
_BESIDE_PX = 1.5  # distance from the edge at which the jump is measured
_LARGEST_PX = 640  # images larger than this are reduced
_SMOOTHING_PX = 0.8
SIGMA_PX = 0.7
"""Standard deviation of an image edge across itself [px]."""
_INDEPENDENT = 120.0  # independent measurements that the edges of an image count as at most
LEAST_GRADIENT = 6.0
"""Least gradient of an edge, of an image in 0..255 [1/px]."""
_STEP_PX = 0.5
_BAND_PX, _OUTER_SHARE = 4.0, 0.45  # how far outside and how strong an outline is next to a stronger edge
_RIM_SIGMAS = 5.0  # standard deviations of a segmented rim beyond which nothing is near it
_OFF_RIM = 0.1  # weight of edges of the hand far from its segmented rim
_MIN_POINTS = 20
_SEARCH_PX, _ON_CONTOUR_PX = 8.0, 1.0  # where the agreement looks for the strongest edge, and how near it must lie
MAX_POINTS = 700
"""Points on the contours of an image."""
ROBOT = tuple(part for part in RobotPart if part is not RobotPart.BACKGROUND)
"""Hand, fingers and links."""
RIGID = tuple(part for part in ROBOT if not OPENING_SIGN.get(part))
"""Hand and links: fingers are often exchanged for others."""
WRIST = (RobotPart.HAND, RobotPart.LINK5, RobotPart.LINK6, RobotPart.LINK7)
FLANGE = (RobotPart.HAND, RobotPart.LINK7)
"""Parts that look different after half a turn of the last joint."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgePoints:
    """Visible points on the edges of the robot in an image."""

    part: NDArray[np.uint8]
    """(N,) values of `RobotPart`."""
    p_P: Array
    """(N, 3) points in the frame of the part, fingers closed [m]."""
    p_C: Array
    """(N, 3) points in the camera frame [m]."""
    pixel: Array
    """(N, 2) their places in the image [px]."""
    normal: Array
    """(N, 2) unit vectors across the edge in the image, away from the surface."""


class GradientImage:
    """Gradients of an image, reduced to at most `_LARGEST_PX` pixels."""

    def __init__(self, image: NDArray[np.uint8], camera: Camera) -> None:
        """Compute the gradients of `image` (H, W, 3), taken by `camera`."""
        scale = min(1.0, _LARGEST_PX / max(camera.width, camera.height))
        if scale < 1.0:
            width, height = round(camera.width * scale), round(camera.height * scale)
            image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
            camera = camera.resized(width, height)
        self.camera, self.gray = camera, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        self._dx, self._dy = _gradient(image)
        self._near_rim: NDArray[np.float32] | None = None

    def with_hand(self, gripper: NDArray[np.bool_], sigma_px: float) -> "GradientImage":
        """Return the image with the segmented gripper, whose rim decides between several edges near the hand.

        Args:
            gripper: (H, W) pixels of the frame that show the gripper.
            sigma_px: standard deviation of the segmented rim [px of the frame].
        """
        image = copy(self)
        size = (self.camera.width, self.camera.height)
        mask = np.asarray(cv2.resize(gripper.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST))
        sigma = sigma_px * size[0] / gripper.shape[1]
        u, v, width, height = cv2.boundingRect(mask)
        image._near_rim = None
        if width:
            margin = int(np.ceil(_RIM_SIGMAS * sigma))
            near = slice(max(0, v - margin), v + height + margin), slice(max(0, u - margin), u + width + margin)
            inside, outside = (cv2.distanceTransform(m, cv2.DIST_L2, 5) for m in (mask[near], 1 - mask[near]))
            image._near_rim = np.zeros(mask.shape, np.float32)
            image._near_rim[near] = np.exp(-0.5 * ((inside + outside) / sigma) ** 2)
        return image

    def find_edges(self, points: EdgePoints, reach_px: float) -> tuple[Array, Array]:
        """Return offsets (N,) along the normals of `points` to the image's edges [px], and their gradients (N,).

        The strongest edge within `reach_px` wins unless another is much nearer. Surfaces darken or shine towards their
        outlines, so the strongest edge often lies a little inside: an outline is the outermost edge next to it.
        """
        offset = np.arange(-reach_px, reach_px + _STEP_PX / 2, _STEP_PX)
        place = points.pixel[:, None] + offset[:, None] * points.normal[:, None] - 0.5
        u, v = place[..., 0].astype(np.float32), place[..., 1].astype(np.float32)
        dx, dy = (self._sample(d, u, v) for d in (self._dx, self._dy))
        gradient = np.abs(dx * points.normal[:, None, 0] + dy * points.normal[:, None, 1]).astype(np.float64)
        likely = gradient * np.exp(-0.5 * (offset / (0.6 * reach_px)) ** 2)
        if self._near_rim is not None:
            hand = points.part == RobotPart.HAND
            likely[hand] *= _OFF_RIM + self._sample(self._near_rim, u, v)[hand]
        rows = np.arange(len(gradient))
        best = likely[:, 1:-1].argmax(axis=1) + 1
        is_peak = np.zeros(gradient.shape, bool)
        inner = gradient[:, 1:-1]
        is_peak[:, 1:-1] = (inner >= gradient[:, :-2]) & (inner > gradient[:, 2:])
        ahead = offset - offset[best][:, None]
        outer = is_peak & (ahead > 0) & (ahead <= _BAND_PX) & (gradient >= _OUTER_SHARE * gradient[rows, best][:, None])
        last = outer.shape[1] - 1 - outer[:, ::-1].argmax(axis=1)
        best = np.where(outer.any(axis=1), last, best)
        before, peak, after = gradient[rows, best - 1], gradient[rows, best], gradient[rows, best + 1]
        curvature = before - 2 * peak + after
        shift = np.where(curvature < 0, 0.5 * (before - after) / np.minimum(curvature, -1e-9), 0.0).clip(-1, 1)
        return np.asarray(offset[best] + _STEP_PX * shift), np.asarray(peak)

    @staticmethod
    def _sample(values: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(cv2.remap(values, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.float32)


def _gradient(image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the derivatives (H, W) of an image (H, W, 3) along x and y [1/px], in the channel of the largest."""
    strongest: list[NDArray[np.float32]] = []
    for channel in cv2.split(image):
        smooth = cv2.GaussianBlur(channel.astype(np.float32), (0, 0), _SMOOTHING_PX)
        dx, dy = (cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3, scale=0.125) for order in ((1, 0), (0, 1)))
        derivatives = [np.asarray(values, np.float32) for values in (dx, dy, dx * dx + dy * dy)]
        if not strongest:
            strongest = derivatives
            continue
        stronger = cv2.compare(derivatives[2], strongest[2], cv2.CMP_GT)
        for kept, values in zip(strongest, derivatives, strict=True):
            cv2.copyTo(values, stronger, kept)
    return strongest[0], strongest[1]


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
        """Return the visible contour points of `parts`; None if there are none.

        Args:
            X_CP: (PARTS, 4, 4) poses of the parts in the camera frame [m].
            camera: camera of the image.
            parts: parts whose contours count; all parts hide them.
            points: greatest number of points.
        """
        contours = [self._edges[p].contour(invert(X_CP[p])[:3, 3]) for p in parts]
        placed = [ends @ X_CP[p, :3, :3].T + X_CP[p, :3, 3] for p, ends in zip(parts, contours, strict=True)]
        of = np.repeat(np.array(parts, np.uint8), [len(ends) for ends in contours])
        a, a_P = np.concatenate(placed), np.concatenate(contours)
        x, y, z = a[..., 0], a[..., 1], np.maximum(a[..., 2], 1e-9)
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = (z > _NEAREST_M) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
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
        edge, size = shown[row], np.maximum(length[row], 1e-9)
        t = (1.0 - (ends_at[row] - at) / size).clip(0, 1)[:, None]
        p_C = a[edge, 0] + t * (a[edge, 1] - a[edge, 0])
        normal = np.column_stack([-dv[row] / size, du[row] / size])
        side = self._outer_side(X_CP, p_C, normal, camera)
        contour = side != 0
        edge, t, p_C, normal = edge[contour], t[contour], p_C[contour], (side[:, None] * normal)[contour]
        if len(edge) > points:
            subset = np.linspace(0, len(edge) - 1, points).astype(int)
            edge, t, p_C, normal = edge[subset], t[subset], p_C[subset], normal[subset]
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
        depth, directions = p_C[visible, 2], directions[visible]
        beside = np.column_stack([_BESIDE_PX * normal[visible] / [camera.fx, camera.fy], np.zeros(len(visible))])
        sides = np.concatenate([directions - beside, directions + beside])
        against, along = self.caster.first_hits(X_CP, sides)[0].reshape(2, -1)
        surface, beyond = np.minimum(against, along), np.maximum(against, along)
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

        Args:
            image: gradients of the image.
            X_CP: (PARTS, 4, 4) poses of the parts in the camera frame [m].
            parts: parts whose contours count.
            tolerance_px: standard deviation of a point that lies on an edge [px].
        """
        points = self.project(X_CP, image.camera, parts)
        if points is None:
            return 0.0
        return float(self.edge_shares(image, points, tolerance_px).mean())

    @staticmethod
    def edge_shares(image: GradientImage, points: EdgePoints, tolerance_px: float = _ON_CONTOUR_PX) -> Array:
        """Return how surely (N,) contour points lie on the strongest image edge nearby, 0..1."""
        offset, strength = image.find_edges(points, _SEARCH_PX)
        return np.asarray(np.exp(-0.5 * (offset / tolerance_px) ** 2) * (strength > LEAST_GRADIENT))

    def match_all(
        self,
        images: Sequence[GradientImage],
        X_CP: Array,
        reach_px: float,
        parts: tuple[RobotPart, ...] = ROBOT,
        max_points: int = MAX_POINTS,
    ) -> list[Correspondences | None]:
        """Return the correspondences of B images with parts at `X_CP` (B, PARTS, 4, 4); see `match`."""
        return [self.match(image, X, reach_px, parts, max_points) for image, X in zip(images, X_CP, strict=True)]

    def match(
        self,
        image: GradientImage,
        X_CP: Array,
        reach_px: float,
        parts: tuple[RobotPart, ...] = ROBOT,
        max_points: int = MAX_POINTS,
    ) -> Correspondences | None:
        """Return correspondences of the visible contours of `parts` with the image; None if there are too few.

        Args:
            image: gradients of the image.
            X_CP: (PARTS, 4, 4) poses of the parts in the camera frame [m].
            reach_px: farthest edge in the image [px].
            parts: parts whose contours count.
            max_points: greatest number of points of the contours.
        """
        points = self.project(X_CP, image.camera, parts, max_points)
        if points is None:
            return None
        move, strength = image.find_edges(points, reach_px)
        strong = strength > LEAST_GRADIENT
        if strong.sum() < _MIN_POINTS:
            return None
        camera = image.camera
        place = (points.pixel + move[:, None] * points.normal)[strong]
        ray = np.column_stack([(place - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(place))])
        z = ray / np.linalg.norm(ray, axis=1, keepdims=True)
        x = np.column_stack([points.normal[strong], np.zeros(len(place))])
        x -= (x * z).sum(axis=1, keepdims=True) * z
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        n = len(place)
        unconstrained = np.full(n, np.inf)
        part = points.part[strong]
        return Correspondences(
            R_LC=np.stack([x, cross(z, x), z], axis=1),
            range_m=np.ones(n),
            range_sigma=unconstrained,
            p_P=points.p_P[strong],
            sigma_m=np.column_stack([SIGMA_PX / camera.fx * points.p_C[strong, 2], unconstrained]),
            part=part,
            opening_sign=np.array([OPENING_SIGN.get(RobotPart(p), 0.0) for p in part]),
            weight=np.full(n, min(1.0, _INDEPENDENT / n)),
        )
