"""Refinement of a pose by robust point-to-plane ICP (Open3D) against the visible CAD surface.

The CAD model is rendered at the current pose, and the observed cloud is registered to that visible surface alone, so
that points never match the far side. The largest distance of matched points shrinks from pass to pass. Point-to-plane
ICP after Chen and Medioni (1992), robust kernels after Babin et al. (ICRA 2019) as in Open3D.
"""

from typing import Any

import numpy as np

from kinebench_drake.environment import native
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.models.panda.cad import GripperCad

_GATES_M = (0.03, 0.015, 0.008, 0.004)  # largest distance between matched points in each pass
_MIN_POINTS = 30
_MAX_ITERATIONS = 12
_EDGE_JUMP = 0.03  # relative depth step to an adjacent cell that marks a depth edge


def gripper_cloud(view: GripperView) -> Array:
    """Return the points (N, 3) of the gripper cells in V [m], without cells on depth edges."""
    depth = np.where(view.gripper, view.depth_m, np.nan)
    jump = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        step = np.abs(np.diff(np.log(depth), axis=axis)) > _EDGE_JUMP
        before = [(0, 1) if a == axis else (0, 0) for a in (0, 1)]
        after = [(1, 0) if a == axis else (0, 0) for a in (0, 1)]
        jump |= np.pad(step, before) | np.pad(step, after)
    keep = view.gripper & ~jump & np.isfinite(depth)
    return np.asarray(view.rays()[keep] * depth[keep][:, None])


class IcpRefiner:
    """Open3D ICP against the visible surface of the gripper."""

    def __init__(self, cad: GripperCad) -> None:
        native.prepare_open3d()
        import open3d

        self._cad = cad
        self._geometry: Any = open3d.geometry
        self._vector = open3d.utility.Vector3dVector
        self._icp: Any = open3d.pipelines.registration

    def refine(self, view: GripperView, X_VH: Array, finger_m: float) -> Array | None:
        """Refine `X_VH` (4, 4) on the view's cloud, fingers at travel `finger_m`; None if too few points match."""
        cloud_V = gripper_cloud(view)
        if len(cloud_V) < _MIN_POINTS:
            return None
        rays = view.rays().reshape(-1, 3)
        source, target = self._geometry.PointCloud(), self._geometry.PointCloud()
        source.points = self._vector(cloud_V)
        for gate in _GATES_M:
            surface = self._cad.cast(X_VH, rays, finger_m)
            hit = surface.part > 0
            if hit.sum() < _MIN_POINTS:
                return None
            target.points = self._vector(transform_points(invert(X_VH), rays[hit] * surface.distance[hit, None]))
            target.normals = self._vector(surface.normal[hit] @ X_VH[:3, :3])
            estimation = self._icp.TransformationEstimationPointToPlane(self._icp.TukeyLoss(k=gate))
            criteria = self._icp.ICPConvergenceCriteria(1e-5, 1e-5, _MAX_ITERATIONS)
            result = self._icp.registration_icp(source, target, gate, invert(X_VH), estimation, criteria)
            if len(result.correspondence_set) < _MIN_POINTS:
                return None
            X_VH = invert(result.transformation)
        return X_VH
