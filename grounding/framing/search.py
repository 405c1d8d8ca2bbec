"""Search for the framing of a video: letter-box bars, and alignment of the conditioning image with the first frame."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.framing.framing import SQUARE, Framing, Witness, deeper_crops, letterboxes, placements
from kinebench_drake.io.video import MIN_SIDE_PX

MIN_CORRELATION = 0.75
"""A picture that agrees less with the frame than this is another one."""
SNAP_PX = 0.75
"""A map whose visible corners are this near to those of a usual one is taken to be it."""

_COARSE_PX, _FINE_PX = (48, 96), (192, 384)  # longer side of the frame at which it is looked at
_STEPS = 12
_STILL_PX = 0.01
_MIN_SPREAD = 1.0  # variance of a picture's levels; one of a single grey tells no place
_MIN_SHARE = 0.2  # of the frame's pixels that the picture must cover
_TUKEY = 4.685
_DETAIL_PX = 10.0  # what is larger tells no place

Grey = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """Picture and frame at one scale."""

    picture: Grey
    frame: Grey
    shrink: float
    """Pixels of this frame over those of the video."""


def align(picture: NDArray[np.uint8], frame: NDArray[np.uint8]) -> Framing | None:
    """Where a picture is in a frame.

    Args:
        picture: (h, w, 3) RGB, what the video's maker was given.
        frame: (H, W, 3) RGB, the video's first frame.

    Returns:
        The framing, exactly a usual one where it is near to it; None where the frame does not show the picture.
    """
    size, video = (picture.shape[1], picture.shape[0]), (frame.shape[1], frame.shape[0])
    usual = placements(size, video)
    greys = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in (picture, frame)]
    best = _refined(usual[0], greys, (*_COARSE_PX, *_FINE_PX))
    if (best.correlation or 0.0) < MIN_CORRELATION or _apart_px(usual[0], best) > SNAP_PX:  # not merely scaled
        found = [_refined(start, greys, _COARSE_PX) for start in (*usual, *deeper_crops(size, video))]
        found = sorted(found, key=lambda f: -(f.correlation or 0.0))[:3]
        best = max((_refined(start, greys, _FINE_PX) for start in found), key=lambda f: f.correlation or 0.0)
    if (best.correlation or 0.0) < MIN_CORRELATION:
        return None
    near = [u for u in usual if _apart_px(u, best) <= SNAP_PX]
    if near:
        best = replace(min(near, key=lambda u: _apart_px(u, best)), correlation=best.correlation)
    return replace(best, witness=Witness.FIRST_FRAME)


def _apart_px(a: Framing, b: Framing) -> float:
    """Farthest that a corner of the visible part of `b` moves if its map is replaced by that of `a` [px]."""
    size = np.array([b.width, b.height])
    seen = np.clip(b.corners, 0.0, size)
    points = (seen - b.map[:, 2]) / np.diag(b.map)  # of the picture
    return float(np.abs(points * np.diag(a.map) + a.map[:, 2] - seen).max())


def _refined(start: Framing, greys: list[Grey], sides: tuple[int, ...]) -> Framing:
    """A framing after Gauss-Newton at each scale, with its correlation at the last one."""
    framing = start
    for side in sides:
        level = _level(framing, greys, side)
        framing = _steps(framing, level)
    level = _level(framing, greys, sides[-1])
    return replace(framing, correlation=_correlation(framing, level))


def _level(framing: Framing, greys: list[Grey], side: int) -> _Level:
    """Both pictures shrunk so that the video's longer side has `side` pixels at most."""
    shrink = min(1.0, side / max(framing.width, framing.height))
    return _Level(
        picture=_shrunk(greys[0], min(1.0, shrink * framing.scale_x), min(1.0, shrink * framing.scale_y)),
        frame=_shrunk(greys[1], shrink, shrink),
        shrink=shrink,
    )


def _shrunk(image: Grey, x: float, y: float) -> Grey:
    size = (max(8, round(image.shape[1] * x)), max(8, round(image.shape[0] * y)))
    area = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(area, (0, 0), 0.8), np.float32)


def _inverse(framing: Framing, level: _Level) -> Array:
    """(2, 2) rows (factor, shift) from pixels of the level's frame to those of its picture, half-integer centres."""
    frame_px = np.array(level.frame.shape[::-1]) / [framing.width, framing.height]
    picture_px = np.array(level.picture.shape[::-1]) / [framing.picture_width, framing.picture_height]
    factor = picture_px / (np.diag(framing.map) * frame_px)
    return np.column_stack([factor, -framing.map[:, 2] * picture_px / np.diag(framing.map)])


def _warped(picture: Grey, inverse: Array, shape: tuple[int, ...]) -> tuple[Grey, NDArray[np.bool_]]:
    """A picture of the level's frame (H, W), and where it lies inside the picture."""
    (kx, ox), (ky, oy) = inverse
    M = np.array([[kx, 0.0, ox + 0.5 * kx - 0.5], [0.0, ky, oy + 0.5 * ky - 0.5]])  # OpenCV's centres are integers
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    image = cv2.warpAffine(picture, M, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    x = kx * (np.arange(shape[1]) + 0.5) + ox
    y = ky * (np.arange(shape[0]) + 0.5) + oy
    inside = np.outer((y > 1) & (y < picture.shape[0] - 1), (x > 1) & (x < picture.shape[1] - 1))
    return np.asarray(image, np.float32), inside


def _steps(framing: Framing, level: _Level) -> Framing:
    """The framing after Gauss-Newton at one scale; as it was where that leads nowhere."""
    inverse = _inverse(framing, level)
    u = [cv2.Sobel(level.picture, cv2.CV_32F, 1 - k, k, ksize=3, scale=0.125) for k in (0, 1)]
    height, width = level.frame.shape
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    for _ in range(_STEPS):
        image, inside = _warped(level.picture, inverse, level.frame.shape)
        if inside.mean() < _MIN_SHARE:
            break
        du, dv = (_warped(gradient, inverse, level.frame.shape)[0] for gradient in u)
        columns = np.stack([du * x, du, dv * y, dv, image, np.ones_like(image)], axis=-1)[inside]
        target = level.frame[inside]
        (spread, shared), _ = np.cov(columns[:, 4], target)
        if spread < _MIN_SPREAD:
            break
        gain = shared / spread
        residual = target - target.mean() - gain * (columns[:, 4] - columns[:, 4].mean())
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1.0
        weight = np.clip(1.0 - (residual / (_TUKEY * sigma)) ** 2, 0.0, None)
        A = columns * [gain, gain, gain, gain, 1.0, 1.0]
        step = np.linalg.lstsq((A * weight[:, None]).T @ A, (A * weight[:, None]).T @ residual, rcond=None)[0][:4]
        inverse = inverse + np.array([[step[0] / width, step[1]], [step[2] / height, step[3]]])
        if not (np.isfinite(inverse).all() and (inverse[:, 0] > 0.05).all()):
            return framing
        if np.abs(step).max() < _STILL_PX:
            break
    return _framed(inverse, framing, level)


def _framed(inverse: Array, framing: Framing, level: _Level) -> Framing:
    """The framing whose map `_inverse` turns round."""
    frame_px = np.array(level.frame.shape[::-1]) / [framing.width, framing.height]
    picture_px = np.array(level.picture.shape[::-1]) / [framing.picture_width, framing.picture_height]
    scale = picture_px / (inverse[:, 0] * frame_px)
    return framing.mapped(scale, -inverse[:, 1] * scale / picture_px)


def _correlation(framing: Framing, level: _Level) -> float:
    """How well details of frame and picture agree where both are, -1 to 1; 0 where they hardly meet."""
    image, inside = _warped(level.picture, _inverse(framing, level), level.frame.shape)
    if inside.mean() < _MIN_SHARE:
        return 0.0
    details = []
    for grey in (image, level.frame):
        blurred = cv2.GaussianBlur(np.where(inside, grey, grey[inside].mean()), (0, 0), _DETAIL_PX)
        details.append((grey - blurred)[inside])
    a, b = (d - d.mean() for d in details)
    norm = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / norm if norm > 0 else 0.0


_FRAMES = 8
_MARGIN_PX = 4  # what a codec smears over the edge
_EVEN = 6.0  # levels of 255 by which a bar may vary, over its area and in time
_STEP = 8.0  # levels by which the picture must differ from the bar beside it


def find_bars(frames: NDArray[np.uint8], picture: tuple[float, float]) -> Framing | None:
    """The framing in which a picture of (width, height) lies between bars of frames (T, H, W, 3); None without bars.

    Every strip beside the picture must be of one colour that stays, and must end where the picture begins.
    """
    chosen = frames[np.unique(np.linspace(0, len(frames) - 1, _FRAMES).astype(int))].astype(np.float32)
    size = frames.shape[2], frames.shape[1]
    for framing in letterboxes(picture, size):
        rows, columns = framing.window
        across = columns.stop - columns.start < framing.width
        strips = np.swapaxes(chosen, 1, 2) if across else chosen  # bars as the first and last rows
        begin, end = (columns.start, columns.stop) if across else (rows.start, rows.stop)
        sides = [(strips[:, :begin], strips[:, begin:]), (strips[:, end:][:, ::-1], strips[:, :end][:, ::-1])]
        if all(_is_bar(bar, inside) for bar, inside in sides if bar.shape[1] > 1):
            return replace(framing, witness=Witness.BARS)
    return None


def _is_bar(bar: NDArray[np.float32], inside: NDArray[np.float32]) -> bool:
    """Whether rows (T, n, W, 3) are a bar that ends where the rows `inside` begin."""
    area = bar[:, : max(1, bar.shape[1] - _MARGIN_PX)]
    colour = np.median(area, axis=(0, 1, 2))
    edge = inside[:, _MARGIN_PX : 2 * _MARGIN_PX]
    even = float(np.percentile(np.abs(area - colour), 99)) <= _EVEN
    return even and float(np.abs(edge - colour).max(axis=-1).mean()) >= _STEP


def find_framing(frames: NDArray[np.uint8], camera: Camera, picture: NDArray[np.uint8] | None) -> Framing:
    """Where a camera's picture is in the frames of a video.

    The first frame tells, where it shows the picture that the video was begun with; a camera of exactly the video's
    size, and not the picture's, is the video's own. Else a video of the camera's shape is the camera's picture scaled,
    and one of another shape has bars around it, or cannot be measured.

    Args:
        frames: (T, H, W, 3) RGB.
        camera: of the picture, at any size of the same shape, or of the video.
        picture: (h, w, 3) RGB, the first frame that the video's maker was given; None if unknown.

    Raises:
        UnmeasurableError: the shapes differ, and nothing tells what was cut off or added.
    """
    video, taken = (frames.shape[2], frames.shape[1]), (camera.width, camera.height)
    filled = Framing.filling(taken, video)
    same = abs(filled.scale_x / filled.scale_y - 1.0) <= SQUARE
    framing: Framing | None = None
    if picture is not None and _shows(camera, picture) and (taken != video or taken == picture.shape[1::-1]):
        framing = align(picture, frames[0])
    if framing is None and same:
        return filled
    framing = framing or find_bars(frames, taken)
    if framing is None:
        sought = (
            "no bars of one colour were found around a picture of the camera's shape"
            if picture is None
            else "neither the first frame's picture nor bars were found in it"
        )
        raise UnmeasurableError(
            f"camera is {camera.width} x {camera.height}, the video {video[0]} x {video[1]}: the aspect ratios differ, "
            f"and {sought}; give the video's own camera.json, or the picture it was begun with (first_frame)"
        )
    rows, columns = framing.window
    sides = columns.stop - columns.start, rows.stop - rows.start
    if min(sides) < MIN_SIDE_PX:
        raise UnmeasurableError(f"shows {sides[0]} x {sides[1]} px between its bars, each side needs {MIN_SIDE_PX} px")
    return framing


def _shows(camera: Camera, picture: NDArray[np.uint8]) -> bool:
    """Whether the camera is the picture's: its shape is."""
    height, width = picture.shape[:2]
    return bool(abs(camera.width * height / (camera.height * width) - 1.0) <= SQUARE)
