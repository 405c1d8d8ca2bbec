"""Masks and depth from elsewhere in place of estimated ones, true values or another program's."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.registration.fit import MIN_CELLS, gripper_cells, place_hand
from kinebench_drake.grounding.view import DepthEstimator, Frames, GripperView
from kinebench_drake.models.panda.robot import RobotPart
from kinebench_drake.types import ExternalDepth, Priors

_EXACT_SIGMA, _EXACT_LEVEL_SIGMA = 1e-3, 1e-4  # relative: stored depth has whole millimetres
_OTHERS_SIGMA, _OTHERS_LEVEL_SIGMA = 0.02, 0.1  # an estimator about which nothing is known
_CALIBRATED_LEVEL_SIGMA = 0.03  # what its factor may change by along a video


class OverrideEstimator:
    """Another estimator with its mask, its depth or both replaced by given ones."""

    def __init__(self, base: DepthEstimator, known: Priors) -> None:
        """Take from `base` what is not known."""
        self._base, self._known = base, known

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """See `DepthEstimator`."""
        for number, view in self._base.estimate(frames, camera, crops):
            if self._known.mask is not None:
                view = with_mask(view, self._known.mask[number], camera)
            if self._known.depth is not None:
                view = with_depth(view, self._known.depth, number, camera)
            yield number, view


def with_mask(view: GripperView, mask: NDArray[np.bool_], camera: Camera) -> GripperView:
    """The view with the gripper where `mask` (H, W) says; which part of it a cell shows stays as estimated."""
    seen = np.asarray(view.crop.warp(mask.astype(np.uint8), camera, view.stride, nearest=True)) > 0
    gripper = np.where(view.gripper, view.part, RobotPart.HAND)
    other = np.where(view.gripper, RobotPart.BACKGROUND, view.part)
    return replace(view, part=np.where(seen, gripper, other).astype(np.uint8))


def with_depth(view: GripperView, depth: ExternalDepth, number: int, camera: Camera) -> GripperView:
    """The view with the depth of frame `number` where it is known."""
    crop = view.crop
    depth_m = np.nan_to_num(depth.depth_m[number].astype(np.float32), nan=0.0, posinf=0.0)
    depth_C = np.asarray(crop.warp(depth_m, camera, view.stride, nearest=True), dtype=np.float64)
    z = depth_C / (view.rays() @ crop.R_CV.T)[..., 2]
    known = z > 0
    others = _CALIBRATED_LEVEL_SIGMA if depth.calibrated else _OTHERS_LEVEL_SIGMA
    return replace(
        view,
        depth_m=np.where(known, z, view.depth_m),
        depth_sigma=np.where(known, _EXACT_SIGMA if depth.exact else _OTHERS_SIGMA, view.depth_sigma),
        level_sigma=_EXACT_LEVEL_SIGMA if depth.exact else others,
    )


def calibrated(depth: ExternalDepth, view: GripperView, X_CH: Array, finger_m: float) -> ExternalDepth:
    """Estimated depth times the factor that puts the gripper seen in `view` where it is known to be.

    Args:
        depth: the depth of a video.
        view: one of its frames, with this depth.
        X_CH: (4, 4) true pose of panda_hand in that frame [m].
        finger_m: opening of each finger in it [m].
    """
    cells = gripper_cells(view)
    if len(cells) < MIN_CELLS:
        return depth
    p_C, _ = place_hand(X_CH, finger_m, cells)
    factor = float(np.median(np.linalg.norm(p_C, axis=1) / cells.range_m))
    return replace(depth, depth_m=depth.depth_m * factor, calibrated=True)
