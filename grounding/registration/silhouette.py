"""Silhouette of the gripper as measurements: its rendered rim should coincide with the segmented one.

CAD points on the rim of the rendered silhouette are paired with the nearest point of the segmented one; the distance
across it is a residual, along it the point is unconstrained (as in Drummond and Cipolla, "Real-time visual tracking of
complex structures", PAMI 2002, with the rim of a mask in place of image edges). The silhouette does not change the
finger travel: a mask shows the gap only from the front and then too coarsely, so the travel comes from the cells.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.registration.solver import (
    Correspondences,
    edge_frames,
)
from kinebench_drake.grounding.tracking.view import GripperView
from kinebench_drake.models.panda.cad import GripperCad

_INDEPENDENT = 80.0
"""Independent measurements that a silhouette counts as at most."""
_MIN_POINTS = 12
_GATE_CELLS = 4.0
"""Greatest distance between rendered and segmented rim of a pair [cells]."""
_SIGMA_CELLS = 0.5
"""Standard deviation of the rim of a mask [cells]."""
_MIN_COSINE = 0.3
"""Least cosine between the normals of rendered and segmented rim."""


class SilhouetteMatcher:
    """Comparison of the rendered with the segmented silhouette of the gripper."""

    def __init__(self, cad: GripperCad) -> None:
        self._cad = cad

    def overlap(self, view: GripperView, X_CH: Array, finger_m: float) -> float:
        """Return the intersection over union of the segmented and the rendered gripper, links in front excluded."""
        _, part = self._render(view, X_CH, finger_m)
        rendered = (part > 0) & view.in_image
        segmented = view.gripper & view.in_image
        union = (rendered & ~view.arm) | segmented
        return float((rendered & segmented).sum() / max(1, union.sum()))

    def coverage(self, view: GripperView, X_CH: Array, finger_m: float) -> float:
        """Return the share of the rendered gripper that is segmented as any part of the robot."""
        rendered = (self._render(view, X_CH, finger_m)[1] > 0) & view.in_image
        return float((rendered & (view.part > 0)).sum() / max(1, rendered.sum()))

    def match(self, view: GripperView, X_CH: Array, finger_m: float) -> Correspondences | None:
        """Return correspondences of the rim for a hand near `X_CH` (4, 4); None if too little of it is visible."""
        X_VH = invert(view.crop.X_CV) @ X_CH
        shape = view.part.shape
        depth, part = self._render(view, X_CH, finger_m)
        rendered = (part > 0) & view.in_image
        segmented = view.gripper & view.in_image
        if not segmented.any() or not rendered.any():
            return None
        distance = _signed_distance(rendered)
        target = _signed_distance(segmented)
        normal_rendered = _outward_normal(distance)
        normal_segmented = _outward_normal(target)
        inner = np.pad(np.ones(np.subtract(shape, 4), bool), 2)
        rim = rendered & (distance > -1.0) & ~_dilated(view.arm) & ~_dilated(~view.in_image) & inner
        step = target - distance
        agree = (normal_rendered * normal_segmented).sum(axis=-1) > _MIN_COSINE
        rim &= agree & (np.abs(step) <= _GATE_CELLS)
        v, u = np.nonzero(rim)
        if len(v) < _MIN_POINTS:
            return None
        normal = normal_segmented[v, u]
        move = step[v, u]
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        focal = view.crop.focal / view.stride
        line = view.rays_at(v, u)
        p_V = line * depth[v, u, None]
        p_P = transform_points(invert(X_VH), p_V)
        line[:, :2] -= normal * move[:, None] / focal
        return Correspondences.without_range(
            edge_frames(line, normal) @ view.crop.R_CV.T,
            p_P,
            np.column_stack([_SIGMA_CELLS / focal * p_V[:, 2], np.full(len(v), np.inf)]),
            part[v, u],
            _INDEPENDENT,
        )

    def _render(self, view: GripperView, X_CH: Array, finger_m: float) -> tuple[Array, NDArray[np.uint8]]:
        """Return depth [m] and part of each cell (h, w) of the rendered gripper."""
        X_VH = invert(view.crop.X_CV) @ X_CH
        rays = view.rays().reshape(-1, 3)
        depth, part = self._cad.first_hits(X_VH, rays, finger_m)
        return depth.reshape(view.part.shape), part.reshape(view.part.shape)


def _signed_distance(mask: NDArray[np.bool_]) -> Array:
    """Return the distance (h, w) of each cell's centre from the rim of a mask [cells], negative inside."""
    # OpenCV's transform differs in the last digits from call to call.
    return np.asarray(np.where(mask, 0.5 - distance_transform_edt(mask), distance_transform_edt(~mask) - 0.5))


def _outward_normal(distance: Array) -> Array:
    """Return the unit gradient (h, w, 2) of a signed distance, x first."""
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    dy, dx = np.gradient(smooth)
    gradient = np.stack([dx, dy], axis=-1)
    return np.asarray(gradient / np.maximum(np.linalg.norm(gradient, axis=-1, keepdims=True), 1e-6))


def _dilated(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)
