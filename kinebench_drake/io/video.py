"""A decoded video as an array, and its limits."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.geometry import Array

MIN_FRAMES = 2
"""A path needs two poses."""
MIN_SIDE_PX = 64
"""Below this the gripper covers a handful of pixels in any benchmark view."""
MAX_BYTES = 6 * 2**30
"""Decoded frames beyond this are refused rather than risking the machine's memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Video:
    """Decoded frames and what the file says about their time."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB."""
    fps: float | None
    """Frames per second [1/s]; None where the source has no clock (frame folders, arrays)."""
    stamps_s: Array | None
    """(T,) time stamps of an irregular film, from 0, increasing [s]; None where `fps` says it all."""

    def __post_init__(self) -> None:
        """Check shape and type.

        Raises:
            InputError: the frames are not (T, H, W, 3) uint8, or there are none.
        """
        if self.frames.dtype != np.uint8 or self.frames.ndim != 4 or self.frames.shape[3] != 3:
            raise InputError(
                f"found {self.frames.dtype} of shape {self.frames.shape}, expected uint8 (T, H, W, 3) in RGB"
            )
        if not self.frames.size:
            raise InputError("holds no frame")

    @property
    def width(self) -> int:
        """Image width [px]."""
        return int(self.frames.shape[2])

    @property
    def height(self) -> int:
        """Image height [px]."""
        return int(self.frames.shape[1])

    def require_measurable(self) -> None:
        """Refuse what no track can be taken from.

        Raises:
            UnmeasurableError: there are too few frames or too few pixels.
        """
        if len(self.frames) < MIN_FRAMES:
            raise UnmeasurableError(f"has {len(self.frames)} frame, a track needs at least {MIN_FRAMES}")
        if min(self.width, self.height) < MIN_SIDE_PX:
            raise UnmeasurableError(f"is {self.width} x {self.height} px, each side needs at least {MIN_SIDE_PX} px")


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoPart:
    """Which part of a file is the video, where the file holds more."""

    key: str | None = None
    """Array of an npz file, data set of an HDF5 file, column of a parquet file; None for the only one."""
    episode: int | None = None
    """Episode of a parquet file."""
    from_s: float | None = None
    """Time stamp of the first frame in a film [s]; None for its beginning."""
    to_s: float | None = None
    """Time stamp at which something else begins [s]; None for the film's end."""
    frames: int | None = None
    """Frames that must be there; None where nobody tells."""


WHOLE = VideoPart()
"""All of a file."""


def check_size(name: str, size: int) -> None:
    """Refuse what would not fit into memory.

    Raises:
        InputError: the decoded frames take more than `MAX_BYTES`.
    """
    if size > MAX_BYTES:
        raise InputError(f"{name} exceeds {MAX_BYTES / 2**30:.0f} GiB when decoded; cut it into shorter clips")
