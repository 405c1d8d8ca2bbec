"""Clips as video models of other sizes show them: scaled, letter-boxed, cropped, stretched; and what that costs."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.clip import TruthClip
from kinebench_drake.grounding.framing.framing import Framing, placements
from kinebench_drake.grounding.framing.search import find_framing
from kinebench_drake.grounding.view import Frames

SIZES = ((832, 480), (720, 480), (512, 512))
"""Width and height of videos that models give [px]."""
WAYS = ("stretch", "letterbox", "crop")
"""What is done where the shape is another; `scaled` where it is the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reframing:
    """One way to show a clip in another size."""

    size: tuple[int, int]
    """Width and height of the video [px]."""
    way: str
    """Of `WAYS`, or `scaled`."""

    @property
    def label(self) -> str:
        """What stands in tables."""
        return f"{self.way} to {self.size[0]}x{self.size[1]}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reframed:
    """A clip shown so, with the framing undone as `score` does it."""

    clip: TruthClip
    """The clip with the camera that was found."""
    frames: Frames
    shown: Array
    """(T,) part of what is seen of the gripper that is still in the picture."""


def reframings() -> tuple[Reframing, ...]:
    """Every size in every way."""
    found = []
    for size in SIZES:
        ways = WAYS if size[0] != size[1] else ("scaled",)
        found += [Reframing(size=size, way=way) for way in ways]
    return tuple(found)


def reframe(reframing: Reframing, clip: TruthClip, frames: Frames, masks: NDArray[np.bool_]) -> Reframed:
    """Show a square clip in another size, then find out and undo what was done.

    Args:
        reframing: how to show it.
        clip: the clip; the benchmark's are square.
        frames: (T, H, W, 3) its frames.
        masks: (T, H, W) pixels that show the gripper.

    Raises:
        UnmeasurableError: the framing was not found.
    """
    picture = (frames.shape[2], frames.shape[1])
    usual = placements(picture, reframing.size)
    made = usual[0] if reframing.way in ("scaled", "stretch") else usual[1 if reframing.way == "letterbox" else 4]
    shown = np.stack([_shown(frame, made) for frame in frames])
    found = find_framing(shown, clip.camera, frames[0])
    ends = (np.array([[0, 0], reframing.size]) - made.map[:, 2]) / np.diag(made.map)  # of the video, in the picture
    (left, top), (right, bottom) = np.clip(ends, 0, picture).round().astype(int)
    kept = masks[:, top:bottom, left:right].sum(axis=(1, 2)) / np.maximum(masks.sum(axis=(1, 2)), 1)
    return Reframed(clip=replace(clip, camera=found.camera(clip.camera)), frames=found.crop(shown), shown=kept)


def _shown(frame: NDArray[np.uint8], framing: Framing) -> NDArray[np.uint8]:
    """A frame as the video shows it, black where there is nothing."""
    width, height = (round(x) for x in framing.corners[1] - framing.corners[0])
    less = width < frame.shape[1] or height < frame.shape[0]
    scaled = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA if less else cv2.INTER_CUBIC)
    out = np.zeros((framing.height, framing.width, 3), np.uint8)
    x, y = (round(offset) for offset in framing.map[:, 2])
    inside = scaled[max(0, -y) : framing.height - y, max(0, -x) : framing.width - x]
    out[max(0, y) : max(0, y) + inside.shape[0], max(0, x) : max(0, x) + inside.shape[1]] = inside
    return out
