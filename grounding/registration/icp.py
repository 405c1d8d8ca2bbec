"""Registration of the estimated depth to the CAD surface by robust point-to-plane ICP (Open3D), and its precision.

The depth of the gripper's cells, freed of the factor that all of them have in common, is registered to the surface
that is visible at the current pose, so that points never match the far side. Point-to-plane ICP after Chen and Medioni
(1992), robust kernels after Babin et al. (ICRA 2019) as in Open3D.

The covariance follows from the residuals. Errors of an estimated depth are smooth over the gripper, so their variance
is that of means over a dozen blocks of cells, corrected for what the registration absorbs, and all blocks together
count as two measurements. Errors as smooth as a tilt leave no residual, yet turn the pose: the covariance is inflated
until registration and fit are consistent (chi-square test).

The pose is combined with the fit by covariance intersection (Julier and Uhlmann, ACC 1997), which is consistent for any
correlation of the two: both rest on the same depth.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from kinebench_drake.environment import native
from kinebench_drake.geometry import (
    Array,
    cross,
    invert,
    make_pose,
    rotation_angle,
    rotation_exp,
    rotation_log,
    transform_points,
)
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.panda.cad import GripperCad

_MAX_CELLS = 500
"""Greatest number of cells of the gripper that are registered first."""
_PRECISE_WEIGHT = 0.3
"""Weight of the registration from which on all cells are registered."""
_MIN_POINTS = 30
_PASSES = 3
_MAX_ITERATIONS = 8
_CONVERGED_M = 3e-4
"""Least change of the pose that another pass follows [m]."""
_LEVER_M = 0.05
"""Distance at which a rotation counts as a displacement [m]."""
_GATE_M = (2.5e-3, 0.03)
"""Least and largest distance between matched points [m]."""
_GATE_SIGMAS = 3.0
"""Largest distance between matched points in robust standard deviations of the residuals."""
_EDGE_JUMP = 0.03
"""Relative step of the depth to an adjacent cell that marks a depth edge."""
_BLOCKS = 12
"""Number of blocks of cells whose means give the variance."""
_INDEPENDENT = 2.0
"""Independent measurements that all blocks together count as."""
_DEGREES_OF_FREEDOM = 6
_MIN_BLOCKS = 7
_LEAST_VARIANCE_M2 = 1e-10
_REGULARIZATION = np.diag([1e-6] * 3 + [1e-4] * 3)
"""Information of unobservable directions, relative to that of a point."""
_FIT_VARIANCE_RATIO = 3.5
"""Mean squared error of fits over their covariance, on held-out videos."""
_FIT_FLOOR = np.diag([1e-8] * 3 + [1e-10] * 3)
"""Least covariance of a fit [rad^2, m^2]: an arm may be stretched out."""
_LARGEST_SQUARE = 12.6
"""95 % quantile of chi-square with six degrees of freedom."""
_INFLATIONS = np.geomspace(1.0, 1e8, 161)
_WEIGHTS = np.linspace(0.0, 1.0, 101)


@dataclass(frozen=True, slots=True, kw_only=True)
class IcpRegistration:
    """Pose of the hand by ICP."""

    X_CH: Array
    """(4, 4) pose of panda_hand in the camera frame [m]."""
    fitness: float
    """Share of the points that are matched with the CAD surface, 0..1."""
    rmse_m: float
    """Root mean square distance of the matched points from the surface [m]."""
    covariance: Array
    """(6, 6) covariance of rotation about the camera's axes [rad] and position [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FusedPose:
    """Combination of a fit with the registration."""

    X_fit: Array
    """(4, 4) fitted pose of panda_hand in the camera frame [m]."""
    registration: IcpRegistration
    weight: float
    """Share of the registration, 0..1."""
    X_CH: Array
    """(4, 4) combined pose of panda_hand in the camera frame [m]."""
    covariance: Array
    """(6, 6) its covariance, on the scale of the fit's."""


def surface_cells(view: GripperView) -> NDArray[np.bool_]:
    """Return the cells (h, w) of the gripper that are not on depth edges."""
    depth = np.where(view.gripper, view.depth_m, np.nan)
    jump = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        step = np.abs(np.diff(np.log(depth), axis=axis)) > _EDGE_JUMP
        for side in ((0, 1), (1, 0)):  # both cells beside it
            jump |= np.pad(step, [side if a == axis else (0, 0) for a in (0, 1)])
    return np.asarray(view.gripper & ~jump & np.isfinite(depth))


class IcpRefiner:
    """Open3D ICP against the visible surface of the gripper."""

    def __init__(self, cad: GripperCad) -> None:
        open3d = native.load_open3d()
        self._cad = cad
        self._geometry: Any = open3d.geometry
        self._vector = open3d.utility.Vector3dVector
        self._icp: Any = open3d.pipelines.registration

    def refine(self, view: GripperView, X_CH: Array, covariance: Array, finger_m: float) -> FusedPose | None:
        """Combine a fit with the registration that starts from it; None if too few points match.

        If the registration counts, its last pass is repeated with all cells.

        Args:
            view: dense estimates.
            X_CH: (4, 4) fitted pose of panda_hand in the camera frame [m].
            covariance: (6, 6) its covariance: rotation about the camera's axes [rad], position [m].
            finger_m: travel of each finger [m].
        """
        registration = self.register(view, X_CH, covariance, finger_m)
        if registration is None:
            return None
        fused = fuse(X_CH, covariance, registration)
        if fused.weight < _PRECISE_WEIGHT:
            return fused
        finer = self.register(view, registration.X_CH, registration.covariance, finger_m, view.part.size)
        return fused if finer is None else fuse(X_CH, covariance, finer)

    def register(
        self, view: GripperView, X_CH: Array, covariance: Array, finger_m: float, cells: int = _MAX_CELLS
    ) -> IcpRegistration | None:
        """Register at most `cells` cells of a view to the CAD surface; None if too few match. Arguments as `refine`."""
        surface_only = surface_cells(view)
        row = np.arange(len(surface_only)) % max(1, -(-int(surface_only.sum()) // cells)) == 0
        v, u = np.nonzero(surface_only & row[:, None])
        rays = view.rays()[v, u]
        X_VH = invert(view.crop.X_CV) @ X_CH
        points = rays * view.depth_m[v, u][:, None]
        source = self._geometry.PointCloud()
        gate = _GATE_M[1]
        for number in range(_PASSES):
            surface = self._cad.cast(X_VH, rays, finger_m)
            hit = surface.part > 0
            if hit.sum() < _MIN_POINTS:
                return None
            on_surface = rays[hit] * surface.distance[hit, None]
            normal = surface.normal[hit]
            if number == 0:
                ratio = surface.distance[hit] / view.depth_m[v, u][hit]
                points *= np.exp(_log_depth_factor(ratio, view.depth_factor_sigma, X_CH[:3, 3], covariance))
                source.points = self._vector(points)
                gate = _gate(((points[hit] - on_surface) * normal).sum(axis=1), gate)
            target_H = transform_points(invert(X_VH), on_surface)
            normal_H = normal @ X_VH[:3, :3]
            result = self._match(source, target_H, normal_H, gate, X_VH)
            i, j = np.asarray(result.correspondence_set).reshape(-1, 2).T
            if len(i) < _MIN_POINTS:
                return None
            previous, X_VH = X_VH, invert(result.transformation)
            offset = target_H[j] @ X_VH[:3, :3].T
            normal = normal_H[j] @ X_VH[:3, :3].T
            residual = ((points[i] - X_VH[:3, 3] - offset) * normal).sum(axis=1)
            if _change_m(previous, X_VH) < _CONVERGED_M:
                break
            gate = _gate(residual, gate)
        width = max(1, round((int(surface_only.sum()) / _BLOCKS) ** 0.5))
        block = v[i] // width * view.part.shape[1] + u[i] // width
        R_CV = view.crop.R_CV
        p = points[i] @ view.crop.R_CV.T
        return IcpRegistration(
            X_CH=view.crop.X_CV @ X_VH,
            fitness=len(i) / len(points),
            rmse_m=float(np.sqrt(np.mean(residual**2))),
            covariance=_covariance(offset @ R_CV.T, normal @ R_CV.T, p, residual, block, view.depth_factor_sigma),
        )

    def _match(self, source: Any, target_H: Array, normal_H: Array, gate_m: float, X_VH: Array) -> Any:
        """Return Open3D's registration of `source` in V to a surface in H, from the pose `X_VH` on."""
        target = self._geometry.PointCloud()
        target.points = self._vector(target_H)
        target.normals = self._vector(normal_H)
        estimation = self._icp.TransformationEstimationPointToPlane(self._icp.TukeyLoss(k=gate_m))
        criteria = self._icp.ICPConvergenceCriteria(1e-4, 1e-4, _MAX_ITERATIONS)
        return self._icp.registration_icp(source, target, gate_m, invert(X_VH), estimation, criteria)


def _gate(residual: Array, largest_m: float) -> float:
    """Return the distance up to which points match, from the spread of the residuals (N,) [m]."""
    spread = 1.4826 * _median(np.abs(residual - _median(residual)))
    return float(np.clip(_GATE_SIGMAS * spread, _GATE_M[0], largest_m))


def _median(values: Array) -> float:
    """Return the median of values (N,), in a third of the time of `np.median` for some hundreds of them."""
    ordered = np.sort(values)
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


def _change_m(X_1: Array, X_2: Array) -> float:
    """Return the change of a pose, with rotations as displacements of points `_LEVER_M` away [m]."""
    angle = float(rotation_angle(X_1[:3, :3].T @ X_2[:3, :3]))
    return float(np.linalg.norm(X_1[:3, 3] - X_2[:3, 3])) + _LEVER_M * angle


def _log_depth_factor(ratio: Array, prior_sigma: float, position: Array, covariance: Array) -> float:
    """Return the logarithm of true over estimated depth that the fit implies, shrunk towards 0 by its prior.

    The surface at the fitted `position` (3,) in the camera frame [m] with its `covariance` (6, 6) has the depth `ratio`
    (N,) over the estimated one; errors that all depths have in common have the relative standard deviation
    `prior_sigma`.
    """
    variance = float(position @ covariance[3:, 3:] @ position) / float(position @ position) ** 2
    return float(np.log(_median(ratio))) * prior_sigma**2 / (prior_sigma**2 + variance)


def _covariance(
    offset: Array, normal: Array, points: Array, residual: Array, block: NDArray[np.intp], depth_factor_sigma: float
) -> Array:
    """Return the covariance (6, 6) of a registration, rotation first.

    Args:
        offset: (N, 3) matched points of the surface from the origin of the hand, along the camera's axes [m].
        normal: (N, 3) normals there.
        points: (N, 3) their points in the camera frame [m].
        residual: (N,) distances from the surface [m].
        block: (N,) number of the block that each point is in.
        depth_factor_sigma: relative standard deviation of the error that all depths have in common.
    """
    _, number, count = np.unique(block, return_inverse=True, return_counts=True)
    if len(count) < _MIN_BLOCKS:
        return np.eye(6)
    mean = np.bincount(number, residual) / count
    left = 1.0 - _DEGREES_OF_FREEDOM / len(count)  # share of the variance that the registration leaves
    variance = float((count * mean**2).sum() / count.sum()) / left / _INDEPENDENT + _LEAST_VARIANCE_M2
    J = np.hstack([cross(offset, normal), normal])
    inverse = np.linalg.inv(J.T @ J / len(J) + _REGULARIZATION)
    by_factor = inverse @ (J.T @ (points * normal).sum(axis=1)) / len(J) * depth_factor_sigma
    return np.asarray(variance * inverse + np.outer(by_factor, by_factor))


def fuse(X_CH: Array, covariance: Array, registration: IcpRegistration) -> FusedPose:
    """Combine a fitted pose with a registration by covariance intersection: the greatest determinant of information.

    Args:
        X_CH: (4, 4) fitted pose of panda_hand in the camera frame [m].
        covariance: (6, 6) its covariance, too small by the factor `_FIT_VARIANCE_RATIO`.
        registration: pose by ICP, whose covariance is inflated where it contradicts the fit.
    """
    rotation = rotation_log(registration.X_CH[:3, :3] @ X_CH[:3, :3].T)
    difference = np.concatenate([rotation, registration.X_CH[:3, 3] - X_CH[:3, 3]])
    of_registration = registration.covariance / _FIT_VARIANCE_RATIO
    not_singular = covariance + _FIT_FLOOR
    ratio, axes = eigh(of_registration, not_singular)
    square = (axes.T @ difference) ** 2 / _FIT_VARIANCE_RATIO
    consistent = (square / (1.0 + _INFLATIONS[:, None] * ratio)).sum(axis=1) <= _LARGEST_SQUARE
    of_registration = of_registration * _INFLATIONS[consistent.argmax() if consistent.any() else -1]
    of_fit = np.linalg.inv(not_singular)
    of_icp = np.linalg.inv(of_registration)
    ratio = eigh(of_icp, of_fit, eigvals_only=True)
    log_determinant = np.log(1.0 - _WEIGHTS[:, None] * (1.0 - ratio)).sum(axis=1)
    weight = float(_WEIGHTS[log_determinant.argmax()])
    fused = np.linalg.inv((1.0 - weight) * of_fit + weight * of_icp)
    step = weight * fused @ of_icp @ difference
    return FusedPose(
        X_fit=X_CH,
        registration=registration,
        weight=weight,
        X_CH=make_pose(rotation_exp(step[:3]) @ X_CH[:3, :3], X_CH[:3, 3] + step[3:]) if weight else X_CH,
        covariance=np.asarray(fused, dtype=np.float64) if weight else covariance,
    )
