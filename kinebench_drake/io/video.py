"""A decoded video, the part of a file that is a video, and the least that can be measured."""

from dataclasses import dataclass, replace

from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.io.frames import Frames, require_frames

MIN_FRAMES = 2
"""A path needs two poses."""
MIN_SIDE_PX = 64
"""Below this the gripper covers a handful of pixels in any benchmark view."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Video:
    """Decoded frames and their times according to the file."""

    frames: Frames
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
        require_frames("the video", self.frames.shape, self.frames.dtype)

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
        return replace(self, frames=self.frames[:, :, ::-1])

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
