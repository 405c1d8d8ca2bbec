"""Clips shown in the sizes and shapes of video models (scaled, letterboxed, cropped, stretched), and the inverse."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.perception.clip import TruthClip
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.camera.framing import Framing, placements
from kinebench_drake.grounding.camera.framing_search import find_framing
from kinebench_drake.io.frames import Frames

SIZES = ((832, 480), (720, 480), (512, 512))
"""Width and height of the output of common video models [px]."""
WAYS = ("stretch", "letterbox", "crop")
"""Ways to fit a square image into another shape; `scaled` if the shape is the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reframing:
    """Output size, and the way to fit the image into it."""

    size: tuple[int, int]
    """Width and height of the video [px]."""
    way: str
    """One of `WAYS`, or `scaled`."""

    @property
    def label(self) -> str:
        """Name in tables."""
        return f"{self.way} to {self.size[0]}x{self.size[1]}"


def reframings() -> tuple[Reframing, ...]:
    """Return every size in every way."""
    return tuple(
        Reframing(size=size, way=way) for size in SIZES for way in (WAYS if size[0] != size[1] else ("scaled",))
    )


def reframe(
    reframing: Reframing, clip: TruthClip, frames: Frames, masks: NDArray[np.bool_]
) -> tuple[TruthClip, Frames, Array]:
    """Show a square clip in another size, then estimate the framing and undo it as `score` does.

    Args:
        reframing: output size and way.
        clip: the clip; benchmark clips are square.
        frames: (T, H, W, 3) its frames.
        masks: (T, H, W) gripper pixels.

    Returns:
        The clip with the camera of the estimated framing, its frames, and the share (T,) of the gripper's pixels that
        are still in the image.

    Raises:
        UnmeasurableError: the framing cannot be estimated.
    """
    size = (frames.shape[2], frames.shape[1])
    candidates = placements(size, reframing.size)
    index = 0 if reframing.way in ("scaled", "stretch") else 1 if reframing.way == "letterbox" else 4
    true = candidates[index]
    video = np.stack([_apply(frame, true) for frame in frames])
    estimate = find_framing(video, clip.camera, frames[0])
    ends = (np.array([[0, 0], reframing.size]) - true.map[:, 2]) / np.diag(true.map)  # of the video, in the image
    (left, top), (right, bottom) = np.clip(ends, 0, size).round().astype(int)
    shown = masks[:, top:bottom, left:right].sum(axis=(1, 2)) / np.maximum(masks.sum(axis=(1, 2)), 1)
    return replace(clip, camera=estimate.camera(clip.camera)), estimate.crop(video), shown


def _apply(frame: NDArray[np.uint8], framing: Framing) -> NDArray[np.uint8]:
    """Return the frame of the video that a framing makes of an image; black outside the image."""
    width, height = (round(x) for x in framing.corners[1] - framing.corners[0])
    smaller = width < frame.shape[1] or height < frame.shape[0]
    scaled = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_CUBIC)
    out = np.zeros((framing.height, framing.width, 3), np.uint8)
    x, y = (round(offset) for offset in framing.map[:, 2])
    inside = scaled[max(0, -y) : framing.height - y, max(0, -x) : framing.width - x]
    out[max(0, y) : max(0, y) + inside.shape[0], max(0, x) : max(0, x) + inside.shape[1]] = inside
    return out
