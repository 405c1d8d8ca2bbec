"""Pictures of samples: the frame that a thumbnail shows, and a few frames in a row."""

import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.track import GripperTrack

if TYPE_CHECKING:  # loads Drake
    from kinebench_drake.metrics.kinematic_result import KinematicResult


def worst_frame(track: GripperTrack, kinematics: "KinematicResult | None") -> int:
    """Return the frame of the first violation, else the tracked frame of lowest confidence."""
    if kinematics and kinematics.violations:
        return min(max(int(kinematics.violations[0].frame_start), 0), len(track.t_s) - 1)
    return int(np.argmin(np.where(track.tracked, np.nan_to_num(track.confidence), 2.0)))


def encode_strip(images: list[NDArray[np.uint8]]) -> bytes:
    """Encode images of equal height, side by side, as a small JPEG."""
    strip = Image.fromarray(np.concatenate(images, axis=1))
    strip.thumbnail((10_000, 240), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    strip.save(buffer, "JPEG", quality=82, optimize=True)
    return buffer.getvalue()
