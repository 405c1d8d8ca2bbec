"""Framing of a video: how it shows the conditioning image (scaled, letter-boxed, cropped, stretched)."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.io.frames import Frames

_SQUARE = 0.01
"""Relative difference of the scales that counts as none (`Camera.resized` allows as much)."""
PART_PX = 0.75
"""Least width of a bar or crop, or displacement of a corner; less is rounding [px]."""
_PLACES = (0.5, 0.0, 1.0)
"""Places of an image in a longer side: centred, at the beginning, at the end."""
_ZOOMS = (1.15, 1.35)
"""Crops tighter than needed to fill the video."""

ImageType = TypeVar("ImageType", np.uint8, np.bool_)


class FramingChange(Enum):
    """Change of the conditioning image besides scaling."""

    LETTERBOX = "letterbox"
    CROP = "crop"
    STRETCH = "stretch"


class FramingSource(Enum):
    """Source of the framing."""

    SIZE = "size"
    FIRST_FRAME = "first_frame"
    BARS = "bars"


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """Map from the conditioning image to the frames of a video."""

    width: int
    """Width of the video [px]."""
    height: int
    """Height of the video [px]."""
    image_width: float
    """Width of the conditioning image [px]."""
    image_height: float
    """Height of the conditioning image [px]."""
    scale_x: float
    scale_y: float
    offset_x: float
    """Left edge of the image in the video [px]; negative if cropped."""
    offset_y: float
    """Upper edge of the image in the video [px]."""
    source: FramingSource = FramingSource.SIZE
    correlation: float | None = None
    """Correlation of the first frame with the image, at most 1; None if they were not compared."""

    @classmethod
    def filling(cls, image: tuple[float, float], video: tuple[int, int]) -> "Framing":
        """Return the framing of an image of (width, height) scaled to a video of (width, height)."""
        (w, h) = image
        (width, height) = video
        return cls(
            width=width,
            height=height,
            image_width=w,
            image_height=h,
            scale_x=width / w,
            scale_y=height / h,
            offset_x=0.0,
            offset_y=0.0,
        )

    @property
    def map(self) -> Array:
        """(2, 3) matrix from points of the image to points of the video [px]."""
        return np.array([[self.scale_x, 0.0, self.offset_x], [0.0, self.scale_y, self.offset_y]])

    @property
    def corners(self) -> Array:
        """(2, 2) upper left and lower right corner of the image in the video [px]."""
        return np.array([[0.0, 0.0], [self.image_width, self.image_height]]) * np.diag(self.map) + self.map[:, 2]

    @property
    def changes(self) -> tuple[FramingChange, ...]:
        """Changes besides scaling."""
        (left, top), (right, bottom) = self.corners
        over = np.array([left, top, self.width - right, self.height - bottom])
        changed = {
            FramingChange.LETTERBOX: (over > PART_PX).any(),
            FramingChange.CROP: (over < -PART_PX).any(),
            FramingChange.STRETCH: not _is_square(self),
        }
        return tuple(change for change, applies in changed.items() if applies)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the video between the bars."""
        (left, top), (right, bottom) = self.corners
        rows, columns = (
            slice(max(0, int(np.ceil(low - PART_PX))), min(size, int(np.floor(high + PART_PX))))
            for low, high, size in ((top, bottom, self.height), (left, right, self.width))
        )
        return rows, columns

    @property
    def frame_map(self) -> Array:
        """(2, 3) matrix from points of the image to points of the frames without their bars [px]."""
        rows, columns = self.window
        return np.asarray(self.map - [[0.0, 0.0, columns.start], [0.0, 0.0, rows.start]])

    def whole_camera(self, camera: Camera) -> Camera:
        """Return the camera of the frames with their bars, from that of the image (at any size)."""
        if self.source is FramingSource.SIZE and not self.changes:
            return camera.resized(self.width, self.height)
        x = self.scale_x * self.image_width / camera.width
        y = self.scale_y * self.image_height / camera.height
        return replace(
            camera,
            width=self.width,
            height=self.height,
            fx=camera.fx * x,
            fy=camera.fy * y,
            cx=camera.cx * x + self.offset_x,
            cy=camera.cy * y + self.offset_y,
        )

    def camera(self, camera: Camera) -> Camera:
        """Return the camera of the frames without their bars, from that of the image."""
        whole = self.whole_camera(camera)
        rows, columns = self.window
        return replace(
            whole,
            width=columns.stop - columns.start,
            height=rows.stop - rows.start,
            cx=whole.cx - columns.start,
            cy=whole.cy - rows.start,
        )

    def crop(self, frames: Frames) -> Frames:
        """Return the frames without their bars."""
        rows, columns = self.window
        if (rows.stop - rows.start, columns.stop - columns.start) == frames.shape[1:3]:
            return frames
        cropped: Frames = frames[:, rows, columns]
        return cropped

    def to_json(self) -> dict[str, str | float | list[str] | None]:
        """Serialize the framing for results."""
        return {
            "changes": [change.value for change in self.changes],
            "source": self.source.value,
            "scale_x": round(float(self.scale_x), 4) + 0.0,
            "scale_y": round(float(self.scale_y), 4) + 0.0,
            "offset_x_px": round(float(self.offset_x), 4) + 0.0,
            "offset_y_px": round(float(self.offset_y), 4) + 0.0,
            "correlation": None if self.correlation is None else round(self.correlation, 3),
        }


def placements(image: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """Return the usual framings: scaled, stretched, letter-boxed and cropped, the last two centred or at an edge.

    `image` and `video` are widths and heights [px].
    """
    filled = Framing.filling(image, video)
    if _is_square(filled):
        return [filled]
    scales = sorted((filled.scale_x, filled.scale_y))
    return [filled, *(_placed(filled, scale, place) for scale in scales for place in _PLACES)]


def letterboxes(image: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """Return the framings with bars, centred or at an edge; none if the image fills the video."""
    return placements(image, video)[1 : 1 + len(_PLACES)]


def deeper_crops(image: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """Return centred crops tighter than needed to fill the video: initial values of a search for any crop."""
    filled = Framing.filling(image, video)
    return [_placed(filled, zoom * max(filled.scale_x, filled.scale_y), 0.5) for zoom in _ZOOMS]


def _is_square(framing: Framing) -> bool:
    return abs(framing.scale_x / framing.scale_y - 1.0) <= _SQUARE


def _placed(filled: Framing, scale: float, place: float) -> Framing:
    return replace(
        filled,
        scale_x=scale,
        scale_y=scale,
        offset_x=place * (filled.width - scale * filled.image_width),
        offset_y=place * (filled.height - scale * filled.image_height),
    )


def undo_framing(framing: Framing, images: NDArray[ImageType]) -> NDArray[ImageType]:
    """Warp images (T, h, w, ...) without bars back to the shape of the conditioning image; 0 where it was cropped.

    The result has the larger of the two scales, so that no resolution is lost.
    """
    import cv2  # slow to load, and not needed by the commands that import `Framing`

    scale = max(framing.scale_x, framing.scale_y)
    size = round(framing.image_width * scale), round(framing.image_height * scale)
    if not framing.changes and size == (images.shape[2], images.shape[1]):
        return images
    M = framing.frame_map
    M[:, :2] /= scale
    M[:, 2] += 0.5 * np.diag(M) - 0.5  # OpenCV's pixel centres are integers
    smooth = images.dtype != np.bool_
    flags = (cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST) | cv2.WARP_INVERSE_MAP
    source = images if smooth else images.astype(np.uint8)
    return np.stack([cv2.warpAffine(image, M, size, flags=flags) for image in source]).astype(images.dtype)


def apply_framing(framing: Framing, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Warp the conditioning image (h, w, 3) to the frames without their bars; its border is repeated beyond it."""
    import cv2  # as above

    rows, columns = framing.window
    scale = [framing.image_width / image.shape[1], framing.image_height / image.shape[0]]
    M = framing.frame_map
    M[:, :2] *= scale
    M[:, 2] += 0.5 * np.diag(M) - 0.5  # OpenCV's pixel centres are integers
    size = columns.stop - columns.start, rows.stop - rows.start
    if size == image.shape[1::-1] and not framing.changes:
        return image
    return np.asarray(cv2.warpAffine(image, M, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)
