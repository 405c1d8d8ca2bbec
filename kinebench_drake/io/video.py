"""A decoded video as an array, the part of a file that is a video, and limits of both."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.geometry import Array

MIN_FRAMES = 2
"""A path needs two poses."""
MIN_SIDE_PX = 64
"""Below this the gripper covers a handful of pixels in any benchmark view."""
MAX_BYTES = 6 * 2**30
"""Larger videos are refused, to protect the machine's memory [bytes of decoded frames]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Video:
    """Decoded frames and their times according to the file."""

    frames: NDArray[np.uint8]
    """(T, H, W, 3) RGB."""
    fps: float | None
    """Frames per second [1/s]; None if the source has no clock (frame folders, arrays)."""
    stamps_s: Array | None
    """(T,) time stamps of an irregular video, from 0, increasing [s]; None if they follow from `fps`."""
    surplus: int = 0
    """Frames that the file holds after those of its dataset, which are not used."""

    def __post_init__(self) -> None:
        """Check shape and type.

        Raises:
            InputError: the frames are not (T, H, W, 3) uint8, or there are none.
        """
        if self.frames.dtype != np.uint8 or self.frames.ndim != 4 or self.frames.shape[3] != 3:
            channel_first = self.frames.ndim == 4 and self.frames.shape[1] == 3
            hint = "; looks channel-first: transpose(0, 2, 3, 1)" if channel_first else ""
            raise InputError(
                f"found {self.frames.dtype} of shape {self.frames.shape}, expected uint8 (T, H, W, 3) in RGB{hint}"
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

    def mirrored(self) -> "Video":
        """Return the video turned left-right."""
        return replace(self, frames=np.ascontiguousarray(self.frames[:, :, ::-1]))

    def require_measurable(self) -> None:
        """Check that a track can be estimated.

        Raises:
            UnmeasurableError: there are too few frames or too few pixels.
        """
        if len(self.frames) < MIN_FRAMES:
            raise UnmeasurableError(f"has {len(self.frames)} frame, a track needs at least {MIN_FRAMES}")
        if min(self.width, self.height) < MIN_SIDE_PX:
            raise UnmeasurableError(f"is {self.width} x {self.height} px, each side needs at least {MIN_SIDE_PX} px")


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoPart:
    """Part of a file that is one video."""

    key: str | None = None
    """Array of an npz file, data set of an HDF5 file, column of a parquet file; None for the only one."""
    episode: int | None = None
    """Episode of a parquet file."""
    from_s: float | None = None
    """Time stamp of the first frame in a container [s]; None for the beginning of the file."""
    to_s: float | None = None
    """Time stamp of the first frame after the part [s]; None for the end of the file."""
    frames: int | None = None
    """Number of frames, of more the first ones; None for all."""


WHOLE = VideoPart()
"""The whole file."""


def check_size(name: str, size: int) -> None:
    """Refuse a video that would not fit into memory.

    Raises:
        InputError: the decoded frames take more than `MAX_BYTES`.
    """
    if size > MAX_BYTES:
        raise InputError(f"{name} exceeds {MAX_BYTES / 2**30:.0f} GiB when decoded; cut it into shorter clips")


def stack_frames(name: str, images: Iterable[tuple[str, NDArray[np.uint8]]]) -> NDArray[np.uint8]:
    """Stack images (H, W, 3), each with its name, into the frames (T, H, W, 3) of a video, called `name` in messages.

    Raises:
        InputError: the images differ in size or take too much memory.
    """
    frames: list[NDArray[np.uint8]] = []
    size = 0
    for label, image in images:
        if frames and image.shape != frames[0].shape:
            (height, width), (first_height, first_width) = image.shape[:2], frames[0].shape[:2]
            raise InputError(f"{label}: size {width} x {height}, the first frame has {first_width} x {first_height}")
        size += image.nbytes
        check_size(name, size)
        frames.append(image)
    return np.stack(frames)
