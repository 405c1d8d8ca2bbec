"""Visuals and colliders of simple shapes.

Meshes have normals, and texture coordinates in metres: one repetition of the texture per metre unless scaled.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.scene.model import (
    Collider,
    ColliderKind,
    Joint,
    Material,
    Mesh,
    RigidBody,
    SurfaceFinish,
    Visual,
)


def box_mesh(size: ArrayLike, *, bevel_m: float = 0.0, uv_per_m: float = 1.0) -> Mesh:
    """Return a box of extents `size` (3,) [m] centred at the origin, with edges bevelled by `bevel_m`.

    Each face has its own texture coordinates, `uv_per_m` repetitions per metre.
    """
    half = np.asarray(size, dtype=np.float64) / 2.0
    bevel = min(bevel_m, 0.45 * float(half.min()) * 2.0)
    if bevel <= 0.0:
        solid = trimesh.creation.box(extents=2.0 * half)
    else:
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
        points = [corners * (half - bevel * (1.0 - np.eye(3)[axis])) for axis in range(3)]
        solid = trimesh.convex.convex_hull(np.concatenate(points))
    return flat_mesh(solid.vertices, solid.faces, uv_per_m=uv_per_m)


def cylinder_mesh(radius_m: float, length_m: float, *, sections: int = 32) -> Mesh:
    """Return a cylinder along z centred at the origin, with a smooth side and flat ends."""
    h = length_m / 2.0
    return lathe([[0.0, -h], [radius_m, -h], [radius_m, h], [0.0, h]], sections=sections)


def arc_length(points: Array) -> Array:
    """Return the length (N,) along a polyline (N, D) up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def lathe(profile: ArrayLike, *, sections: int = 32, uv_per_m: float = 1.0, crease_rad: float = 0.6) -> Mesh:
    """Return the surface of revolution about z of a profile (N, 2) of radius and height [m], from bottom to top.

    Normals are smooth where the profile bends by less than `crease_rad`.
    """
    rz = np.asarray(profile, dtype=np.float64)
    angle = np.linspace(0.0, 2.0 * np.pi, sections + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    vertices = np.concatenate([np.column_stack([r * ring, np.full(len(ring), z)]) for r, z in rz])
    along = arc_length(rz)
    around = angle * max(float(rz[:, 0].max()), 1e-6)
    uv = uv_per_m * np.concatenate([np.column_stack([around, np.full(len(around), s)]) for s in along])
    a = (np.arange(len(rz) - 1)[:, None] * (sections + 1) + np.arange(sections)).ravel()
    return smooth_mesh(vertices, _band(a, a + sections + 1).reshape(-1, 3), uv, crease_rad=crease_rad)


def _band(a: NDArray[np.intp], b: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return two triangles (..., 6) between the points `a`, `a` + 1 of one ring and `b`, `b` + 1 of the next."""
    return np.stack([a, a + 1, b + 1, a, b + 1, b], axis=-1)


def flat_mesh(vertices: ArrayLike, faces: ArrayLike, *, uv_per_m: float = 1.0) -> Mesh:
    """Return a mesh with flat shading; texture coordinates are projected along the dominant axis of each normal."""
    triangles = np.asarray(vertices, dtype=np.float64)[np.asarray(faces)]
    n = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-12)
    others = np.array([[1, 2], [0, 2], [0, 1]])[np.argmax(np.abs(n), axis=1)]
    uv = np.take_along_axis(triangles, others[:, None, :], axis=2).reshape(-1, 2)
    return Mesh(
        vertices=triangles.reshape(-1, 3),
        faces=np.arange(3 * len(triangles)).reshape(-1, 3),
        normals=np.repeat(n, 3, axis=0),
        uv=uv_per_m * uv,
    )


def smooth_mesh(vertices: ArrayLike, faces: ArrayLike, uv: ArrayLike, *, crease_rad: float = 0.6) -> Mesh:
    """Return a mesh whose vertex normals average the adjacent triangles that face within `crease_rad` of each other."""
    points = np.asarray(vertices, dtype=np.float64)
    texture = np.asarray(uv, dtype=np.float64)
    triangles = np.asarray(faces, dtype=np.intp)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    keep = np.linalg.norm(area, axis=1) > 1e-15
    triangles = triangles[keep]
    area = area[keep]
    corners = triangles.reshape(-1)
    unit = area / np.linalg.norm(area, axis=1, keepdims=True)
    _, place = np.unique(np.round(points, 7), axis=0, return_inverse=True)
    place = place.reshape(-1)[corners]
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.argsort(place, kind="stable")
    normals = np.empty((len(corners), 3))
    for group in np.split(order, np.flatnonzero(np.diff(place[order])) + 1):
        near = unit[owner[group]] @ unit[owner[group]].T > np.cos(crease_rad)
        normals[group] = near @ area[owner[group]]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    return Mesh(
        vertices=points[corners], faces=np.arange(len(corners)).reshape(-1, 3), normals=normals, uv=texture[corners]
    )


def sweep(centers: ArrayLike, radii: ArrayLike, *, sections: int = 16, uv_per_m: float = 1.0) -> Mesh:
    """Return a round tube along points (N, 3) with radii (N,) [m] and flat ends."""
    p = np.asarray(centers, dtype=np.float64)
    r = np.asarray(radii, dtype=np.float64)
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    angle = np.linspace(0.0, 2.0 * np.pi, sections + 1)
    rings = []
    for i in range(len(p)):  # parallel transport: no twist
        side = side - (side @ tangent[i]) * tangent[i]
        side /= np.linalg.norm(side)
        up = np.cross(tangent[i], side)
        rings.append(p[i] + r[i] * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up))
    along = arc_length(p)
    vertices = np.concatenate([*rings, np.repeat(p[[0, -1]], sections + 1, axis=0)])
    columns = sections + 1
    uv = np.concatenate(
        [np.column_stack([angle * r.max(), np.full(columns, s)]) for s in [*along, along[0], along[-1]]]
    )
    j = np.arange(sections)
    n = len(p)
    a = np.arange(n - 1) * columns + j[:, None]
    sides = _band(a, a + columns).reshape(sections, -1)
    end = (n - 1) * columns + j
    ends = np.stack([j + 1, j, n * columns + j, end, end + 1, (n + 1) * columns + j], axis=1)
    return smooth_mesh(vertices, np.concatenate([sides, ends], axis=1).reshape(-1, 3), uv_per_m * uv)


def unit_ring(sections: int) -> Array:
    """Return points (sections, 2) evenly spaced on the unit circle."""
    angle = 2.0 * np.pi * np.arange(sections) / sections
    return np.column_stack([np.cos(angle), np.sin(angle)])


def frustum(low: Sequence[float], high: Sequence[float], *, sections: int) -> Collider:
    """Return a collider, the convex hull about z between two points of a profile: radius and height [m]."""
    ring = unit_ring(sections)
    rings = [np.column_stack([r * ring, np.full(sections, z)]) for r, z in (low, high)]
    return Collider(kind=ColliderKind.HULL, points=np.concatenate(rings))


def sparse_hull(points: Array, directions: int) -> Array:
    """Return few points (N, 3) whose hull approximates that of `points`, including the outlines of its flat sides.

    The extreme points along `directions` unit vectors on a golden-angle spiral, and along 8 directions within the flat
    sides at the lowest z and at both ends of y.
    """
    z = 1.0 - (2.0 * np.arange(directions) + 1.0) / directions
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(directions)
    level = np.sqrt(1.0 - z**2)
    spiral = np.column_stack([level * np.cos(angle), level * np.sin(angle), z])
    extreme = [points[np.argmax(points @ spiral.T, axis=0)]]
    for axis, sign in ((2, -1.0), (1, -1.0), (1, 1.0)):
        reach = sign * points[:, axis]
        side = points[reach > reach.max() - 1e-6]
        extreme.append(side[np.argmax(np.delete(side, axis, axis=1) @ unit_ring(8).T, axis=0)])
    return np.unique(np.concatenate(extreme), axis=0)


_IDENTITY = np.eye(3)
_X_IDENTITY = np.eye(4)


def box_collider(size: ArrayLike, center: ArrayLike, *, R: ArrayLike = _IDENTITY) -> Collider:
    """Return a box collider of extents `size` (3,) centred at `center` (3,) [m], rotated by `R` (3, 3)."""
    x, y, z = (float(s) for s in 0.5 * np.asarray(size, dtype=np.float64))
    return Collider(kind=ColliderKind.BOX, size=(x, y, z), X_BodyC=make_pose(R, center))


def box_visual(
    size: ArrayLike,
    center: ArrayLike,
    surface: SurfaceFinish,
    *,
    R: ArrayLike = _IDENTITY,
    bevel_m: float = 0.001,
    uv_per_m: float = 5.0,
) -> Visual:
    """Return a box visual of extents `size` (3,) centred at `center` (3,) [m], rotated by `R` (3, 3).

    `bevel_m` and `uv_per_m` as in `box_mesh`.
    """
    return Visual(
        mesh=box_mesh(size, bevel_m=bevel_m, uv_per_m=uv_per_m), surface=surface, X_BodyV=make_pose(R, center)
    )


@dataclass(slots=True)
class BodyParts:
    """Builder of a body from parts in the body's frame."""

    uv_per_m: float = 5.0
    """Repetitions of the texture per metre on panels."""
    visuals: list[Visual] = field(default_factory=list)
    colliders: list[Collider] = field(default_factory=list)

    def visual(self, mesh: Mesh, surface: SurfaceFinish, X: Array = _X_IDENTITY) -> None:
        """Add a mesh at a pose (4, 4)."""
        self.visuals.append(Visual(mesh=mesh, surface=surface, X_BodyV=X))

    def collider(self, kind: ColliderKind, size: tuple[float, ...], X: Array) -> None:
        """Add a collider other than a hull at a pose (4, 4)."""
        self.colliders.append(Collider(kind=kind, size=size, X_BodyC=X))

    def hull(self, points: Array) -> None:
        """Add the convex hull of points (N, 3) as a collider."""
        self.colliders.append(Collider(kind=ColliderKind.HULL, points=points))

    def box(
        self,
        size: ArrayLike,
        center: ArrayLike,
        surface: SurfaceFinish,
        *,
        R: ArrayLike = _IDENTITY,
        bevel_m: float = 0.001,
        solid: bool = True,
    ) -> None:
        """Add a box of extents `size` (3,) centred at `center` (3,) [m]; without a collider if not `solid`."""
        self.visuals.append(box_visual(size, center, surface, R=R, bevel_m=bevel_m, uv_per_m=self.uv_per_m))
        if solid:
            self.colliders.append(box_collider(size, center, R=R))

    def panel(
        self, low: ArrayLike, high: ArrayLike, surface: SurfaceFinish, *, bevel_m: float = 0.001, solid: bool = True
    ) -> None:
        """Add the box between two corners (3,) [m]; without a collider if not `solid`."""
        low = np.asarray(low, dtype=np.float64)
        high = np.asarray(high, dtype=np.float64)
        self.box(high - low, 0.5 * (low + high), surface, bevel_m=bevel_m, solid=solid)

    def body(self, name: str, material: Material, joint: Joint | None = None) -> RigidBody:
        """Return all parts as one body."""
        return RigidBody(
            name=name, visuals=tuple(self.visuals), colliders=tuple(self.colliders), material=material, joint=joint
        )
