"""True values in place of estimated ones, one at a time: what remains is what the other stages owe.

An estimator is handed some of a video's frames, in any order; which ones they are is told by their content. Two frames
of the same bytes show the same, so it does not matter which of them is meant.
"""

from dataclasses import replace
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.view import DepthEstimator, Frames, GripperView
from kinebench_drake.models.panda.part import Part

_TRUE_DEPTH_SIGMA = 1e-3  # relative: the stored depth has whole millimetres


class FrameNumbers:
    """Numbers of a video's frames by their content."""

    def __init__(self, frames: Frames) -> None:
        self._numbers = {_content(frame): i for i, frame in enumerate(frames)}

    def of(self, frames: Frames) -> list[int]:
        """The number of each of `frames` (n, H, W, 3).

        Raises:
            InputError: one of them is not of this video.
        """
        try:
            return [self._numbers[_content(frame)] for frame in frames]
        except KeyError:
            raise InputError("a frame is not of the video whose truth was given") from None


def _content(frame: NDArray[np.uint8]) -> int:
    return crc32(np.ascontiguousarray(frame).data)


class GivenEstimator:
    """Another estimator with its mask, its depth or both replaced by true ones."""

    def __init__(
        self,
        base: DepthEstimator,
        frames: Frames,
        *,
        mask: NDArray[np.bool_] | None = None,
        depth_m: Array | None = None,
    ) -> None:
        """Replace what is given.

        Args:
            base: where everything else comes from.
            frames: (T, H, W, 3) of the whole video.
            mask: (T, H, W) pixels that show the gripper.
            depth_m: (T, H, W) along the camera's axis [m], 0 where unknown.

        Raises:
            InputError: a shape differs from that of the video.
        """
        for name, given in (("mask", mask), ("depth", depth_m)):
            if given is not None and given.shape != frames.shape[:3]:
                raise InputError(f"the true {name} has shape {given.shape}, the video {frames.shape[:3]}")
        self._base, self._mask, self._depth = base, mask, depth_m
        self._numbers = FrameNumbers(frames)

    def estimate(self, frames: Frames, camera: Camera, crops: list[Crop]) -> list[GripperView]:
        """One view a frame.

        Raises:
            InputError: a frame is not of the video.
        """
        views = []
        for number, view in zip(self._numbers.of(frames), self._base.estimate(frames, camera, crops), strict=True):
            if self._mask is not None:
                view = with_mask(view, self._mask[number], camera)
            if self._depth is not None:
                view = with_depth(view, self._depth[number], camera)
            views.append(view)
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
        depth_sigma=np.where(known, _TRUE_DEPTH_SIGMA, view.depth_sigma),
    )
