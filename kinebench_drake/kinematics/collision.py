"""Distances of the arm from itself, from obstacles and from the table, and their gradients.

Every link is the convex hull of its collision mesh (or the primitive in its place), as in Drake's proximity engine;
ManiSkill simulates the Panda with the same hulls. Hulls fill the concavities of the links: a penetration means contact
in simulation, while the real arm may have up to about 2 cm of clearance there. Pairs of links that the robot's SRDF
excludes are ignored. The table is the plane z = const of B; links fixed to the base stand on it and are exempt.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Role, Sphere
from scipy.optimize import nnls

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.kinematics.chain import LinkChain
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.obstacles import is_obstacle
from kinebench_drake.segments import spread


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
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

    def box(self) -> tuple[Array, Array]:
        """Return the corners (3,) of the box along the axes of B around the solid at the zero posture [m]."""
        margin = 0.0 if self.axes is None else np.linalg.norm(self.axes, axis=1)
        return self.points.min(axis=0) - margin, self.points.max(axis=0) + margin

    def lowest(self, n: Array) -> Array:
        """Return the point x (3,) of the solid at the zero posture with the least n . x."""
        point = self.points[np.argmin(self.points @ n)]
        if self.axes is not None and (norm := np.linalg.norm(n @ self.axes)) > 0.0:
            point = point - self.axes @ (n @ self.axes) / norm
        return np.asarray(point)


def slab_width(A: Solid, B: Solid, M: Array, n: Array) -> Array:
    """Return the width (N,) [m] of the empty slab between A and B along `n` (N, 3), by motions `M` (N, stages, 4, 4).

    It is at most the distance between them, and equal to it where `n` is the direction between the nearest points.
    """
    X_A = M[:, A.stage]
    X_B = M[:, B.stage]
    offset = np.einsum("ni,ni->n", n, X_A[:, :3, 3] - X_B[:, :3, 3])
    n_A, n_B = (np.einsum("ni,nij->nj", n, X[:, :3, :3]) for X in (X_A, X_B))
    return np.asarray(A.least(n_A) + B.least(-n_B) + offset)


def nearest_points(A: Solid, B: Solid, M: Array) -> tuple[Array, Array]:
    """Return the nearest points (3,) of two separate polytopes, in B, by motions `M` (stages, 4, 4).

    Both are convex combinations of vertices, by non-negative least squares of a - b = 0 with both sums of weights held
    at 1 by a heavy weight (C. L. Lawson and R. J. Hanson, "Solving Least Squares Problems", 1974, ch. 22 and 23).
    """
    points_A, points_B = (transform_points(M[solid.stage], solid.points) for solid in (A, B))
    heavy = 1e3
    n = len(points_A)
    system = np.zeros((5, n + len(points_B)))
    system[:3, :n] = points_A.T
    system[:3, n:] = -points_B.T
    system[3, :n] = system[4, n:] = heavy
    weights, _ = nnls(system, np.array([0.0, 0.0, 0.0, heavy, heavy]), maxiter=100 * system.shape[1])
    a = weights[:n]
    b = weights[n:]
    return np.asarray(a @ points_A / a.sum()), np.asarray(b @ points_B / b.sum())


def read_solid(inspector: Any, geometry: Any, link: str, chain: LinkChain) -> Solid:
    """Return a collision geometry as points and an ellipsoid, in B at the zero posture."""
    points, axes = _shape(inspector.GetShape(geometry), inspector.GetConvexHull(geometry))
    X = chain.home[link] @ inspector.GetPoseInFrame(geometry).GetAsMatrix4()
    return Solid(
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
            return 0.5 * np.array(list(product((-1.0, 1.0), repeat=3))) * shape.size(), None
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


TABLE = "table"
"""Name of the table in pairs of links."""

_REACH_M = 0.25  # greatest first search radius of self distances; the Panda is hardly ever farther from itself
_FAR_M = 0.06  # distance beyond the least up to which pairs are followed along a motion
# Drake's iteration for the distance of two hulls sometimes stops early, with points that are not the nearest: too far
# by 8 mm at worst in a million random postures of the Panda, never with the wrong sign. So each distance is compared
# with the width of the slab that separates the two solids, and computed again where the two differ.
_CERTAIN_M = 1e-6
_DOUBT_M = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Clearance:
    """Least distance of N postures from a collision."""

    distance_m: Array
    """(N,) signed distance [m], negative: depth of penetration; NaN where q is NaN or nothing can collide."""
    pair: tuple[tuple[str, str] | None, ...]
    """(N,) the two nearest links, base first, or a link and "table" or an obstacle; None where the distance is NaN."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Proximity:
    """Two solids near each other at one posture."""

    link_a: str
    link_b: str
    """The second link, "table", or the link of an obstacle."""
    distance_m: float
    """Signed distance [m], negative: depth of penetration."""
    gradient: Array
    """(J,) derivative of the distance with respect to the joint angles [m/rad]."""


class CollisionModel:
    """Distances of an arm from itself, from the robot's obstacles and from the table. Uses the plant's context."""

    def __init__(self, plant: ArmPlant, *, table_height_m: float = 0.0) -> None:
        """Read the solids of the plant; the table is at z = `table_height_m` in B [m].

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
        self._solids: dict[Any, Solid] = {}
        for geometry in inspector.GetAllGeometryIds(Role.kProximity):
            link = plant.drake.GetBodyFromFrameId(inspector.GetFrameId(geometry)).name()
            self._solids[geometry] = read_solid(inspector, geometry, link, self._chain)
        self.obstacles = tuple(solid for solid in self._solids.values() if is_obstacle(solid.link))
        """Solids of the obstacles."""
        self._blocks = {geometry for geometry, solid in self._solids.items() if is_obstacle(solid.link)}
        self.movable = [solid for solid in self._solids.values() if solid.stage > 0]
        """Solids of the moving links."""
        self._stages = np.array([solid.stage for solid in self.movable], dtype=np.intp)
        balls = [solid.ball() for solid in self.movable]
        none = Clearance(distance_m=np.zeros(0), pair=())
        self._last = b"", (none, none)  # of the same path ask search and judgement
        self.centers = np.reshape([center for center, _ in balls], (-1, 3))
        """(S, 3) centres of the balls around them, in B at the zero posture [m]."""
        self.radii = np.array([radius for _, radius in balls])
        """(S,) radii of these balls [m]."""

    def arm_solids(self) -> dict[Any, Solid]:
        """Return the solids of the arm, without obstacles, by Drake's ids."""
        return {id: solid for id, solid in self._solids.items() if id not in self._blocks}

    def self_distance(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Clearance:
        """Return the least distance between two links that must not touch, exact to 1e-6 m for polytopes.

        Postures `q` (N, J) [rad]; finger gap `finger_width_m` (N,) [m], the plant's default where None or NaN.
        """
        return self._clearances(q, finger_width_m)[0]

    def obstacle_distance(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Clearance:
        """Return the least distance from an obstacle; NaN where none is touched and the arm is nearer to itself.

        Arguments and errors as in `self_distance`.
        """
        return self._clearances(q, finger_width_m)[1]

    def _clearances(self, q: ArrayLike, finger_width_m: ArrayLike | None) -> tuple[Clearance, Clearance]:
        """Return the distances from the arm itself and from obstacles."""
        q, width = _arguments(q, finger_width_m)
        asked = q.tobytes() + width.tobytes()
        if asked != self._last[0]:
            rows = np.flatnonzero(np.isfinite(q).all(axis=-1))
            M = self._chain.motions(q[rows], width[rows])
            least, pairs, _ = self._measure(q[rows], width[rows], M, _DOUBT_M)
            names: list[list[tuple[str, str] | None]] = [[None] * len(q), [None] * len(q)]
            for own, measured in zip(names, pairs, strict=True):
                for row, pair in zip(rows, measured, strict=True):
                    own[row] = None if pair is None else _link_names(*pair)
            itself, obstacles = (
                Clearance(distance_m=spread(distance, rows, len(q)), pair=tuple(own))
                for distance, own in zip(least, names, strict=True)
            )
            self._last = asked, (itself, obstacles)
        return self._last[1]

    def least_distances(self, q: Array, finger_width_m: Array | None, every: int, within_m: float) -> Array:
        """Return distances (N,) [m] from itself and obstacles wherever they may be the least, or at most `within_m`.

        Else NaN. One posture in `every` is measured in any case. At others a plane between each two solids that are
        near each other at the nearest measured posture shows that they are farther apart; solids far from each other
        have not moved enough.

        Args:
            q: (N, J) postures [rad], finite.
            finger_width_m: (N,) finger gap [m]; None for the plant's default.
            every: number of postures from one that is measured in any case to the next.
            within_m: distance of interest [m].
        """
        q, width = _arguments(q, finger_width_m)
        M = self._chain.motions(q, width)
        distance = np.full(len(q), np.nan)
        at = np.arange(0, len(q), every)
        least, _, near = self._measure(q[at], width[at], M[at], _FAR_M)
        distance[at] = np.fmin(*least)
        if np.isnan(distance[at]).all():  # nothing can collide
            return distance
        within_m = max(float(distance[at].min()), within_m)
        rest = np.flatnonzero(np.isnan(distance))
        nearest = np.minimum((rest + every // 2) // every, len(at) - 1)
        moved = 2.0 * self._way(M[at][nearest], M[rest])
        bound = distance[at][nearest] + _FAR_M - _DOUBT_M - moved
        for (id_A, id_B), entries in near.items():
            n = np.full((len(at), 3), np.nan)
            apart = np.full(len(at), np.inf)
            for row, pair in entries:
                n[row], apart[row] = pair.nhat_BA_W, pair.distance - _DOUBT_M
            close = np.flatnonzero(apart[nearest] - moved <= within_m)
            width_m = slab_width(self._solids[id_A], self._solids[id_B], M[rest[close]], n[nearest[close]])
            bound[close] = np.minimum(bound[close], width_m)
        unsure = rest[~(bound > within_m)]
        distance[unsure] = np.fmin(*self._measure(q[unsure], width[unsure], M[unsure], _DOUBT_M)[0])
        return distance

    def _way(self, M_from: Array, M_to: Array) -> Array:
        """Return upper bounds (N,) [m] of the way of all points of the solids, by motions (N, stages, 4, 4)."""
        change = (M_to - M_from)[:, self._stages]
        # The points of a ball move at most as far as its centre and, by its rotation, its radius * |R' - R|.
        center = (change[..., :3, :3] @ self.centers[..., None])[..., 0] + change[..., :3, 3]
        turn = np.linalg.norm(change[..., :3, :3], axis=(-2, -1)) / np.sqrt(2.0)
        return np.asarray((np.linalg.norm(center, axis=-1) + self.radii * turn).max(axis=-1, initial=0.0))

    def _measure(
        self, q: Array, width: Array, M: Array, beyond_m: float
    ) -> tuple[Array, list[list[tuple[Solid, Solid] | None]], dict[tuple[Any, Any], list[tuple[int, Any]]]]:
        """Return the least distances (2, N) [m] of postures with motions `M` from the arm itself and from obstacles.

        They are NaN where nothing can collide, and where obstacles are neither touched nor up to `beyond_m` farther
        than the arm from itself. Also returned: the solids they are between; rows and results of Drake for all pairs of
        solids that are up to `beyond_m` farther apart than the nearest.
        """
        near: dict[tuple[Any, Any], list[tuple[int, Any]]] = {}
        closest = np.full(len(q), np.inf)
        reach = _REACH_M
        for i, row in enumerate(q):
            query = self._plant.query(row, None if np.isnan(width[i]) else float(width[i]))
            # Pairs that cannot be the nearest cost time. Along a motion the distance changes little from row to row.
            for reach_m in (reach, np.inf):
                results = query.ComputeSignedDistancePairwiseClosestPoints(reach_m)
                distances = [pair.distance for pair in results]
                own = (
                    d for d, pair in zip(distances, results, strict=True) if not self._blocks & {pair.id_A, pair.id_B}
                )
                closest[i] = max(min(own if self._blocks else distances, default=np.inf), 0.0)
                if closest[i] + beyond_m <= reach_m:
                    break
            reach = min(closest[i] + beyond_m + _DOUBT_M, _REACH_M)
            for distance, pair in zip(distances, results, strict=True):
                if distance <= closest[i] + beyond_m:
                    near.setdefault((pair.id_A, pair.id_B), []).append((i, pair))
        least = np.full((2, len(q)), np.inf)
        solids: list[list[tuple[Solid, Solid] | None]] = [[None] * len(q), [None] * len(q)]
        doubtful: list[tuple[float, int, int, tuple[Solid, Solid]]] = []
        for (id_A, id_B), entries in near.items():
            A = self._solids[id_A]
            B = self._solids[id_B]
            entries = [(i, pair) for i, pair in entries if pair.distance <= closest[i] + _DOUBT_M]
            if not entries:
                continue
            frames = np.array([frame for frame, _ in entries])
            distance = np.array([pair.distance for _, pair in entries])
            gap = slab_width(A, B, M[frames], np.array([pair.nhat_BA_W for _, pair in entries]))
            kind = int(bool(self._blocks & {id_A, id_B}))
            unsure = (distance > 0.0) & (gap < distance - _CERTAIN_M) & (A.axes is None) & (B.axes is None)
            doubtful += [(bound, i, kind, (A, B)) for bound, i in zip(gap[unsure], frames[unsure], strict=True)]
            for frame, value in zip(frames[~unsure], distance[~unsure], strict=True):
                if value < least[kind, frame]:
                    least[kind, frame] = value
                    solids[kind][frame] = (A, B)
        for bound, frame, kind, pair in sorted(doubtful, key=lambda entry: entry[0]):
            if bound < least[kind, frame]:  # the distance is no less than the gap
                a, b = nearest_points(*pair, M[frame])
                if (apart := float(np.linalg.norm(a - b))) < least[kind, frame]:
                    least[kind, frame] = apart
                    solids[kind][frame] = pair
        least[np.isinf(least)] = np.nan
        return least, solids, near

    def table_distance(self, q: ArrayLike, finger_width_m: ArrayLike | None = None) -> Clearance:
        """Return the height of the lowest point of all moving links above the table, at postures `q` (N, J) [rad].

        The signed distance of a convex body from a half space is that of its lowest point. Finger gap
        `finger_width_m` (N,) [m]; the plant's default where None or NaN.
        """
        q, width = _arguments(q, finger_width_m)
        finite = np.isfinite(q).all(axis=-1)
        distance = np.full(len(q), np.nan)
        pairs: list[tuple[str, str] | None] = [None] * len(q)
        if finite.any() and self.movable:
            z = self._chain.motions(q[finite], width[finite])[:, :, 2]  # (N, stages, 4): third rows of R and p
            heights = np.stack([s.least(z[:, s.stage, :3]) + z[:, s.stage, 3] for s in self.movable])
            distance[finite] = heights.min(axis=0) - self.table_height_m
            for i, lowest in zip(np.flatnonzero(finite), heights.argmin(axis=0), strict=True):
                pairs[i] = (self.movable[lowest].link, TABLE)
        return Clearance(distance_m=distance, pair=tuple(pairs))

    def near_pairs(self, q: ArrayLike, within_m: float, finger_width_m: float | None = None) -> list[Proximity]:
        """Return the pairs of solids nearer than `within_m` [m] at posture `q` (J,) [rad] and gradients, nearest first.

        A link made of several solids appears once per near solid. The gradient is n . (J_A(a) - J_B(b)) with a and b
        the nearest points, J their translational Jacobians and n the direction from b to a (from a to b in
        penetration); where the nearest points are not unique, that of one candidate; 0 where Drake returns no
        direction. Finger gap `finger_width_m` [m]; the plant's default where None or NaN.
        """
        width = None if finger_width_m is None or np.isnan(finger_width_m) else finger_width_m
        query = self._plant.query(q, width)
        M = self._chain.current(self._plant.context)
        axis, moment = (array[0] for array in self._chain.twists(M[None]))
        moment = np.asfortranarray(moment)
        near = []
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(within_m):
            A = self._solids[pair.id_A]
            B = self._solids[pair.id_B]
            distance = pair.distance
            n = np.asarray(pair.nhat_BA_W)
            n = n if np.isfinite(n).all() else np.zeros(3)
            a = query.GetPoseInWorld(pair.id_A) @ pair.p_ACa
            b = query.GetPoseInWorld(pair.id_B) @ pair.p_BCb
            polytopes = A.axes is None and B.axes is None
            if polytopes and distance > 0.0 and float(slab_width(A, B, M[None], n[None])[0]) < distance - _CERTAIN_M:
                a, b = nearest_points(A, B, M)
                distance = float(np.linalg.norm(a - b))
                n = (a - b) / distance
            gradient = self._rate(A.link, a, n, axis, moment) - self._rate(B.link, b, n, axis, moment)
            link_a, link_b = _link_names(A, B)
            near.append(Proximity(link_a=link_a, link_b=link_b, distance_m=distance, gradient=gradient))
        z = M[self._stages, 2]  # (solids, 4)
        height = np.sum(z[:, :3] * self.centers, axis=-1) + z[:, 3] - self.radii - self.table_height_m
        for i in np.flatnonzero(height <= within_m):
            solid = self.movable[i]
            low = solid.lowest(z[i, :3])
            distance = float(z[i, :3] @ low + z[i, 3]) - self.table_height_m
            if distance <= within_m:
                low = M[solid.stage, :3, :3] @ low + M[solid.stage, :3, 3]
                gradient = self._rate(solid.link, low, np.array([0.0, 0.0, 1.0]), axis, moment)
                near.append(Proximity(link_a=solid.link, link_b=TABLE, distance_m=distance, gradient=gradient))
        return sorted(near, key=lambda proximity: proximity.distance_m)

    def near_obstacles(
        self, q: Array, finger_width_m: float, M: Array, within_m: float, wanted: NDArray[np.bool_]
    ) -> Iterator[tuple[int, int, float, float]]:
        """Yield those of the `wanted` pairs (S, O) of a moving solid and an obstacle that are nearer than `within_m`.

        Numbers of both, their distance by Drake, and a lower bound of it that needs no iteration: the width of a slab
        between them [m]. Posture `q` (J,) [rad] with its motions `M` (stages, 4, 4).
        """
        query = self._plant.query(q, finger_width_m)
        for pair in query.ComputeSignedDistancePairwiseClosestPoints(within_m):
            if self._blocks & {pair.id_A, pair.id_B}:
                A = self._solids[pair.id_A]
                B = self._solids[pair.id_B]
                a, b = (A, B) if pair.id_B in self._blocks else (B, A)
                place = self.movable.index(a), self.obstacles.index(b)
                if wanted[place]:
                    n = np.asarray(pair.nhat_BA_W)
                    bound = float(slab_width(A, B, M[None], n[None])[0]) if np.isfinite(n).all() else -np.inf
                    yield *place, max(pair.distance, bound) if pair.distance < 0.0 else pair.distance, bound

    def _rate(self, link: str, p: Array, n: Array, axis: Array, moment: Array) -> Array:
        """Return the speed (J,) along `n` of the point `p` fixed to a link per joint rate [m/rad].

        n . (axis x (p - point)) = axis . (p x n) + n . moment, with moment = point x axis.
        """
        return np.asarray(self._chain.carries(link) * (axis @ _cross(p, n) + moment @ n))


def _cross(a: Array, b: Array) -> Array:
    """Return cross products of vectors (3, ...), ten times faster than by NumPy's function for a few of them."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _link_names(A: Solid, B: Solid) -> tuple[str, str]:
    first, second = sorted((A, B), key=lambda solid: (is_obstacle(solid.link), solid.stage, solid.link))
    return first.link, second.link


def _arguments(q: ArrayLike, finger_width_m: ArrayLike | None) -> tuple[Array, Array]:
    """Return postures (N, J) [rad] and finger gaps (N,) [m], NaN for the plant's default, as arrays.

    Raises:
        UsageError: there are not as many gaps as postures.
    """
    q = np.asarray(q, dtype=np.float64)
    width = np.full(len(q), np.nan) if finger_width_m is None else np.asarray(finger_width_m, dtype=np.float64)
    if width.shape != (len(q),):
        raise UsageError(f"finger_width_m has shape {width.shape}, expected ({len(q)},) as q has {len(q)} rows")
    return q, width
