"""Dense estimates (part labels, metric depth, CAD coordinates) by the trained network."""

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.environment.native import share_heap
from kinebench_drake.environment.precision import Precision, network_precision
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.registration.solver import BATCH
from kinebench_drake.grounding.tracking.view import CLOSE_SIZE, Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.progress import count_steps
from kinebench_drake.models.panda.description import ARM
from kinebench_drake.models.perception.network import (
    COORDINATE_SCALE_M,
    DEPTH_CENTRE,
    STRIDE,
    DenseOutput,
    GripperNetwork,
    fold_batch_normalisation,
    reduce_precision,
    use_onednn,
)

_BATCH_ON_GPU = 64
"""Crops of any size in a batch; always as many, since cuDNN plans for seconds for each number of them."""
DEPTH_FACTOR_SIGMA = 0.012
"""Relative standard deviation of the depth error that the network makes alike on all of the robot."""
_LAPLACE_TO_SIGMA = np.sqrt(2.0)
"""Standard deviation of a Laplace distribution of scale 1."""


class NetworkEstimator:
    """Trained network as a `DenseEstimator`."""

    def __init__(self, network: GripperNetwork, device: str | None = None) -> None:
        """Move `network` to `device` (default: the GPU if there is one), in the precision of `network_precision`.

        Raises:
            UsageError: the environment names an unknown precision.
        """
        share_heap()
        self._device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        folded = fold_batch_normalisation(network)
        if network_precision() is Precision.BFLOAT16:
            folded = reduce_precision(folded)
        network = folded.to(self._device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._network = use_onednn(network) if self._device.type == "cpu" else network
        self._whole_batch = _BATCH_ON_GPU if self._device.type == "cuda" else None
        self._worker = ThreadPoolExecutor(max_workers=1)  # one for all: cuDNN plans anew in each thread

    @torch.inference_mode()
    def _run(self, images: list[NDArray[np.generic]]) -> DenseOutput:
        if self._whole_batch is not None:
            images = images + images[-1:] * (self._whole_batch - len(images))
        batch = torch.from_numpy(np.stack(images)).to(self._device).permute(0, 3, 1, 2).float() / 255.0
        output: DenseOutput = self._network(batch.contiguous(memory_format=torch.channels_last))
        return output

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Estimate crops of equal size in batches; the next batch runs while the caller processes the previous one."""

        def run(batch: list[int]) -> list[GripperView]:
            output = self._run([crops[i].warp(frames[i], camera) for i in batch])
            return _views(output, [crops[i] for i in batch], camera)

        def views() -> Iterator[tuple[int, GripperView]]:
            ahead = None
            for batch in self._batches(crops):
                ready, ahead = ahead, (batch, self._worker.submit(run, batch))
                if ready:
                    yield from zip(ready[0], ready[1].result(), strict=True)
            if ahead:
                yield from zip(ahead[0], ahead[1].result(), strict=True)

        return count_steps(views(), "views measured", len(crops))

    def _batches(self, crops: Mapping[int, Crop]) -> Iterator[list[int]]:
        for size in sorted({crop.size for crop in crops.values()}):
            count = self._whole_batch or max(1, BATCH * CLOSE_SIZE**2 // size**2)
            members = [i for i, crop in crops.items() if crop.size == size]
            yield from (members[start : start + count] for start in range(0, len(members), count))


def _views(output: DenseOutput, crops: list[Crop], camera: Camera) -> list[GripperView]:
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
            in_image=crop.in_image(camera, STRIDE),
            part=part[i],
            depth_m=depth[i] * crop.focal / crop.size,
            depth_sigma=depth_sigma[i],
            depth_factor_sigma=DEPTH_FACTOR_SIGMA,
            coordinates_P=coordinates[i],
            coordinates_sigma_m=sigma[i],
        )
        for i, crop in enumerate(crops)
    ]
