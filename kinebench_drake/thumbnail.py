"""The small picture of a sample that the report shows: its first frame and its worst, with the gripper drawn."""

import io
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.products import GripperTrack
from kinebench_drake.stages import Judgement

HEIGHT_PX = 240


def worst_frame(track: GripperTrack, judgement: Judgement | None) -> int:
    """The frame a reviewer wants to see: where the first violation begins, else the least certain tracked one."""
    for violation in judgement.violations if judgement else ():
        frame = violation.get("frame_start")
        if isinstance(frame, int):
            return min(max(frame, 0), len(track.t_s) - 1)
    return int(np.argmin(np.where(track.tracked, np.nan_to_num(track.confidence), 2.0)))


def track_at(track: GripperTrack, frames: NDArray[np.intp]) -> GripperTrack:
    """The track at some of its frames."""
    return replace(
        track,
        t_s=track.t_s[frames],
        X_CH=track.X_CH[frames],
        X_BG=track.X_BG[frames],
        tracked=track.tracked[frames],
        confidence=track.confidence[frames],
        finger_width_m=track.finger_width_m[frames],
    )


def side_by_side(images: list[NDArray[np.uint8]]) -> bytes:
    """A small JPEG of some frames in a row."""
    strip = Image.fromarray(np.concatenate(images, axis=1))
    strip.thumbnail((10_000, HEIGHT_PX), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    strip.save(buffer, "JPEG", quality=82, optimize=True)
    return buffer.getvalue()
