"""Frames to ground."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Clip:
    """Frames to ground."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB, as decoded."""
    t_s: Array
    """(T,) task time of each frame [s]."""
    conditioning: NDArray[np.uint8] | None = None
    """(h, w, 3) image from which the video was generated, which shows how its frames lie in the camera's image."""
    is_view: bool = False
    """True if the camera takes that image, from which the view of the first frame may differ."""

    def mirrored(self) -> Self:
        """Return the clip turned left-right."""
        image = None if self.conditioning is None else np.ascontiguousarray(self.conditioning[:, ::-1])
        return replace(self, frames=np.ascontiguousarray(self.frames[:, :, ::-1]), conditioning=image)
