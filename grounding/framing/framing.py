"""Framing: how a video shows the image its model was given (scaled, letter-boxed, cropped, stretched)."""

from dataclasses import dataclass, replace
from enum import Enum
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array

SQUARE = 0.01
"""Scales along x and y that differ by no more, relatively, are one scale (`Camera.resized` allows as much)."""
_PART_PX = 0.75  # bars and crops of less are rounding


class Change(Enum):
    """What was done to the picture beside scaling it."""

    LETTERBOX = "letterbox"
    CROP = "crop"
    STRETCH = "stretch"


class Witness(Enum):
    """What tells the framing."""

    SIZE = "size"
    FIRST_FRAME = "first_frame"
    BARS = "bars"


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """Where the picture is in the frames of a video."""

    width: int
    """Width of the video [px]."""
    height: int
    """Height of the video [px]."""
    picture_width: float
    """Width of the picture [px]."""
    picture_height: float
    """Height of the picture [px]."""
    scale_x: float
    scale_y: float
    offset_x: float
    """Where the picture's left edge is in the video [px]; negative where it is cropped."""
    offset_y: float
    """Where its upper edge is [px]."""
    witness: Witness = Witness.SIZE
    correlation: float | None = None
    """How well the first frame agrees with the picture, up to 1; None where they were not compared."""

    @classmethod
    def filling(cls, picture: tuple[float, float], video: tuple[int, int]) -> "Framing":
        """A picture of (width, height) stretched over a video of (width, height), as a camera is scaled."""
        (w, h), (width, height) = picture, video
        return cls(
            width=width,
            height=height,
            picture_width=w,
            picture_height=h,
            scale_x=width / w,
            scale_y=height / h,
            offset_x=0.0,
            offset_y=0.0,
        )

    @property
    def map(self) -> Array:
        """(2, 3) matrix from points of the picture to points of the video [px]."""
        return np.array([[self.scale_x, 0.0, self.offset_x], [0.0, self.scale_y, self.offset_y]])

    @property
    def corners(self) -> Array:
        """(2, 2) the picture's upper left and lower right corner in the video [px]."""
        return np.array([[0.0, 0.0], [self.picture_width, self.picture_height]]) * np.diag(self.map) + self.map[:, 2]

    @property
    def changes(self) -> tuple[Change, ...]:
        """What was done beside scaling."""
        (left, top), (right, bottom) = self.corners
        over = np.array([left, top, self.width - right, self.height - bottom])
        found = {
            Change.LETTERBOX: (over > _PART_PX).any(),
            Change.CROP: (over < -_PART_PX).any(),
            Change.STRETCH: abs(self.scale_x / self.scale_y - 1.0) > SQUARE,
        }
        return tuple(change for change, there in found.items() if there)

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the video that show the picture and nothing of the bars."""
        (left, top), (right, bottom) = self.corners
        rows, columns = (
            slice(max(0, int(np.ceil(low - _PART_PX))), min(size, int(np.floor(high + _PART_PX))))
            for low, high, size in ((top, bottom, self.height), (left, right, self.width))
        )
        return rows, columns

    def whole_camera(self, camera: Camera) -> Camera:
        """The camera of the video's frames with their bars, from that of the picture (at any size of it)."""
        if self.witness is Witness.SIZE and not self.changes:
            return camera.resized(self.width, self.height)
        x, y = self.scale_x * self.picture_width / camera.width, self.scale_y * self.picture_height / camera.height
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
        """The camera of the frames without their bars, from that of the picture."""
        whole = self.whole_camera(camera)
        rows, columns = self.window
        return replace(
            whole,
            width=columns.stop - columns.start,
            height=rows.stop - rows.start,
            cx=whole.cx - columns.start,
            cy=whole.cy - rows.start,
        )

    def cut(self, frames: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The frames (T, H, W, ...) without their bars."""
        rows, columns = self.window
        if (rows.stop - rows.start, columns.stop - columns.start) == frames.shape[1:3]:
            return frames
        return np.ascontiguousarray(frames[:, rows, columns])

    def mapped(self, scale: Array, offset: Array) -> "Framing":
        """The same picture in the same video at other scales (2,) and offsets (2,) [px]."""
        (scale_x, scale_y), (offset_x, offset_y) = scale.tolist(), offset.tolist()
        return replace(self, scale_x=scale_x, scale_y=scale_y, offset_x=offset_x, offset_y=offset_y)

    def to_json(self) -> dict[str, str | float | list[str] | None]:
        """The framing as results tell it."""
        numbers = {
            "scale_x": self.scale_x,
            "scale_y": self.scale_y,
            "offset_x_px": self.offset_x,
            "offset_y_px": self.offset_y,
        }
        return {
            "changes": [change.value for change in self.changes],
            "told_by": self.witness.value,
            **{name: round(float(value), 4) + 0.0 for name, value in numbers.items()},
            "correlation": None if self.correlation is None else round(self.correlation, 3),
        }


_PLACES = (0.5, 0.0, 1.0)  # centred, at the beginning, at the end
_ZOOMS = (1.15, 1.35)  # crops that are deeper than they need to be


def placements(picture: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """What resizing programs do: scale, stretch, letter-box and crop, the last two centred or at an edge.

    Args:
        picture: width and height of the picture [px].
        video: width and height of the video [px].
    """
    filled = Framing.filling(picture, video)
    if abs(filled.scale_x / filled.scale_y - 1.0) <= SQUARE:
        return [filled]
    least, most = sorted((filled.scale_x, filled.scale_y))
    return [filled, *(_placed(filled, scale, place) for scale in (least, most) for place in _PLACES)]


def letterboxes(picture: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """The picture inside the video with bars, centred or at an edge; none where it fills the video."""
    filled = Framing.filling(picture, video)
    if abs(filled.scale_x / filled.scale_y - 1.0) <= SQUARE:
        return []
    return [_placed(filled, min(filled.scale_x, filled.scale_y), place) for place in _PLACES]


def deeper_crops(picture: tuple[float, float], video: tuple[int, int]) -> list[Framing]:
    """Centred crops that show less than would fill the video; where a search for a free one may begin."""
    filled = Framing.filling(picture, video)
    return [_placed(filled, zoom * max(filled.scale_x, filled.scale_y), 0.5) for zoom in _ZOOMS]


def _placed(filled: Framing, scale: float, place: float) -> Framing:
    return replace(
        filled,
        scale_x=scale,
        scale_y=scale,
        offset_x=place * (filled.width - scale * filled.picture_width),
        offset_y=place * (filled.height - scale * filled.picture_height),
    )


ImageType = TypeVar("ImageType", np.uint8, np.bool_)


def unframed(framing: Framing, images: NDArray[ImageType]) -> NDArray[ImageType]:
    """Images (T, h, w, ...) without their bars in the shape of the picture; 0 where it was cropped.

    They get the larger of the two scales, so that nothing of them is lost.
    """
    rows, columns = framing.window
    scale = max(framing.scale_x, framing.scale_y)
    size = round(framing.picture_width * scale), round(framing.picture_height * scale)
    if not framing.changes and size == (images.shape[2], images.shape[1]):
        return images
    M = framing.map - [[0.0, 0.0, columns.start], [0.0, 0.0, rows.start]]
    M[:, :2] /= scale
    M[:, 2] += 0.5 * np.diag(M) - 0.5  # OpenCV's centres are integers
    smooth = images.dtype != np.bool_
    flags = (cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST) | cv2.WARP_INVERSE_MAP
    source = images if smooth else images.astype(np.uint8)
    return np.stack([cv2.warpAffine(image, M, size, flags=flags) for image in source]).astype(images.dtype)
