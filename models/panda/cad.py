"""CAD surface of the robot: the URDF's visual meshes, ray casting against them, and their simplification.

All coordinates are in the frame of panda_hand, in metres. The left finger opens towards +y, the right one towards -y.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.environment import native
from kinebench_drake.geometry import Array, invert
from kinebench_drake.models.gripper import PARTS, GripperModel
from kinebench_drake.models.panda.description import ARM, GRIPPER, LINK_OF, RobotPart, source_urdf

FINGER_ORIGIN_H = np.array([0.0, 0.0, 0.0584])
"""(3,) origin of the finger frames when closed (panda_finger_joint1/2) [m]."""
MAX_FINGER_M = 0.04
"""Upper limit of each finger joint [m]; the gap between the pads is twice the joint position."""


def visual_file(part: RobotPart) -> Path:
    """Return the file of a part's visual mesh, in the frame of its link; the right finger is the left one turned."""
    name = "finger" if part in (RobotPart.LEFT_FINGER, RobotPart.RIGHT_FINGER) else LINK_OF[part].removeprefix("panda_")
    return source_urdf().parent / "franka_description" / "meshes" / "visual" / f"{name}.glb"


def _visual(part: RobotPart) -> trimesh.Trimesh:
    mesh = trimesh.load(visual_file(part), force="mesh")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh


@cache
def link_meshes() -> dict[RobotPart, trimesh.Trimesh]:
    """Load the meshes of the arm's links, each in the frame of its link."""
    return {part: _visual(part) for part in ARM}


@cache
def franka_hand() -> GripperModel:
    """Load the Franka hand."""
    hand = _visual(RobotPart.HAND)
    finger = _visual(RobotPart.LEFT_FINGER)
    left = finger.copy()
    right = finger.copy()
    right.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [0, 0, 1]))
    for mesh in (left, right):
        mesh.apply_translation(FINGER_ORIGIN_H)
    return GripperModel(parts=dict(zip(GRIPPER, (hand, left, right), strict=True)), max_finger_m=MAX_FINGER_M)


@dataclass(frozen=True, slots=True, kw_only=True)
class CadSurface:
    """First hits of N rays."""

    distance: Array
    """(N,) ray parameter of the first hit; inf without a hit."""
    part: NDArray[np.uint8]
    """(N,) values of `RobotPart`, BACKGROUND without a hit."""
    normal: Array
    """(N, 3) unit normal of the surface in the frame of the rays, towards their origin; 0 without a hit."""


class PartCaster:
    """Ray casting against bodies at any poses (one RaycastingScene of Open3D per body)."""

    def __init__(self, gripper: GripperModel, links: Mapping[RobotPart, trimesh.Trimesh]) -> None:
        """Build the scenes of a gripper and of links of the arm.

        Raises:
            SetupError: Open3D's native libraries are missing.
        """
        open3d = native.load_open3d()
        core: Any = open3d.core
        meshes = gripper.meshes | {int(part): mesh for part, mesh in links.items()}
        self._gripper = gripper
        self._part_of = gripper.part_of
        self._scenes: dict[int, Any] = {}
        self._tensor = core.Tensor
        for part, mesh in meshes.items():
            scene = open3d.t.geometry.RaycastingScene(nthreads=1)
            vertices = np.asarray(mesh.vertices, np.float32)
            scene.add_triangles(self._tensor(vertices), self._tensor(np.asarray(mesh.faces, np.uint32)))
            self._scenes[part] = scene
        self._centre = np.array([mesh.bounding_box.centroid for mesh in meshes.values()])
        reach = [mesh.vertices - centre for mesh, centre in zip(meshes.values(), self._centre, strict=True)]
        self._radius = np.array([np.linalg.norm(offset, axis=1).max() for offset in reach])

    def cast(self, X_VP: Array, rays_V: ArrayLike) -> CadSurface:
        """Cast rays `rays_V` (N, 3) from the origin of V against the bodies at poses `X_VP` (BODIES, 4, 4).

        `distance` is in units of the ray length: for rays with z = 1 it is the depth along the z axis of V [m].
        """
        rays_V = np.asarray(rays_V, dtype=np.float64)
        normal = np.zeros((len(rays_V), 3))
        distance, parts = self._trace(X_VP, rays_V, normal)
        norm = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, norm, out=normal, where=norm > 0)
        normal[(normal * rays_V).sum(axis=1) > 0] *= -1.0
        return CadSurface(distance=distance, part=parts, normal=normal)

    def first_hits(self, X_VP: Array, rays_V: ArrayLike) -> tuple[Array, NDArray[np.uint8]]:
        """Return `distance` and `part` of `cast`, without the normals, which take longer."""
        return self._trace(X_VP, np.asarray(rays_V, dtype=np.float64), None)

    def _trace(self, X_VP: Array, rays_V: Array, normal: Array | None) -> tuple[Array, NDArray[np.uint8]]:
        """Return distances (N,) and parts (N,) of first hits; fill `normal` (N, 3), not normalized, if there is one."""
        X_VP = self._gripper.complete(X_VP)
        distance = np.full(len(rays_V), np.inf, np.float32)
        parts = np.zeros(len(rays_V), np.uint8)
        X_PV = invert(X_VP)
        for (part, scene), towards in zip(self._scenes.items(), self._towards(X_VP, rays_V), strict=True):
            index = np.flatnonzero(towards)
            if not len(index):
                continue
            rays = np.empty((len(index), 6), np.float32)
            rays[:, :3], rays[:, 3:] = X_PV[part, :3, 3], rays_V[index] @ X_PV[part, :3, :3].T
            hits = scene.cast_rays(self._tensor(rays), nthreads=1)
            t = hits["t_hit"].numpy()
            nearer = t < distance[index]
            index = index[nearer]
            distance[index] = t[nearer]
            parts[index] = self._part_of[part]
            if normal is not None:
                normal[index] = hits["primitive_normals"].numpy()[nearer] @ X_PV[part, :3, :3]
        return distance.astype(np.float64), parts

    def _towards(self, X_VP: Array, rays_V: Array) -> NDArray[np.bool_]:
        """Return which rays (N, 3) meet the bounding sphere of each part, (scenes, N)."""
        parts = list(self._scenes)
        centre = (X_VP[parts, :3, :3] @ self._centre[..., None])[..., 0] + X_VP[parts, :3, 3]
        along = centre @ rays_V.T
        away = (centre**2).sum(axis=1, keepdims=True) - self._radius[:, None] ** 2
        return np.asarray((away <= 0) | ((along > 0) & (along**2 >= away * (rays_V**2).sum(axis=1))))


class GripperCad:
    """Ray casting against the gripper at any opening."""

    def __init__(self, gripper: GripperModel | None = None) -> None:
        """Build the scenes of a gripper, by default of the Franka hand.

        Raises:
            SetupError: Open3D's native libraries or mani_skill's meshes are missing.
        """
        self.gripper = gripper or franka_hand()
        self._caster = PartCaster(self.gripper, {})

    def cast(self, X_VH: ArrayLike, rays_V: ArrayLike, finger_m: float) -> CadSurface:
        """Cast rays `rays_V` (N, 3) from the origin of V against the gripper at pose `X_VH` (4, 4)."""
        return self._caster.cast(self._parts(X_VH, finger_m), rays_V)

    def first_hits(self, X_VH: ArrayLike, rays_V: ArrayLike, finger_m: float) -> tuple[Array, NDArray[np.uint8]]:
        """Return `distance` and `part` of `cast`, without the normals."""
        return self._caster.first_hits(self._parts(X_VH, finger_m), rays_V)

    def _parts(self, X_VH: ArrayLike, finger_m: float) -> Array:
        return self.gripper.open(np.tile(np.asarray(X_VH, dtype=np.float64), (PARTS, 1, 1)), finger_m)


def simplify(
    vertices: Array, faces: NDArray[np.int32], most: int, *, border_weight: float = 1.0
) -> tuple[Array, NDArray[np.int32]]:
    """Return `vertices` (V, 3) [m] and `faces` (N, 3) of a mesh reduced to at most `most` triangles, by Open3D.

    By quadric error metrics (M. Garland and P. S. Heckbert, "Surface simplification using quadric error metrics",
    SIGGRAPH 1997). Equal vertices are merged; a large `border_weight` keeps open edges in place.
    """
    o3d = native.load_open3d()
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces))
    mesh.remove_duplicated_vertices()
    mesh = mesh.simplify_quadric_decimation(most, boundary_weight=border_weight)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles, dtype=np.int32)
