"""What is known of a video beforehand: its first frame, or stages done elsewhere."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstFrame:
    """The robot in the frame that a world model was given: exact, where estimates are not."""

    X_BG: Array
    """(4, 4) pose of panda_hand_tcp in the robot base frame [m]."""
    finger_width_m: float = float("nan")
    """Gap between the finger pads [m]; NaN where unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GivenDepth:
    """Metric depth from a sensor, a simulator or another estimator."""

    depth_m: Array
    """(T, H, W) along the camera's axis [m]; 0 or not finite where unknown."""
    exact: bool = False
    """Whether it can be trusted to a few millimetres; an estimate's common factor is fitted along."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What takes the place of estimates; None where nothing is known."""

    first: FirstFrame | None = None
    """The robot in the first frame."""
    mask: NDArray[np.bool_] | None = None
    """(T, H, W) pixels that show the gripper: hand and fingers."""
    depth: GivenDepth | None = None
    """Depth of every frame."""
    X_CH: Array | None = None
    """(T, 4, 4) poses of panda_hand in the camera frame [m], taken as they are; NaN where there is none."""
    finger_width_m: Array | None = None
    """(T,) gap between the finger pads [m]; NaN where unknown."""

    def require(self, frames: int, height: int, width: int) -> None:
        """Hold the shapes against those of the video.

        Raises:
            InputError: one of them is another.
        """
        picture, shapes = (frames, height, width), {}
        shapes["mask"] = (self.mask, picture)
        shapes["depth"] = (None if self.depth is None else self.depth.depth_m, picture)
        shapes["poses"] = (self.X_CH, (frames, 4, 4))
        shapes["finger_width_m"] = (self.finger_width_m, (frames,))
        for name, (given, wanted) in shapes.items():
            if given is not None and given.shape != wanted:
                raise InputError(f"{name} given for the video: shape {given.shape}, expected {wanted}")


NOTHING = Known()
"""Pixels only."""
