"""The gripper's outline as measurements: where the rendered gripper ends, the seen one should.

Points of the CAD model on the rim of its rendered outline are paired with the nearest point of the seen outline, across
which they should move; along it nothing is said (as in Drummond and Cipolla, "Real-time visual tracking of complex
structures", PAMI 2002, with the outline of a mask in place of image edges). Fingers count as opened as they are: their
gap is told by their cells alone, for a mask shows it only from the front and then too coarsely.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.view import GripperView
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.robot import ARM

GATE_CELLS = 4.0
"""Farthest pairs of rendered and seen outline, where the pose is near the right one."""
_SIGMA_CELLS = 0.5  # how exactly a mask shows an outline
_INDEPENDENT = 80.0  # measurements that an outline is worth at most
_LEAST_AGREEMENT = 0.3  # cosine between the normals of rendered and seen outline
_MIN_POINTS = 12


class Silhouette:
    """Pairs the rim of the rendered gripper with the seen outline."""

    def __init__(self, cad: GripperCad) -> None:
        self._cad = cad

    def overlap(self, view: GripperView, X_CH: Array, finger_m: float) -> float:
        """Intersection over union of the seen and the rendered gripper in the picture, links before it left out."""
        X_VH = invert(view.crop.X_CV) @ X_CH
        part = self._cad.cast(X_VH, view.rays().reshape(-1, 3), finger_m).part.reshape(view.part.shape)
        rendered, seen = (part > 0) & view.shown, view.gripper & view.shown
        union = (rendered & ~np.isin(view.part, ARM)) | seen
        return float((rendered & seen).sum() / max(1, union.sum()))

    def rim(self, view: GripperView, X_CH: Array, finger_m: float, gate: float = GATE_CELLS) -> Correspondences | None:
        """What the outline says of a hand near `X_CH` (4, 4); None where too little of it is seen.

        Args:
            view: what is seen.
            X_CH: pose of panda_hand in the camera frame [m].
            finger_m: opening of each finger [m].
            gate: farthest pairs [cells of the view].
        """
        X_VH = invert(view.crop.X_CV) @ X_CH
        rays = view.rays()
        shape = view.part.shape
        surface = self._cad.cast(X_VH, rays.reshape(-1, 3), finger_m)
        part = surface.part.reshape(shape)
        rendered, seen = (part > 0) & view.shown, view.gripper & view.shown
        arm = np.isin(view.part, ARM)
        if not seen.any() or not rendered.any():
            return None
        inside, target = _signed(rendered), _signed(seen)
        slope_rendered, slope_seen = _slope(inside), _slope(target)
        rim = rendered & (inside > -1.0) & ~_near(arm) & ~_near(~view.shown) & ~_border(shape)
        step = target - inside
        agree = (slope_rendered * slope_seen).sum(axis=-1) > _LEAST_AGREEMENT
        rim &= agree & (np.abs(step) <= gate)
        v, u = np.nonzero(rim)
        if len(v) < _MIN_POINTS:
            return None
        normal, move = slope_seen[v, u], step[v, u]
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        focal = view.crop.focal / view.stride
        p_V = rays[v, u] * surface.distance.reshape(shape)[v, u, None]
        p_P = transform_points(invert(X_VH), p_V)
        line = rays[v, u].copy()
        line[:, :2] -= normal * move[:, None] / focal
        z = line / np.linalg.norm(line, axis=1, keepdims=True)
        x = np.column_stack([normal, np.zeros(len(v))])
        x -= (x * z).sum(axis=1, keepdims=True) * z
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        R_LV = np.stack([x, np.cross(z, x), z], axis=1)
        sigma = _SIGMA_CELLS / focal * p_V[:, 2]
        free = np.full(len(v), np.inf)
        return Correspondences(
            R_LC=R_LV @ view.crop.R_CV.T,
            range_m=np.ones(len(v)),
            range_sigma=free,
            p_P=p_P,
            sigma_m=np.column_stack([sigma, free]),
            part=part[v, u],
            opening_sign=np.zeros(len(v)),
            weight=np.full(len(v), min(1.0, _INDEPENDENT / len(v))),
        )


def _signed(mask: NDArray[np.bool_]) -> Array:
    """Distance (h, w) of each cell's centre from a mask's outline [cells], negative inside."""
    return np.asarray(np.where(mask, 0.5 - distance_transform_edt(mask), distance_transform_edt(~mask) - 0.5))


def _slope(distance: Array) -> Array:
    """Unit-length outward direction (h, w, 2) of a distance, x first."""
    smooth = cv2.GaussianBlur(distance, (0, 0), 1.0)
    dy, dx = np.gradient(smooth)
    slope = np.stack([dx, dy], axis=-1)
    return np.asarray(slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-6))


def _near(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0)


def _border(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    border = np.ones(shape, dtype=bool)
    border[2:-2, 2:-2] = False
    return border
