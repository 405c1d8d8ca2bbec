"""Where a picture is in a frame: a map along the axes that makes them agree, found from coarse to fine.

Gauss-Newton on the difference of the frame and the warped picture, with gain and offset of the brightness and Tukey's
weights (what a video shows beside the picture must not count), as in Baker and Matthews, "Lucas-Kanade 20 years on"
(IJCV 2004), section 3, for the four numbers of such a map.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.framing import Framing, Witness
from kinebench_drake.grounding.placement import deeper_crops, placements

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
