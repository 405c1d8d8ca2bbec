"""Dense estimates whose mask or depth is replaced by priors: true values or another program's."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.grounding.registration.fit import MIN_CELLS, gripper_cells, place_hand
from kinebench_drake.grounding.tracking.crop import Crop
from kinebench_drake.grounding.tracking.view import DenseEstimator, Frames, GripperView
from kinebench_drake.models.panda.robot import RobotPart

_EXACT_SIGMA, _EXACT_FACTOR_SIGMA = 1e-3, 1e-4  # relative; depth is stored in whole millimetres
_ESTIMATE_SIGMA, _ESTIMATE_FACTOR_SIGMA = 0.02, 0.1  # estimator of unknown accuracy
_CALIBRATED_FACTOR_SIGMA = 0.03  # drift of the depth factor along a video


class OverrideEstimator:
    """Estimator with its mask, its depth or both replaced by priors."""

    def __init__(self, base: DenseEstimator, priors: Priors) -> None:
        """Replace the estimates of `base` by those in `priors`."""
        self._base, self._priors = base, priors

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Estimate one view per crop, like `DenseEstimator.estimate`."""
        for number, view in self._base.estimate(frames, camera, crops):
            if self._priors.mask is not None:
                view = replace_mask(view, self._priors.mask[number], camera)
            if self._priors.depth is not None:
                view = replace_depth(view, self._priors.depth, number, camera)
            yield number, view


def replace_mask(view: GripperView, mask: NDArray[np.bool_], camera: Camera) -> GripperView:
    """Return the view with the gripper where `mask` (H, W) is true; which part a cell shows remains estimated."""
    in_mask = np.asarray(view.crop.warp(mask.astype(np.uint8), camera, view.stride, nearest=True)) > 0
    gripper = np.where(view.gripper, view.part, RobotPart.HAND)
    other = np.where(view.gripper, RobotPart.BACKGROUND, view.part)
    return replace(view, part=np.where(in_mask, gripper, other).astype(np.uint8))


def replace_depth(view: GripperView, depth: ExternalDepth, number: int, camera: Camera) -> GripperView:
    """Return the view with the depth of frame `number` in the cells that have one."""
    crop = view.crop
    depth_m = np.nan_to_num(depth.depth_m[number].astype(np.float32), nan=0.0, posinf=0.0)
    depth_C = np.asarray(crop.warp(depth_m, camera, view.stride, nearest=True), dtype=np.float64)
    z = depth_C / (view.rays() @ crop.R_CV.T)[..., 2]
    has_depth = z > 0
    estimate_sigma = _CALIBRATED_FACTOR_SIGMA if depth.calibrated else _ESTIMATE_FACTOR_SIGMA
    return replace(
        view,
        depth_m=np.where(has_depth, z, view.depth_m),
        depth_sigma=np.where(has_depth, _EXACT_SIGMA if depth.exact else _ESTIMATE_SIGMA, view.depth_sigma),
        depth_factor_sigma=_EXACT_FACTOR_SIGMA if depth.exact else estimate_sigma,
    )


def calibrate_depth(depth: ExternalDepth, view: GripperView, X_CH: Array, finger_m: float) -> ExternalDepth:
    """Scale estimated depth by the factor that puts the gripper in `view` at its known pose.

    Args:
        depth: depth of the video.
        view: view of one frame, with this depth.
        X_CH: (4, 4) true pose of panda_hand in that frame [m].
        finger_m: travel of each finger in that frame [m].
    """
    cells = gripper_cells(view)
    if len(cells) < MIN_CELLS:
        return depth
    p_C, _ = place_hand(X_CH, finger_m, cells)
    factor = float(np.median(np.linalg.norm(p_C, axis=1) / cells.range_m))
    return replace(depth, depth_m=depth.depth_m * factor, calibrated=True)
