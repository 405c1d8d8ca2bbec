"""The small picture of a sample that the report shows: its first frame and its worst, with the gripper drawn."""

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.evaluation.stages import Judgement
from kinebench_drake.types import GripperTrack

HEIGHT_PX = 240


def worst_frame(track: GripperTrack, judgement: Judgement | None) -> int:
    """The frame a reviewer wants to see: where the first violation begins, else the least certain tracked one."""
    for violation in judgement.violations if judgement else ():
        frame = violation.get("frame_start")
        if isinstance(frame, int):
            return min(max(frame, 0), len(track.t_s) - 1)
    return int(np.argmin(np.where(track.tracked, np.nan_to_num(track.confidence), 2.0)))


def side_by_side(images: list[NDArray[np.uint8]]) -> bytes:
    """A small JPEG of some frames in a row."""
    strip = Image.fromarray(np.concatenate(images, axis=1))
    strip.thumbnail((10_000, HEIGHT_PX), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    strip.save(buffer, "JPEG", quality=82, optimize=True)
    return buffer.getvalue()
