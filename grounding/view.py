"""What is known of the gripper in one crop, whoever measured it: masks, depth and CAD coordinates on a grid."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.crop import Crop
from kinebench_drake.models.panda.robot import GRIPPER, RobotPart

Frames = NDArray[np.uint8]
"""(T, H, W, 3) RGB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GripperView:
    """Dense estimates of one crop on a grid of h x w cells, every `stride`-th pixel of the crop."""

    crop: Crop
    stride: int
    shown: NDArray[np.bool_]
    """(h, w) cells within the picture: a gripper at its edge goes on beyond it, unseen."""
    part: NDArray[np.uint8]
    """(h, w) values of `Part`."""
    depth_m: Array
    """(h, w) along the crop's optical axis [m]."""
    depth_sigma: Array
    """(h, w) standard deviation of the depth, relative."""
    level_sigma: float
    """Standard deviation of the error that all of the depth has in common, relative."""
    coordinates_P: Array
    """(h, w, 3) point seen [m]: of the gripper in the hand frame with closed fingers, of a link in the link's frame."""
    coordinates_sigma_m: Array
    """(h, w) standard deviation of each coordinate [m]."""

    @property
    def gripper(self) -> NDArray[np.bool_]:
        """(h, w) cells that show hand or fingers."""
        return np.isin(self.part, GRIPPER)

    @property
    def opening_sign(self) -> Array:
        """(h, w) 1 on the left finger, -1 on the right, else 0: where cells go along y as the gripper opens."""
        return np.asarray(
            (self.part == RobotPart.LEFT_FINGER).astype(np.float64) - (self.part == RobotPart.RIGHT_FINGER)
        )

    def rays(self) -> Array:
        """(h, w, 3) directions in the crop's frame with z = 1."""
        return self.crop.rays(self.stride)

    def to_frame(self, cells: NDArray[np.bool_], camera: Camera) -> NDArray[np.bool_]:
        """Cells (h, w) of the view as pixels (H, W) of the frame."""
        return self.crop.unwarp(cells.astype(np.uint8), camera, self.stride) > 0


class DepthEstimator(Protocol):
    """Where masks and metric depth come from: the trained network, true values, or another model."""

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        """Views of some frames of a video.

        Args:
            frames: (T, H, W, 3), all of them.
            camera: what they were taken with.
            crops: by number of the frame, where to look.

        Yields:
            Number and view of each crop, in any order, as they are ready.
        """
        ...
