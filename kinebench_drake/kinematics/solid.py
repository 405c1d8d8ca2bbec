"""Convex bodies of the arm's links: the hulls of their collision meshes, or the primitives in their place."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Sphere
from scipy.optimize import nnls

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.kinematics.chain import LinkChain


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
    shape = inspector.GetShape(geometry)
    points, axes = _shape(shape, inspector.GetConvexHull(geometry))
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
