"""Mask, metric depth and CAD coordinates from pixels by the trained network; true values in their place to measure."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.grounding.view import DepthEstimator, Frames, GripperView
from kinebench_drake.models.panda.part import ARM, Part
from kinebench_drake.models.perception.network import (
    COORDINATE_SCALE_M,
    DEPTH_CENTRE,
    STRIDE,
    DenseOutput,
    GripperNetwork,
)

_BATCH = 8
_LAPLACE_TO_SIGMA = np.sqrt(2.0)  # standard deviation of a Laplace distribution of scale 1


class NetworkEstimator:
    """The perception network as a `DepthEstimator`."""

    def __init__(self, network: GripperNetwork, device: str | None = None) -> None:
        """Put `network` on `device` (default: the GPU when there is one)."""
        self._device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self._network = network.to(self._device).to(memory_format=torch.channels_last).eval()  # type: ignore[call-overload]

    @torch.inference_mode()
    def _run(self, images: list[NDArray[np.generic]]) -> DenseOutput:
        batch = torch.from_numpy(np.stack(images)).to(self._device).permute(0, 3, 1, 2).float() / 255.0
        output: DenseOutput = self._network(batch.contiguous(memory_format=torch.channels_last))
        return output

    def estimate(self, frames: Frames, camera: Camera, crops: list[Crop]) -> list[GripperView]:
        """One view a frame; crops of equal size run in batches."""
        views: list[GripperView | None] = [None] * len(crops)
        for size in sorted({crop.size for crop in crops}):
            members = [i for i, crop in enumerate(crops) if crop.size == size]
            for start in range(0, len(members), _BATCH):
                batch = members[start : start + _BATCH]
                output = self._run([crops[i].warp(frames[i], camera) for i in batch])
                for i, view in zip(batch, _views(output, [crops[i] for i in batch]), strict=True):
                    views[i] = view
        return [view for view in views if view is not None]


def _views(output: DenseOutput, crops: list[Crop]) -> list[GripperView]:
    def numpy(x: torch.Tensor) -> Array:
        return np.asarray(x.cpu().numpy(), dtype=np.float64)

    label = output.part_logits.argmax(dim=1)
    arm = label[:, None] >= int(ARM[0])
    part = label.cpu().numpy().astype(np.uint8)
    points = torch.where(arm, output.coordinates[:, 1], output.coordinates[:, 0])
    coordinates = numpy(points).transpose(0, 2, 3, 1) * COORDINATE_SCALE_M
    log_scale = torch.where(arm[:, 0], output.coordinate_log_scale[:, 1], output.coordinate_log_scale[:, 0])
    sigma = numpy(torch.exp(log_scale)) * COORDINATE_SCALE_M * _LAPLACE_TO_SIGMA
    depth = numpy(torch.exp(output.log_depth)) * DEPTH_CENTRE
    depth_sigma = numpy(torch.exp(output.depth_log_scale)) * _LAPLACE_TO_SIGMA
    return [
        GripperView(
            crop=crop,
            stride=STRIDE,
            part=part[i],
            depth_m=depth[i] * crop.focal / crop.size,
            depth_sigma=depth_sigma[i],
            coordinates_P=coordinates[i],
            coordinates_sigma_m=sigma[i],
        )
        for i, crop in enumerate(crops)
    ]


class TrueDepthEstimator:
    """Another estimator with its mask and depth replaced by true ones: what remains is the registration's own error."""

    def __init__(self, base: DepthEstimator, depth_m: Array, mask: NDArray[np.bool_]) -> None:
        """Take `base` for the CAD coordinates, `depth_m` and `mask` (T, H, W) for the rest.

        Raises:
            InputError: their shapes differ.
        """
        if depth_m.shape != mask.shape:
            raise InputError(f"true depth has shape {depth_m.shape}, the mask {mask.shape}; they must be equal")
        self._base, self._depth, self._mask = base, depth_m, mask

    def estimate(self, frames: Frames, camera: Camera, crops: list[Crop]) -> list[GripperView]:
        """One view a frame.

        Raises:
            InputError: there are more frames than true depth maps.
        """
        if len(frames) != len(self._depth) or frames.shape[1:3] != self._depth.shape[1:]:
            raise InputError(f"true depth is {self._depth.shape}, the video {frames.shape[:3]}; they must be equal")
        views = self._base.estimate(frames, camera, crops)
        return [self._replace(view, self._depth[i], self._mask[i], camera) for i, view in enumerate(views)]

    def _replace(self, view: GripperView, depth: Array, mask: NDArray[np.bool_], camera: Camera) -> GripperView:
        crop = view.crop
        seen = np.asarray(crop.warp(mask.astype(np.uint8), camera, view.stride, nearest=True)) > 0
        depth_C = np.asarray(crop.warp(depth.astype(np.float32), camera, view.stride, nearest=True), dtype=np.float64)
        z = depth_C / (view.rays() @ crop.R_CV.T)[..., 2]
        part = np.where(
            seen, np.where(view.gripper, view.part, Part.HAND), np.where(view.gripper, Part.BACKGROUND, view.part)
        )
        return replace(
            view,
            part=part.astype(np.uint8),
            depth_m=np.where(seen & (z > 0), z, view.depth_m),
            depth_sigma=np.full(z.shape, 1e-3),
        )
