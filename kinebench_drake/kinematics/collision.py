"""Distances of the arm from itself and from the table, and their gradients.

Every link is the convex hull of its collision mesh (or the primitive in its place), as in Drake's proximity engine;
ManiSkill simulates the Panda with the same hulls. Hulls fill the concavities of the links: a penetration means contact
in simulation, while the real arm may have up to about 2 cm of clearance there. Pairs of links that the robot's SRDF
excludes are ignored. The table is the plane z = const of B; links fixed to the base stand on it and are exempt.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Role, Sphere
from scipy.optimize import nnls

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.kinematics.chain import LinkChain
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.segments import spread

TABLE = "table"
"""Name of the table in pairs of links."""

_REACH_M = 0.2  # first search radius of self distances; the Panda is never farther from itself
# Drake's iteration for the distance of two hulls sometimes stops early, with points that are not the nearest: too far
# by 8 mm at worst in a million random postures of the Panda, never with the wrong sign. So each distance is compared
# with the width of the slab that separates the two solids, and computed again where the two differ.
_CERTAIN_M = 1e-6
_DOUBT_M = 0.02
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Clearance:
    """Least distance of N postures from a collision."""

    distance_m: Array
    """(N,) signed distance [m], negative: depth of penetration; NaN where q is NaN or nothing can collide."""
    pair: tuple[tuple[str, str] | None, ...]
    """(N,) the two nearest links, base first, or a link and "table"; None where the distance is NaN."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Proximity:
    """Two solids near each other at one posture."""

    link_a: str
    link_b: str
    """The second link, or "table"."""
    distance_m: float
    """Signed distance [m], negative: depth of penetration."""
    gradient: Array
    """(7,) derivative of the distance with respect to the joint angles [m/rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solid:
    """Convex body fixed to a link: convex hull of points, each enlarged by the same (possibly degenerate) ellipsoid."""

    link: str
    stage: int
    """Motion of `LinkChain` that moves it."""
    points: Array
    """(V, 3) in B at the zero posture [m]."""
    axes: Array | None
    """(3, 3) semi-axes of the ellipsoid as columns, in B at the zero posture [m]; None for a polytope."""

    def least(self, n: Array) -> Array:
        """Return the least n . x (N,) over the points x of the solid at the zero posture, for directions `n` (N, 3)."""
        least = np.asarray((n @ self.points.T).min(axis=-1))
        return least if self.axes is None else least - np.linalg.norm(n @ self.axes, axis=-1)

    def ball(self) -> tuple[Array, float]:
        """Return centre (3,) and radius [m] of a ball around the solid at the zero posture."""
        center = 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))
        radius = float(np.linalg.norm(self.points - center, axis=-1).max())
        return center, radius if self.axes is None else radius + float(np.linalg.norm(self.axes, ord=2))

    def lowest(self, n: Array) -> Array:
        """Return the point x (3,) of the solid at the zero posture with the least n . x."""
        point = self.points[np.argmin(self.points @ n)]
        if self.axes is not None and (norm := np.linalg.norm(n @ self.axes)) > 0.0:
            point = point - self.axes @ (n @ self.axes) / norm
        return np.asarray(point)


class CollisionModel:
    """Distances of an arm from itself and from the table. Uses the context of the plant."""

    def __init__(self, plant: ArmPlant, *, table_height_m: float = 0.0) -> None:
        """Read the solids of the plant.

        Args:
            plant: the robot.
            table_height_m: z of the table in B [m].

        Raises:
            InputError: a collision geometry is of an unsupported kind.
            UsageError: the table's height is not finite.
        """
        if not np.isfinite(table_height_m):
            raise UsageError(f"the table's height is {table_height_m} m, expected a finite number")
        self.table_height_m = table_height_m
        """z of the table in B [m]."""
        self._plant = plant
        self._chain = plant.chain
        inspector = plant.query(plant.robot.rest_q).inspector()
        self._solids: dict[Any, _Solid] = {}
        for geometry in inspector.GetAllGeometryIds(Role.kProximity):
            link = plant.drake.GetBodyFromFrameId(inspector.GetFrameId(geometry)).name()
            self._solids[geometry] = _solid(inspector, geometry, link, self._chain)
        self._movable = [solid for solid in self._solids.values() if solid.stage > 0]
        self._stages = np.array([solid.stage for solid in self._movable], dtype=np.intp)
        balls = [solid.ball() for solid in self._movable]
        self._centers = np.reshape([center for center, _ in balls], (-1, 3))
        self._radii = np.array([radius for _, radius in balls])

    def self_distance(
        self, q: ArrayLike, finger_width_m: ArrayLike | None = None, *, within_m: float = np.inf
    ) -> Clearance:
        """Return the least distance between two links that must not touch, by Drake's SceneGraph.

        Exact to 1e-6 m for polytopes, at any distance.

        Args:
            q: (N, 7) postures [rad].
            finger_width_m: (N,) finger gap [m]; the plant's default where None or NaN.
            within_m: greatest distance of interest [m]: greater ones take less time and are NaN.

        Raises:
            UsageError: `q` is not (N, 7), or `finger_width_m` not (N,).
        """
        q, width = _arguments(q, finger_width_m)
        rows = np.flatnonzero(np.isfinite(q).all(axis=-1))
        near: dict[tuple[Any, Any], list[tuple[int, Any]]] = {}
        most = within_m + _DOUBT_M
        reach = _REACH_M
        for i, row in enumerate(rows):
            query = self._plant.query(q[row], None if np.isnan(width[row]) else float(width[row]))
            # Pairs that cannot be the nearest cost time. Along a motion the distance changes little from row to row.
            for reach_m in (reach, _REACH_M, np.inf):
                results = query.ComputeSignedDistancePairwiseClosestPoints(min(reach_m, most))
                distances = [pair.distance for pair in results]
                farthest = min(distances, default=np.inf) + _DOUBT_M
                if farthest <= reach_m or most <= reach_m:
                    break
            reach = min(farthest + _DOUBT_M, _REACH_M)
            for distance, pair in zip(distances, results, strict=True):
                if distance <= farthest:
                    near.setdefault((pair.id_A, pair.id_B), []).append((i, pair))
        least = np.full(len(rows), np.inf)
        pairs: list[tuple[str, str] | None] = [None] * len(q)
        M = self._chain.motions(q[rows], width[rows])
        for (id_A, id_B), entries in near.items():
            A, B = self._solids[id_A], self._solids[id_B]
            frames = np.array([frame for frame, _ in entries])
            distance = np.array([pair.distance for _, pair in entries])
            gap = _gap(A, B, M[frames], np.array([pair.nhat_BA_W for _, pair in entries]))
            for k in np.flatnonzero((distance > 0.0) & (gap < distance - _CERTAIN_M)):
                if A.axes is None and B.axes is None:
                    a, b = _nearest(A, B, M[frames[k]])
                    distance[k] = np.linalg.norm(a - b)
            for frame, value in zip(frames, distance, strict=True):
                if value < least[frame]:
                    least[frame] = value
                    pairs[rows[frame]] = _link_names(A, B)
        least[np.isinf(least) | (least > within_m)] = np.nan
        return Clearance(distance_m=spread(least, rows, len(q)), pair=tuple(pairs))

    def table_distance(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Clearance:
        """Return the height of the lowest point of all moving links above the table, at postures `q` (N, 7) [rad].

        The signed distance of a convex body from a half space is that of its lowest point. Finger gap
        `finger_width_m` (N,) [m]; the plant's default where None or NaN.

        Raises:
            UsageError: `q` is not (N, 7), or `finger_width_m` not (N,).
        """
        q, width = _arguments(q, finger_width_m)
        finite = np.isfinite(q).all(axis=-1)
        distance = np.full(len(q), np.nan)
        pairs: list[tuple[str, str] | None] = [None] * len(q)
        if finite.any() and self._movable:
            z = self._chain.motions(q[finite], width[finite])[:, :, 2]  # (N, stages, 4): third rows of R and p
            heights = np.stack([s.least(z[:, s.stage, :3]) + z[:, s.stage, 3] for s in self._movable])
            distance[finite] = heights.min(axis=0) - self.table_height_m
            for i, lowest in zip(np.flatnonzero(finite), heights.argmin(axis=0), strict=True):
                pairs[i] = (self._movable[lowest].link, TABLE)
        return Clearance(distance_m=distance, pair=tuple(pairs))

    def near_pairs(self, q: ArrayLike, within_m: float, finger_width_m: float | None = None) -> list[Proximity]:
        """Return the pairs of solids nearer than `within_m` [m] at posture `q` (7,) [rad] and gradients, nearest first.

        A link made of several solids appears once per near solid. The gradient is n . (J_A(a) - J_B(b)) with a and b
        the nearest points, J their translational Jacobians and n the direction from b to a (from a to b in
        penetration): the derivative wherever the nearest points are unique. Where they are not (parallel faces) it is
        the derivative for one of the candidates; it is 0 where Drake returns no direction. Finger gap
        `finger_width_m` [m]; the plant's default where None or NaN.

        Raises:
            UsageError: `q` is not (7,).
        """
        width = None if finger_width_m is None or np.isnan(finger_width_m) else finger_width_m
        query = self._plant.query(q, width)
        M = self._chain.current(self._plant.context)
        axis, point = (array[0] for array in self._chain.axes(M[None]))
        moment = _cross(point.T, axis.T).T
        near = []
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(within_m):
            A, B = self._solids[pair.id_A], self._solids[pair.id_B]
            distance, n = pair.distance, np.asarray(pair.nhat_BA_W)
            n = n if np.isfinite(n).all() else np.zeros(3)
            a = query.GetPoseInWorld(pair.id_A) @ pair.p_ACa
            b = query.GetPoseInWorld(pair.id_B) @ pair.p_BCb
            polytopes = A.axes is None and B.axes is None
            if polytopes and distance > 0.0 and float(_gap(A, B, M[None], n[None])[0]) < distance - _CERTAIN_M:
                a, b = _nearest(A, B, M)
                distance = float(np.linalg.norm(a - b))
                n = (a - b) / distance
            gradient = self._rate(A.link, a, n, axis, moment) - self._rate(B.link, b, n, axis, moment)
            link_a, link_b = _link_names(A, B)
            near.append(Proximity(link_a=link_a, link_b=link_b, distance_m=distance, gradient=gradient))
        z = M[self._stages, 2]  # (solids, 4)
        height = np.sum(z[:, :3] * self._centers, axis=-1) + z[:, 3] - self._radii - self.table_height_m
        for i in np.flatnonzero(height <= within_m):
            solid = self._movable[i]
            low = solid.lowest(z[i, :3])
            distance = float(z[i, :3] @ low + z[i, 3]) - self.table_height_m
            if distance <= within_m:
                low = M[solid.stage, :3, :3] @ low + M[solid.stage, :3, 3]
                gradient = self._rate(solid.link, low, _UP, axis, moment)
                near.append(Proximity(link_a=solid.link, link_b=TABLE, distance_m=distance, gradient=gradient))
        return sorted(near, key=lambda proximity: proximity.distance_m)

    def _rate(self, link: str, p: Array, n: Array, axis: Array, moment: Array) -> Array:
        """Return the speed (7,) along `n` of the point `p` fixed to a link per joint rate [m/rad].

        n . (axis x (p - point)) = axis . (p x n) + n . moment, with moment = point x axis.
        """
        return np.asarray(self._chain.carries(link) * (axis @ _cross(p, n) + moment @ n))


def _cross(a: Array, b: Array) -> Array:
    """Return cross products of vectors (3, ...), ten times faster than by NumPy's function for a few of them."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _link_names(A: _Solid, B: _Solid) -> tuple[str, str]:
    first, second = sorted((A, B), key=lambda solid: (solid.stage, solid.link))
    return first.link, second.link


def _gap(A: _Solid, B: _Solid, M: Array, n: Array) -> Array:
    """Return the width (N,) [m] of the empty slab between A and B along `n` (N, 3), by motions `M` (N, stages, 4, 4).

    It is at most the distance between them, and equal to it where `n` is the direction between the nearest points.
    """
    X_A, X_B = M[:, A.stage], M[:, B.stage]
    offset = np.einsum("ni,ni->n", n, X_A[:, :3, 3] - X_B[:, :3, 3])
    n_A, n_B = (np.einsum("ni,nij->nj", n, X[:, :3, :3]) for X in (X_A, X_B))
    return np.asarray(A.least(n_A) + B.least(-n_B) + offset)


def _nearest(A: _Solid, B: _Solid, M: Array) -> tuple[Array, Array]:
    """Return the nearest points (3,) of two separate polytopes, in B, by motions `M` (stages, 4, 4).

    Both are convex combinations of vertices; the weights are the non-negative least-squares solution of a - b = 0, with
    both sums of weights constrained to 1 by a heavy weight (C. L. Lawson and R. J. Hanson, "Solving Least Squares
    Problems", 1974, ch. 22 and 23).
    """
    points_A, points_B = (transform_points(M[solid.stage], solid.points) for solid in (A, B))
    heavy, n = 1e3, len(points_A)
    system = np.zeros((5, n + len(points_B)))
    system[:3, :n], system[:3, n:] = points_A.T, -points_B.T
    system[3, :n] = system[4, n:] = heavy
    weights, _ = nnls(system, np.array([0.0, 0.0, 0.0, heavy, heavy]), maxiter=100 * system.shape[1])
    a, b = weights[:n], weights[n:]
    return np.asarray(a @ points_A / a.sum()), np.asarray(b @ points_B / b.sum())


def _arguments(q: ArrayLike, finger_width_m: ArrayLike | None) -> tuple[Array, Array]:
    q = np.asarray(q, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != N_JOINTS:
        raise UsageError(f"q has shape {q.shape}, expected (N, {N_JOINTS}) arm joints in radians")
    width = np.full(len(q), np.nan) if finger_width_m is None else np.asarray(finger_width_m, dtype=np.float64)
    if width.shape != (len(q),):
        raise UsageError(f"finger_width_m has shape {width.shape}, expected ({len(q)},) as q has {len(q)} rows")
    return q, width


def _solid(inspector: Any, geometry: Any, link: str, chain: LinkChain) -> _Solid:
    """Return a collision geometry as points and an ellipsoid, in B at the zero posture."""
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
    """Return points (V, 3) [m] and the semi-axes (3, 3) [m] of the ellipsoid around each, in the frame of the shape."""
    origin = np.zeros((1, 3))
    match shape:
        case Box():
            signs = np.array(list(product((-1.0, 1.0), repeat=3)))
            return 0.5 * signs * shape.size(), None
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
    kind = type(shape).__name__
    raise InputError(f"a collision geometry is a {kind}; expected a mesh, box, cylinder, sphere, capsule or ellipsoid")


def _ends(length: float) -> Array:
    return np.array([[0.0, 0.0, -0.5 * length], [0.0, 0.0, 0.5 * length]])
