"""The arm's surfaces as triangle meshes light enough for a web page."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, Role, Sphere
from pydrake.multibody.tree import BodyIndex

from kinebench_drake.environment import native
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant

MAX_TRIANGLES = 1600
"""Triangles that a link is simplified to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkMesh:
    """What can be seen of one link."""

    link: str
    vertices: Array
    """(N, 3) in the link's frame [m]."""
    faces: NDArray[np.int32]
    """(M, 3) indices of vertices."""


def link_meshes(plant: ArmPlant) -> tuple[LinkMesh, ...]:
    """Surfaces of all links that have one: the URDF's visual elements, or its collision elements where there are none.

    Takes some three seconds for the Panda.

    Raises:
        SetupError: Open3D's native libraries are missing.
    """
    inspector = plant.diagram.GetSubsystemByName("scene_graph").model_inspector()
    surfaces = []
    for index in range(plant.drake.num_bodies()):
        body = plant.drake.get_body(BodyIndex(index))
        frame = plant.drake.GetBodyFrameIdIfExists(body.index())
        if frame is None:
            continue
        roles = [inspector.GetGeometries(frame, role) for role in (Role.kPerception, Role.kProximity)]
        parts = []
        for geometry in next((found for found in roles if found), ()):
            part = _mesh(inspector.GetShape(geometry))
            if part is not None:
                parts.append(part.apply_transform(inspector.GetPoseInFrame(geometry).GetAsMatrix4()))
        if parts:
            vertices, faces = _simplified(trimesh.util.concatenate(parts))
            surfaces.append(LinkMesh(link=body.name(), vertices=vertices, faces=faces))
    return tuple(surfaces)


def _mesh(shape: Any) -> Any:
    """A shape of Drake's as a mesh of trimesh's; None for one that has no surface to show."""
    match shape:
        case Mesh() | Convex():
            mesh = trimesh.load(str(shape.source().path()), force="mesh", process=False)
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            return mesh.apply_transform(np.diag([*shape.scale3(), 1.0]))
        case Box():
            return trimesh.creation.box(shape.size())
        case Cylinder():
            return trimesh.creation.cylinder(shape.radius(), shape.length(), sections=32)
        case Capsule():
            return trimesh.creation.capsule(shape.length(), shape.radius())
        case Sphere():
            return trimesh.creation.icosphere(2, shape.radius())
        case Ellipsoid():
            unit = trimesh.creation.icosphere(2)
            return unit.apply_transform(np.diag([shape.a(), shape.b(), shape.c(), 1.0]))
    return None


def _simplified(mesh: Any) -> tuple[Array, NDArray[np.int32]]:
    """Vertices and faces of a mesh, of MAX_TRIANGLES at most.

    By quadric error metrics (M. Garland and P. S. Heckbert, "Surface simplification using quadric error metrics",
    SIGGRAPH 1997) as Open3D has it.
    """
    if len(mesh.faces) <= MAX_TRIANGLES:
        return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)
    native.prepare_open3d()
    import open3d

    full = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces)
    )
    light = full.simplify_quadric_decimation(MAX_TRIANGLES)
    return np.asarray(light.vertices), np.asarray(light.triangles, dtype=np.int32)
