"""Simplification of triangle meshes."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.environment import native
from kinebench_drake.geometry import Array


def simplify(
    vertices: Array, faces: NDArray[np.int32], most: int, *, border_weight: float = 1.0
) -> tuple[Array, NDArray[np.int32]]:
    """Reduce a mesh to a number of triangles, by Open3D.

    By quadric error metrics (M. Garland and P. S. Heckbert, "Surface simplification using quadric error metrics",
    SIGGRAPH 1997).

    Args:
        vertices: (V, 3) [m]; equal ones are merged.
        faces: (N, 3) indices of vertices.
        most: largest number of triangles of the result.
        border_weight: weight of open edges, which a large one keeps in place.

    Returns:
        Vertices and faces of the simplified mesh.

    Raises:
        SetupError: Open3D's native libraries are missing.
    """
    o3d = native.load_open3d()
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces))
    mesh.remove_duplicated_vertices()
    mesh = mesh.simplify_quadric_decimation(most, boundary_weight=border_weight)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles, dtype=np.int32)
