"""How much of the gripper a picture shows, and its outline where no mask is stored, by the CAD model at true poses."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.evaluation.clip import TruthClip
from kinebench_drake.models.panda.cad import GripperCad

_MARGIN = 1.1  # half width of the view over the gripper's radius
_OUTLINE_PX = 160  # width of the view that outlines are drawn from
_SHARE_PX = 64  # width of the view that shares are counted in


def true_masks(clip: TruthClip, cad: GripperCad) -> NDArray[np.bool_]:
    """Masks (T, H, W) of the gripper: those stored, else the outline of the CAD model at the true poses.

    The latter leaves out what arm or objects hide of it.
    """
    if clip.mask is not None:
        return clip.mask
    camera = clip.camera
    masks = np.zeros((len(clip.t_s), camera.height, camera.width), dtype=bool)
    for i, X_CH in enumerate(clip.X_CH):
        if np.isfinite(X_CH).all() and X_CH[2, 3] > 0:
            crop, hit = _outline(X_CH, float(clip.finger_width_m[i]), cad, _OUTLINE_PX)
            masks[i] = crop.unwarp(hit.astype(np.uint8), camera) > 0
    return masks


def visible_share(clip: TruthClip, masks: NDArray[np.bool_], cad: GripperCad) -> Array:
    """Part (T,) of the gripper's outline that `masks` (T, H, W) show, what lies outside the picture included.

    NaN where the gripper is not there.
    """
    share = np.full(len(clip.t_s), np.nan)
    for i, X_CH in enumerate(clip.X_CH):
        if not np.isfinite(X_CH).all():
            continue
        if X_CH[2, 3] <= 0:
            share[i] = 0.0
            continue
        crop, hit = _outline(X_CH, float(clip.finger_width_m[i]), cad, _SHARE_PX)
        covered = _area_px(crop.rays()[hit] @ crop.R_CV.T, crop, clip.camera)
        share[i] = min(float(masks[i].sum()) / covered, 1.0) if covered else 0.0
    return share


def _outline(X_CH: Array, width_m: float, cad: GripperCad, size: int) -> tuple[Crop, NDArray[np.bool_]]:
    """A view of the gripper and the pixels (size, size) of it that the gripper covers."""
    crop = Crop.of_gripper(X_CH, _MARGIN, size)
    finger_m = width_m / 2 if np.isfinite(width_m) else 0.02
    surface = cad.cast(invert(crop.X_CV) @ X_CH, crop.rays().reshape(-1, 3), finger_m)
    return crop, surface.part.reshape(size, size) > 0


def _area_px(rays_C: Array, crop: Crop, camera: Camera) -> float:
    """Area in the image plane [px] that pixels of a crop cover, given their rays (n, 3): z = 1 in the crop's frame.

    The plane goes on beyond the picture. A pixel is stretched by the determinant of the homography's Jacobian.
    """
    z = np.maximum(rays_C[:, 2], 0.1)
    return float((camera.fx * camera.fy / crop.focal**2 / z**3).sum())
