"""Masks and depth from elsewhere in place of estimated ones, true values or another program's."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.view import DepthEstimator, Frames, GripperView
from kinebench_drake.models.panda.part import Part

_GIVEN_DEPTH_SIGMA = 1e-3  # relative: stored depth has whole millimetres


class GivenEstimator:
    """Another estimator with its mask, its depth or both replaced by given ones."""

    def __init__(
        self, base: DepthEstimator, *, mask: NDArray[np.bool_] | None = None, depth_m: Array | None = None
    ) -> None:
        """Replace what is given.

        Args:
            base: where everything else comes from.
            mask: (T, H, W) pixels that show the gripper.
            depth_m: (T, H, W) along the camera's axis [m], 0 where unknown.
        """
        self._base, self._mask, self._depth = base, mask, depth_m

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> dict[int, GripperView]:
        """See `DepthEstimator`.

        Raises:
            InputError: what is given has another shape than the video.
        """
        for name, given in (("mask", self._mask), ("depth", self._depth)):
            if given is not None and given.shape != frames.shape[:3]:
                raise InputError(f"the {name} given has shape {given.shape}, the video {frames.shape[:3]}")
        views = self._base.estimate(frames, camera, crops)
        for number, view in views.items():
            if self._mask is not None:
                view = with_mask(view, self._mask[number], camera)
            if self._depth is not None:
                view = with_depth(view, self._depth[number], camera)
            views[number] = view
        return views


def with_mask(view: GripperView, mask: NDArray[np.bool_], camera: Camera) -> GripperView:
    """The view with the gripper where `mask` (H, W) says; which part of it a cell shows stays as estimated."""
    seen = np.asarray(view.crop.warp(mask.astype(np.uint8), camera, view.stride, nearest=True)) > 0
    gripper = np.where(view.gripper, view.part, Part.HAND)
    other = np.where(view.gripper, Part.BACKGROUND, view.part)
    return replace(view, part=np.where(seen, gripper, other).astype(np.uint8))


def with_depth(view: GripperView, depth_m: Array, camera: Camera) -> GripperView:
    """The view with `depth_m` (H, W) along the camera's axis [m] where it is known."""
    crop = view.crop
    depth_C = np.asarray(crop.warp(depth_m.astype(np.float32), camera, view.stride, nearest=True), dtype=np.float64)
    z = depth_C / (view.rays() @ crop.R_CV.T)[..., 2]
    known = z > 0
    return replace(
        view,
        depth_m=np.where(known, z, view.depth_m),
        depth_sigma=np.where(known, _GIVEN_DEPTH_SIGMA, view.depth_sigma),
    )
