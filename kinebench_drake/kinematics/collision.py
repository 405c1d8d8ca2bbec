"""How far the arm is from itself and from the table, and which way it should move to get farther.

Every link is the convex hull of its collision mesh (or the primitive that stands in its place), as Drake's proximity
engine has it. Pairs of links that the robot's SRDF allows are never looked at. The table is the plane z = const of B;
the links that are fixed to the base stand on it and are exempt.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Role, Sphere

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.kinematics.chain import LinkChain
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.robot import N_JOINTS

TABLE = "table"
"""Name of the table where links are named."""

_REACH_M = 0.2  # self distances are searched this far first; the Panda is never farther from itself


@dataclass(frozen=True, slots=True, kw_only=True)
class Clearance:
    """Least distance of N postures from a collision."""

    distance_m: Array
    """(N,) signed distance [m], negative: depth of penetration; NaN where q is NaN or nothing can collide."""
    pair: tuple[tuple[str, str] | None, ...]
    """(N,) the two links that are nearest to each other, base first, or a link and "table"; None with NaN."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Proximity:
    """Two parts near each other at one posture."""

    link_a: str
    link_b: str
    """The second link, or "table"."""
    distance_m: float
    """Signed distance [m], negative: depth of penetration."""
    gradient: Array
    """(7,) derivative of the distance by the joint angles [m/rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solid:
    """A convex body fixed to a link: points, each swollen by the same (possibly flat or empty) ellipsoid."""

    link: str
    stage: int
    """Motion of `LinkChain` that carries it."""
    points: Array
    """(V, 3) in B at the zero posture [m]."""
    axes: Array | None
    """(3, 3) the ellipsoid's semi-axes as columns, in B at the zero posture [m]; None: a polytope."""

    def heights(self, R: Array, p: Array) -> Array:
        """Least z (N, V) in B of each swollen point, moved by R (N, 3, 3) and p (N, 3): the support function at -z."""
        z = R[:, 2] @ self.points.T + p[:, 2:]
        return z if self.axes is None else z - np.linalg.norm(R[:, 2] @ self.axes, axis=-1, keepdims=True)

    def lowest(self, R: Array, p: Array) -> Array:
        """Lowest point (3,) in B of the solid moved by R (3, 3) and p (3,)."""
        point = self.points[np.argmin(self.points @ R[2])]
        if self.axes is not None:
            down = R[2] @ self.axes
            norm = np.linalg.norm(down)
            point = point - self.axes @ down / norm if norm > 0.0 else point
        return np.asarray(R @ point + p)


class CollisionModel:
    """Distances of a plant's postures from themselves and from the table. Uses the plant's context."""

    def __init__(self, plant: ArmPlant, *, table_height_m: float = 0.0) -> None:
        """Read the solids off the plant.

        Args:
            plant: the robot.
            table_height_m: z of the table in B [m].

        Raises:
            InputError: a collision geometry is of a kind that has no lowest point.
            UsageError: the table's height is not finite.
        """
        if not np.isfinite(table_height_m):
            raise UsageError(f"the table's height is {table_height_m} m, expected a finite number")
        self.table_height_m = table_height_m
        """z of the table in B [m]."""
        self._plant = plant
        self._chain = LinkChain(plant)
        inspector = plant.query(plant.robot.rest_q).inspector()
        self._solids: dict[Any, _Solid] = {}
        for geometry in inspector.GetAllGeometryIds(Role.kProximity):
            link = plant.drake.GetBodyFromFrameId(inspector.GetFrameId(geometry)).name()
            self._solids[geometry] = _solid(inspector, geometry, link, self._chain)
        self._movable = [solid for solid in self._solids.values() if solid.stage > 0]

    def self_distance(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Clearance:
        """Least distance between two links that must not touch, at postures `q` (N, 7) [rad].

        Exact for the convex hulls, far postures included; by Drake's SceneGraph. The fingers are `finger_width_m` (N,)
        [m] apart; None or NaN: as the plant has them.

        Raises:
            UsageError: `q` is not (N, 7), or `finger_width_m` not (N,).
        """
        q, width = _arguments(q, finger_width_m)
        distance = np.full(len(q), np.nan)
        pairs: list[tuple[str, str] | None] = [None] * len(q)
        for i in np.flatnonzero(np.isfinite(q).all(axis=-1)):
            query = self._plant.query(q[i], None if np.isnan(width[i]) else float(width[i]))
            found = query.ComputeSignedDistancePairwiseClosestPoints(_REACH_M)
            if not found:
                found = query.ComputeSignedDistancePairwiseClosestPoints(np.inf)
            if found:
                nearest = min(found, key=_distance)
                distance[i] = nearest.distance
                pairs[i] = self._links(nearest)
        return Clearance(distance_m=distance, pair=tuple(pairs))

    def table_distance(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Clearance:
        """Height of the lowest point of any moving link over the table, at postures `q` (N, 7) [rad].

        The signed distance of a convex body from a half space is that of its lowest point. The fingers are
        `finger_width_m` (N,) [m] apart; None or NaN: as the plant has them.

        Raises:
            UsageError: `q` is not (N, 7), or `finger_width_m` not (N,).
        """
        q, width = _arguments(q, finger_width_m)
        known = np.isfinite(q).all(axis=-1)
        distance = np.full(len(q), np.nan)
        pairs: list[tuple[str, str] | None] = [None] * len(q)
        if known.any() and self._movable:
            M = self._chain.motions(q[known], width[known])
            R, p = M[..., :3, :3], M[..., :3, 3]
            heights = np.stack([s.heights(R[:, s.stage], p[:, s.stage]).min(axis=-1) for s in self._movable])
            distance[known] = heights.min(axis=0) - self.table_height_m
            for i, lowest in zip(np.flatnonzero(known), heights.argmin(axis=0), strict=True):
                pairs[i] = (self._movable[lowest].link, TABLE)
        return Clearance(distance_m=distance, pair=tuple(pairs))

    def near_pairs(self, q: ArrayLike, within_m: float, finger_width_m: float | None = None) -> list[Proximity]:
        """All pairs of solids nearer than `within_m` [m] at posture `q` (7,) [rad], with gradients, nearest first.

        A link made of several solids appears once for each that is near. The gradient is n . (J_A(a) - J_B(b)) with a
        and b the nearest points, J their translational Jacobians and n the direction from b to a (from a to b in
        penetration): the derivative wherever the nearest points are unique, and one of the one-sided derivatives'
        bounds where they are not (parallel faces).

        Raises:
            UsageError: `q` is not (7,).
        """
        q = np.asarray(q, dtype=np.float64)
        query = self._plant.query(q, finger_width_m)
        width = None if finger_width_m is None else [finger_width_m]
        M = self._chain.motions(q[None], width)
        axis, point = (array[0] for array in self._chain.axes(M))
        found = []
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(within_m):
            n = np.asarray(pair.nhat_BA_W)
            link_a, link_b = (self._solids[id].link for id in (pair.id_A, pair.id_B))
            a = query.GetPoseInWorld(pair.id_A) @ pair.p_ACa
            b = query.GetPoseInWorld(pair.id_B) @ pair.p_BCb
            gradient = self._rate(link_a, a, n, axis, point) - self._rate(link_b, b, n, axis, point)
            names = self._links(pair)
            found.append(Proximity(link_a=names[0], link_b=names[1], distance_m=pair.distance, gradient=gradient))
        up = np.array([0.0, 0.0, 1.0])
        for solid in self._movable:
            lowest = solid.lowest(M[0, solid.stage, :3, :3], M[0, solid.stage, :3, 3])
            distance = float(lowest[2]) - self.table_height_m
            if distance <= within_m:
                gradient = self._rate(solid.link, lowest, up, axis, point)
                found.append(Proximity(link_a=solid.link, link_b=TABLE, distance_m=distance, gradient=gradient))
        return sorted(found, key=lambda proximity: proximity.distance_m)

    def _rate(self, link: str, p: Array, n: Array, axis: Array, point: Array) -> Array:
        """Speed (7,) along `n` of the link's material point `p` per joint rate [m/rad]: n . (axis x (p - point))."""
        return np.asarray(self._chain.carries(link) * (np.cross(axis, p - point) @ n))

    def _links(self, pair: Any) -> tuple[str, str]:
        solids = sorted((self._solids[pair.id_A], self._solids[pair.id_B]), key=lambda s: (s.stage, s.link))
        return solids[0].link, solids[1].link


def _distance(pair: Any) -> float:
    return float(pair.distance)


def _arguments(q: ArrayLike, finger_width_m: ArrayLike | None) -> tuple[Array, Array]:
    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != N_JOINTS:
        raise UsageError(f"q has shape {q.shape}, expected (N, {N_JOINTS}) arm joints in radians")
    width = np.full(len(q), np.nan) if finger_width_m is None else np.asarray(finger_width_m, dtype=np.float64)
    if width.shape != (len(q),):
        raise UsageError(f"finger_width_m has shape {width.shape}, expected ({len(q)},) as q has {len(q)} rows")
    return q, width


def _solid(inspector: Any, geometry: Any, link: str, chain: LinkChain) -> _Solid:
    """The geometry's shape as points and an ellipsoid, in B at the zero posture."""
    shape = inspector.GetShape(geometry)
    points, axes = _shape(shape, inspector.GetConvexHull(geometry))
    X = chain.home[link] @ inspector.GetPoseInFrame(geometry).GetAsMatrix4()
    return _Solid(
        link=link,
        stage=chain.stage[link],
        points=transform_points(X, points),
        axes=None if axes is None else X[:3, :3] @ axes,
    )


def _shape(shape: Any, hull: Any) -> tuple[Array, Array | None]:
    """Points (V, 3) [m] and the semi-axes (3, 3) [m] of the ellipsoid around each, in the shape's own frame."""
    origin = np.zeros((1, 3))
    match shape:
        case Box():
            return _corners(shape.size()), None
        case Sphere():
            return origin, shape.radius() * np.eye(3)
        case Ellipsoid():
            return origin, np.diag([shape.a(), shape.b(), shape.c()])
        case Cylinder():
            return _ends(shape.length()), shape.radius() * np.diag([1.0, 1.0, 0.0])
        case Capsule():
            return _ends(shape.length()), shape.radius() * np.eye(3)
        case _ if hull is not None:
            return np.array([hull.vertex(i) for i in range(hull.num_vertices())]), None
    raise InputError(
        f"a collision geometry is a {type(shape).__name__}; expected a mesh, box, cylinder, sphere, capsule or ellipsoid"
    )


def _corners(size: Sequence[float]) -> Array:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    return np.asarray(0.5 * signs * np.asarray(size))


def _ends(length: float) -> Array:
    return np.array([[0.0, 0.0, -0.5 * length], [0.0, 0.0, 0.5 * length]])
