"""CAD surface of the gripper: hand and fingers as the URDF's visual meshes, rendered by ray casting.

All coordinates are in the frame of panda_hand, in metres. The left finger opens towards +y, the right one towards -y.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.environment import native
from kinebench_drake.geometry import Array, invert
from kinebench_drake.models.panda.robot import ARM, GRIPPER, LINK_OF, OPENING_SIGN, RobotPart, source_urdf

FINGER_ORIGIN_H = np.array([0.0, 0.0, 0.0584])
"""(3,) origin of the finger frames when closed (panda_finger_joint1/2) [m]."""
MAX_FINGER_M = 0.04
"""Upper limit of each finger joint [m]; the gap between the pads is twice the joint position."""


def _visual(name: str) -> trimesh.Trimesh:
    mesh = trimesh.load(source_urdf().parent / "franka_description" / "meshes" / "visual" / name, force="mesh")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh


@cache
def link_meshes() -> dict[RobotPart, trimesh.Trimesh]:
    """Load the meshes of the arm's links, each in the frame of its link.

    Raises:
        SetupError: mani_skill, which contains the meshes, is not installed.
    """
    return {part: _visual(f"{LINK_OF[part].removeprefix('panda_')}.glb") for part in ARM}


@cache
def part_meshes() -> dict[RobotPart, trimesh.Trimesh]:
    """Load the meshes of hand, left and right finger (closed), in the frame of the hand.

    Raises:
        SetupError: mani_skill, which contains the meshes, is not installed.
    """
    hand, finger = _visual("hand.glb"), _visual("finger.glb")
    left, right = finger.copy(), finger.copy()
    right.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [0, 0, 1]))
    for mesh in (left, right):
        mesh.apply_translation(FINGER_ORIGIN_H)
    return dict(zip(GRIPPER, (hand, left, right), strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class CadSurface:
    """First hits of N rays."""

    distance: Array
    """(N,) ray parameter of the first hit; inf without a hit."""
    part: NDArray[np.uint8]
    """(N,) values of `RobotPart`, BACKGROUND without a hit."""
    normal_H: Array
    """(N, 3) unit normal of the surface, 0 without a hit."""


class GripperCad:
    """Ray casting against the gripper at any opening (one RaycastingScene of Open3D per part)."""

    def __init__(self) -> None:
        """Build the scenes.

        Raises:
            SetupError: Open3D's native libraries or mani_skill's meshes are missing.
        """
        native.prepare_open3d()
        import open3d

        self._scenes: dict[RobotPart, Any] = {}
        core: Any = open3d.core
        self._tensor = core.Tensor
        for part, mesh in part_meshes().items():
            scene = open3d.t.geometry.RaycastingScene(nthreads=1)
            vertices = np.asarray(mesh.vertices, np.float32)
            faces = np.asarray(mesh.faces, np.uint32)
            scene.add_triangles(self._tensor(vertices), self._tensor(faces))
            self._scenes[part] = scene

    def cast(self, X_VH: ArrayLike, rays_V: ArrayLike, finger_m: float) -> CadSurface:
        """Cast rays `rays_V` (N, 3) from the origin of V against the gripper at pose `X_VH` (4, 4).

        `distance` is in units of the ray length: for rays with z = 1 it is the depth along the z axis of V [m].
        """
        X_HV = invert(X_VH)
        directions = np.asarray(rays_V, dtype=np.float64) @ X_HV[:3, :3].T
        n = len(directions)
        distance = np.full(n, np.inf)
        parts, normal = np.zeros(n, np.uint8), np.zeros((n, 3))
        rays = np.empty((n, 6), np.float32)
        rays[:, 3:] = directions
        for part, scene in self._scenes.items():
            rays[:, :3] = X_HV[:3, 3] - [0.0, OPENING_SIGN[part] * finger_m, 0.0]
            hits = scene.cast_rays(self._tensor(rays), nthreads=1)
            t = hits["t_hit"].numpy()
            nearer = t < distance
            distance[nearer], parts[nearer] = t[nearer], part
            normal[nearer] = hits["primitive_normals"].numpy()[nearer]
        norm = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, norm, out=normal, where=norm > 0)
        normal[(normal * directions).sum(axis=1) > 0] *= -1.0  # towards the viewer
        return CadSurface(distance=distance, part=parts, normal_H=normal)
