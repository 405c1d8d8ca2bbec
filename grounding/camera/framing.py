"""Framing of a video: how it shows the conditioning image (scaled, letter-boxed, cropped, stretched), and its search.

Bars tell how an image is letter-boxed. Otherwise the conditioning image is aligned with the first frame.
"""

from dataclasses import dataclass, replace
from enum import Enum
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, CameraSource
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.video import MIN_SIDE_PX
from kinebench_drake.segments import evenly

FIRST_FRAME_ADVICE = (
    "if the model resized or cropped its first frame, save that image as ID.png beside ID.mp4: the change is then "
    "undone, and the clip takes seconds instead of minutes"
)
"""What to do where the camera of a video without its conditioning image is not known."""
_LEAST_CORRELATION = 0.75
"""Least correlation of a first frame that shows the conditioning image."""
_BAR_LEVELS = 7.0
"""Grey levels of 255 by which a bar may vary, over its area and in time, and by which the image beside it differs."""
_COARSE_PX = (48, 96)
"""Longer sides of the frame at the coarse levels of the image pyramid [px]."""
_FINE_PX = (192, 384)
"""The same at the fine levels [px]."""
_MAX_STEPS = 12
_CONVERGED_PX = 0.01
_MIN_VARIANCE = 1.0
"""Least variance of an image's grey levels: one of a single grey cannot be aligned."""
_MIN_SHARE = 0.2
"""Least share of the frame's pixels that the image must cover."""
_TUKEY = 4.685
_DETAIL_PX = 10.0
"""Scale of the high-pass filter of the correlation [px]."""
_MARGIN_PX = 4
"""Width to which a codec blurs an edge [px]."""
Grey = NDArray[np.float32]
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
        return cls(
            width=video[0],
            height=video[1],
            image_width=image[0],
            image_height=image[1],
            scale_x=video[0] / image[0],
            scale_y=video[1] / image[1],
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
    rows, columns = framing.window
    scale = [framing.image_width / image.shape[1], framing.image_height / image.shape[0]]
    M = framing.frame_map
    M[:, :2] *= scale
    M[:, 2] += 0.5 * np.diag(M) - 0.5  # OpenCV's pixel centres are integers
    size = columns.stop - columns.start, rows.stop - rows.start
    if size == image.shape[1::-1] and not framing.changes:
        return image
    return np.asarray(cv2.warpAffine(image, M, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True)
class _PyramidLevel:
    """Image and frame at one resolution."""

    image: Grey
    frame: Grey


def align(image: NDArray[np.uint8], frame: NDArray[np.uint8]) -> Framing | None:
    """Find the conditioning image (h, w, 3) in the first frame (H, W, 3) of a video.

    Returns the framing, exactly a usual one if it is near one; None if the frame does not show the image.
    """
    size = (image.shape[1], image.shape[0])
    video = (frame.shape[1], frame.shape[0])
    usual = placements(size, video)
    greys = [cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) for rgb in (image, frame)]
    best = _refine(usual[0], greys, (*_COARSE_PX, *_FINE_PX))
    if (best.correlation or 0.0) < _LEAST_CORRELATION or _corner_distance_px(usual[0], best) > PART_PX:
        filled = usual[0]
        deeper = [_placed(filled, zoom * max(filled.scale_x, filled.scale_y), 0.5) for zoom in _ZOOMS]
        candidates = [_refine(start, greys, _COARSE_PX) for start in (*usual, *deeper)]
        candidates = sorted(candidates, key=lambda f: -(f.correlation or 0.0))[:3]
        best = max((_refine(start, greys, _FINE_PX) for start in candidates), key=lambda f: f.correlation or 0.0)
    if (best.correlation or 0.0) < _LEAST_CORRELATION:
        return None
    near = [u for u in usual if _corner_distance_px(u, best) <= PART_PX]
    if near:
        best = replace(min(near, key=lambda u: _corner_distance_px(u, best)), correlation=best.correlation)
    return replace(best, source=FramingSource.FIRST_FRAME)


def _corner_distance_px(a: Framing, b: Framing) -> float:
    """Return the largest displacement of a corner of the visible part of `b` by using the map of `a` instead [px]."""
    visible = np.clip(b.corners, 0.0, np.array([b.width, b.height]))
    points = (visible - b.map[:, 2]) / np.diag(b.map)  # in the image
    return float(np.abs(points * np.diag(a.map) + a.map[:, 2] - visible).max())


def _refine(start: Framing, greys: list[Grey], sides: tuple[int, ...]) -> Framing:
    """Refine a framing by Gauss-Newton at each resolution; its correlation is that at the last one."""
    framing = start
    for side in sides:
        framing = _gauss_newton(framing, _pyramid_level(framing, greys, side))
    return replace(framing, correlation=_correlation(framing, _pyramid_level(framing, greys, sides[-1])))


def _pyramid_level(framing: Framing, greys: list[Grey], side: int) -> _PyramidLevel:
    """Downsample image and frame such that the video's longer side has `side` pixels at most."""
    shrink = min(1.0, side / max(framing.width, framing.height))
    return _PyramidLevel(
        image=_downsample(greys[0], min(1.0, shrink * framing.scale_x), min(1.0, shrink * framing.scale_y)),
        frame=_downsample(greys[1], shrink, shrink),
    )


def _downsample(image: Grey, x: float, y: float) -> Grey:
    size = (max(8, round(image.shape[1] * x)), max(8, round(image.shape[0] * y)))
    area = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(area, (0, 0), 0.8), np.float32)


def _level_scales(framing: Framing, level: _PyramidLevel) -> tuple[Array, Array]:
    """Return the scales (2,) of the level's frame relative to the video, and of its image relative to the full one."""
    frame_px = np.array(level.frame.shape[::-1]) / [framing.width, framing.height]
    return frame_px, np.array(level.image.shape[::-1]) / [framing.image_width, framing.image_height]


def _inverse_map(framing: Framing, level: _PyramidLevel) -> Array:
    """Return (2, 2) rows (factor, shift) from pixels of the level's frame to its image, half-integer centres."""
    frame_px, image_px = _level_scales(framing, level)
    factor = image_px / (np.diag(framing.map) * frame_px)
    return np.column_stack([factor, -framing.map[:, 2] * image_px / np.diag(framing.map)])


def _with_inverse_map(inverse: Array, framing: Framing, level: _PyramidLevel) -> Framing:
    """Return the framing whose inverse map is `inverse` (2, 2)."""
    frame_px, image_px = _level_scales(framing, level)
    scale = image_px / (inverse[:, 0] * frame_px)
    offset = -inverse[:, 1] * scale / image_px
    (scale_x, scale_y) = scale.tolist()
    (offset_x, offset_y) = offset.tolist()
    return replace(framing, scale_x=scale_x, scale_y=scale_y, offset_x=offset_x, offset_y=offset_y)


def _warp(image: Grey, inverse: Array, shape: tuple[int, ...]) -> tuple[Grey, NDArray[np.bool_]]:
    """Return the image warped into the frame (H, W), and the pixels of the frame that it covers."""
    (kx, ox), (ky, oy) = inverse
    M = np.array([[kx, 0.0, ox + 0.5 * kx - 0.5], [0.0, ky, oy + 0.5 * ky - 0.5]])  # OpenCV's centres are integers
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpAffine(image, M, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    x = kx * (np.arange(shape[1]) + 0.5) + ox
    y = ky * (np.arange(shape[0]) + 0.5) + oy
    inside = np.outer((y > 1) & (y < image.shape[0] - 1), (x > 1) & (x < image.shape[1] - 1))
    return np.asarray(warped, np.float32), inside


def _gauss_newton(framing: Framing, level: _PyramidLevel) -> Framing:
    """Align the image with the frame at one resolution, brightness and contrast free; unchanged if that diverges."""
    inverse = _inverse_map(framing, level)
    gradients = [cv2.Sobel(level.image, cv2.CV_32F, 1 - k, k, ksize=3, scale=0.125) for k in (0, 1)]
    height, width = level.frame.shape
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    for _ in range(_MAX_STEPS):
        image, inside = _warp(level.image, inverse, level.frame.shape)
        if inside.mean() < _MIN_SHARE:
            break
        du, dv = (_warp(gradient, inverse, level.frame.shape)[0] for gradient in gradients)
        columns = np.stack([du * x, du, dv * y, dv, image, np.ones_like(image)], axis=-1)[inside]
        target = level.frame[inside]
        (variance, covariance), _ = np.cov(columns[:, 4], target)
        if variance < _MIN_VARIANCE:
            break
        gain = covariance / variance
        residual = target - target.mean() - gain * (columns[:, 4] - columns[:, 4].mean())
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1.0
        weight = np.clip(1.0 - (residual / (_TUKEY * sigma)) ** 2, 0.0, None)
        A = columns * [gain, gain, gain, gain, 1.0, 1.0]
        step = np.linalg.lstsq((A * weight[:, None]).T @ A, (A * weight[:, None]).T @ residual, rcond=None)[0][:4]
        inverse = inverse + np.array([[step[0] / width, step[1]], [step[2] / height, step[3]]])
        if not (np.isfinite(inverse).all() and (inverse[:, 0] > 0.05).all()):
            return framing
        if np.abs(step).max() < _CONVERGED_PX:
            break
    return _with_inverse_map(inverse, framing, level)


def _correlation(framing: Framing, level: _PyramidLevel) -> float:
    """Return the correlation of high-pass filtered frame and image, -1 to 1; 0 if they hardly overlap."""
    image, inside = _warp(level.image, _inverse_map(framing, level), level.frame.shape)
    if inside.mean() < _MIN_SHARE:
        return 0.0
    filled = [np.where(inside, grey, grey[inside].mean()) for grey in (image, level.frame)]
    blurred = [cv2.GaussianBlur(grey, (0, 0), _DETAIL_PX) for grey in filled]
    details = [(grey - smooth)[inside] for grey, smooth in zip((image, level.frame), blurred, strict=True)]
    a, b = (detail - detail.mean() for detail in details)
    norm = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / norm if norm > 0 else 0.0


def find_bars(frames: Frames, image: tuple[float, float]) -> Framing | None:
    """Find the framing in which an image of (width, height) lies between bars of frames (T, H, W, 3); None without.

    Every bar must have one constant colour and end at the edge of the image.
    """
    subset = np.asarray(frames[evenly(len(frames), bounds.SAMPLED_FRAMES)]).astype(np.float32)
    for framing in letterboxes(image, (frames.shape[2], frames.shape[1])):
        rows, columns = framing.window
        across = columns.stop - columns.start < framing.width
        strips = np.swapaxes(subset, 1, 2) if across else subset  # bars as the first and last rows
        begin, end = (columns.start, columns.stop) if across else (rows.start, rows.stop)
        sides = [(strips[:, :begin], strips[:, begin:]), (strips[:, end:][:, ::-1], strips[:, :end][:, ::-1])]
        if all(_is_bar(bar, inside) for bar, inside in sides if bar.shape[1] > 1):
            return replace(framing, source=FramingSource.BARS)
    return None


def _is_bar(bar: NDArray[np.float32], inside: NDArray[np.float32]) -> bool:
    """Return whether rows (T, n, W, 3) have one constant colour and differ from the first rows of `inside`."""
    area = bar[:, : max(1, bar.shape[1] - _MARGIN_PX)]
    colour = np.median(area, axis=(0, 1, 2))
    edge = inside[:, _MARGIN_PX : 2 * _MARGIN_PX]
    constant = float(np.percentile(np.abs(area - colour), 99)) <= _BAR_LEVELS
    return constant and float(np.abs(edge - colour).max(axis=-1).mean()) >= _BAR_LEVELS


def find_framing(
    frames: Frames, camera: Camera, image: NDArray[np.uint8] | None, source: CameraSource | None = None
) -> Framing:
    """Find where the camera's image is in the frames of a video.

    The first frame is aligned with the conditioning image, unless the camera has exactly the video's size and not the
    image's: then it is the video's own camera. Failing that, a video of the camera's shape shows the image scaled, and
    one of another shape must have bars around it.

    Args:
        frames: (T, H, W, 3) RGB.
        camera: camera of the conditioning image, at any size of the same shape, or of the video.
        image: (h, w, 3) RGB, conditioning image; None if unknown.
        source: origin of the camera, for messages.

    Raises:
        UnmeasurableError: the shapes differ, and neither first frame nor bars determine the framing; or too little of
            the image is left.
    """
    video = (frames.shape[2], frames.shape[1])
    camera_size = (camera.width, camera.height)
    filled = Framing.filling(camera_size, video)
    framing: Framing | None = None
    named = "" if source is None else f"{source.value} "
    if image is not None:
        size = image.shape[1], image.shape[0]
        if (camera_size != video or camera_size == size) and not Framing.filling(size, camera_size).changes:
            framing = align(image, frames[0])
    if framing is None and not filled.changes:
        return filled
    framing = framing or find_bars(frames, camera_size)
    if framing is None:
        problem = (
            "no bars of one colour were found around an image of the camera's shape"
            if image is None
            else "neither the first frame's image nor bars were found in it"
        )
        raise UnmeasurableError(
            f"{named}camera is {camera.width} x {camera.height}, the video {video[0]} x {video[1]}: the aspect ratios "
            f"differ, and {problem}; give the video's own camera.json, or the model's first frame: save it as ID.png "
            "beside ID.mp4, by which resizing and cropping are undone"
        )
    rows, columns = framing.window
    sides = columns.stop - columns.start, rows.stop - rows.start
    if min(sides) < MIN_SIDE_PX:
        raise UnmeasurableError(
            f"{named}shows {sides[0]} x {sides[1]} px between its bars, each side needs {MIN_SIDE_PX} px"
        )
    return framing
