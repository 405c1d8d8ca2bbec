"""TODO."""

from pathlib import Path

import numpy as np
import torch
from moge.model.v2 import MoGeModel
from numpy.typing import NDArray

from kinebench_drake.camera import Camera


class MogeDepth:
    """A checkpoint of MoGe-2, told the camera's field of view; frame by frame, on a GPU where there is one."""

    def __init__(self, checkpoint: Path) -> None:
        """Load the network.

        Args:
            checkpoint: the file model.pt.
        """
        self._device = "cuda" if torch.cuda.is_available() else "cpu"
        self._model = MoGeModel.from_pretrained(str(checkpoint)).to(self._device).eval()

    def depth(self, frames: NDArray[np.uint8], camera: Camera) -> NDArray[np.floating]:
        """See `DepthSource`; 0 where the network says that there is no geometry."""
        fov_x_deg = float(np.degrees(2.0 * np.arctan(camera.width / (2.0 * camera.fx))))
        depth_m = np.zeros(frames.shape[:3], np.float32)
        for frame, into in zip(frames, depth_m, strict=True):
            image = torch.from_numpy(frame / np.float32(255.0)).permute(2, 0, 1).to(self._device)
            told = self._model.infer(image, fov_x=fov_x_deg, use_fp16=self._device == "cuda")
            into[...] = np.nan_to_num(told["depth"].float().cpu().numpy(), nan=0.0, posinf=0.0)  # inf: no geometry
        return depth_m
