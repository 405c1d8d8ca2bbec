"""Depth of MoGe-2 in place of the network's.

pip install git+https://github.com/microsoft/MoGe.git
MOGE_CHECKPOINT=model.pt kinebench-drake score videos/ --out results/ --depth examples/moge_depth.py:MogeDepth
"""

import os

import numpy as np
import torch
from moge.model.v2 import MoGeModel
from numpy.typing import NDArray

from kinebench_drake.api import Camera


class MogeDepth:
    """Depth by a checkpoint of MoGe-2, given the camera's field of view; on a GPU if there is one."""

    def __init__(self) -> None:
        """Load the network from the file MOGE_CHECKPOINT, such as model.pt of Ruicheng/moge-2-vits-normal."""
        self._device = "cuda" if torch.cuda.is_available() else "cpu"
        self._model = MoGeModel.from_pretrained(os.environ["MOGE_CHECKPOINT"]).to(self._device).eval()

    def depth(self, frames: NDArray[np.uint8], camera: Camera) -> NDArray[np.floating]:
        """Estimate depth (T, H, W) of frames (T, H, W, 3) [m]; 0 where the network finds no surface."""
        fov_x_deg = float(np.degrees(2.0 * np.arctan(camera.width / (2.0 * camera.fx))))
        depth_m = np.zeros(frames.shape[:3], np.float32)
        for i, frame in enumerate(frames):
            image = torch.from_numpy(frame / np.float32(255.0)).permute(2, 0, 1).to(self._device)
            output = self._model.infer(image, fov_x=fov_x_deg, use_fp16=self._device == "cuda")
            depth_m[i] = np.nan_to_num(output["depth"].float().cpu().numpy(), nan=0.0, posinf=0.0)  # inf: no surface
        return depth_m
