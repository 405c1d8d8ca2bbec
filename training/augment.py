"""Image augmentation: artifacts of video models, codecs and cameras, and occluders."""

import cv2
import numpy as np
from numpy.typing import NDArray

from training.texture import random_photograph, random_texture

Image = NDArray[np.uint8]

_GAINS = (0.2, 1.5)
"""Range of the factor of the exposure: videos of dark rooms use a third of the range."""


def _colour(image: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    gain = np.exp(rng.uniform(*np.log(_GAINS))) * rng.uniform(0.85, 1.15, 3)
    offset = rng.uniform(-20, 20) + rng.uniform(-8, 8, 3)
    image = image * gain.astype(np.float32) + offset.astype(np.float32)
    if rng.random() < 0.3:
        image = 255.0 * np.clip(image / 255.0, 0, 1) ** np.float32(rng.uniform(0.6, 1.7))
    if rng.random() < 0.25:
        grey = image.mean(axis=2, keepdims=True)
        image = grey + (image - grey) * np.float32(rng.uniform(0.0, 1.6))
    return image


def _blur(image: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    kind = rng.integers(3)
    if kind == 0:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.3, 1.8))))
    if kind == 1:  # motion: a short line as kernel
        length = int(rng.integers(3, 10))
        angle = rng.uniform(0, np.pi)
        kernel = np.zeros((length, length), np.float32)
        centre = (length - 1) / 2
        reach = (length - 1) / 2
        step = np.array([np.cos(angle), np.sin(angle)]) * reach
        start = (centre - step).round().astype(int)
        end = (centre + step).round().astype(int)
        cv2.line(kernel, tuple(start.tolist()), tuple(end.tolist()), 1.0)
        return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()))
    height, width = image.shape[:2]
    factor = np.exp(rng.uniform(np.log(1.2), np.log(4.0)))
    small = cv2.resize(image, (int(width / factor), int(height / factor)), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR))


def _contrast(image: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Reduce the contrast, as haze or overexposure does."""
    mean = np.float32(image.mean() + rng.uniform(-30, 30))
    return np.asarray(mean + (image - mean) * np.float32(rng.uniform(0.2, 0.9)))


def _warp(image: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Warp smoothly and non-rigidly by about a pixel, less than the resolution of the labels."""
    height, width = image.shape[:2]
    cells = int(rng.integers(3, 8))
    field = rng.normal(0, rng.uniform(0.2, 0.8), (cells, cells, 2)).astype(np.float32)
    flow = np.asarray(cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC))
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    x = x + flow[..., 0]
    y = y + flow[..., 1]
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _ghost(image: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Blend the image with a displaced copy of itself, like two frames in one."""
    shift = np.array([[1, 0, rng.normal(0, 4)], [0, 1, rng.normal(0, 4)]], dtype=np.float32)
    copy = np.asarray(cv2.warpAffine(image, shift, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE))
    part = np.float32(rng.uniform(0.05, 0.4))
    return np.asarray(image * (1 - part) + copy * part, dtype=np.float32)


def _smear(image: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Replace fine detail by smooth patches with sharp edges, as a latent decoder does."""
    soft = cv2.bilateralFilter(image, 0, float(rng.uniform(10, 40)), float(rng.uniform(1.0, 2.5)))
    sharpened = soft + np.float32(rng.uniform(0.0, 0.8)) * (soft - cv2.GaussianBlur(soft, (0, 0), 1.5))
    return np.asarray(sharpened, dtype=np.float32)


_CHANGES = {_colour: 0.8, _contrast: 0.2, _warp: 0.2, _ghost: 0.15, _smear: 0.12, _blur: 0.45}
"""Augmentations in their order, and the share of images they apply to."""


def degrade(image: Image, rng: np.random.Generator) -> Image:
    """Return a degraded copy of an image (H, W, 3)."""
    x = image.astype(np.float32)
    for change, share in _CHANGES.items():
        if rng.random() < share:
            x = change(x, rng)
    if rng.random() < 0.4:
        x = x + rng.normal(0, rng.uniform(1, 16), x.shape).astype(np.float32)
    out = np.clip(x, 0, 255).astype(np.uint8)
    if rng.random() < 0.45:
        quality = int(rng.integers(8, 90))
        encoded = cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        out = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), dtype=np.uint8)
    return out


def replace_background(image: Image, robot: NDArray[np.generic], rng: np.random.Generator) -> Image:
    """Return an image (S, S, 3) whose robot, at opacity `robot` (S, S) in 0..1, stands before another background."""
    size = image.shape[0]
    if rng.random() < 0.7:
        background = random_photograph(rng, size)
    else:
        texture = np.ascontiguousarray(random_texture(rng)[..., :3])
        background = np.asarray(cv2.resize(texture, (size, size), interpolation=cv2.INTER_LINEAR), np.uint8)
    opacity = cv2.GaussianBlur(robot.astype(np.float32), (0, 0), float(rng.uniform(0.4, 1.0)))[..., None]
    return np.asarray(image * opacity + background * (1 - opacity), dtype=np.uint8)


def occlude(image: Image, part: NDArray[np.uint8], scenery: Image, rng: np.random.Generator) -> None:
    """Draw one to three random occluders on an image and label them background.

    Args:
        image: (H, W, 3), changed in place.
        part: (h, w) values of `RobotPart`, changed in place; most occluders lie near the robot.
        scenery: (H, W, 3) another image, whose pieces fill some of the occluders.
        rng: source of shapes, places and fillings.
    """
    sides = np.array(image.shape[1::-1])
    scale = image.shape[0] // part.shape[0]
    size = int(sides.max())
    v, u = np.nonzero(part)
    for _ in range(rng.integers(1, 4)):
        shape = np.zeros(image.shape[:2], np.uint8)
        place = rng.uniform(0, sides)
        if len(v) and rng.random() < 0.6:
            k = int(rng.integers(len(v)))
            place = scale * np.array([u[k], v[k]], dtype=np.float64) + rng.normal(0, 0.05 * size, 2)
        centre = tuple(int(c) for c in place)
        axes = tuple(int(a) for a in rng.uniform(0.04, 0.22, 2) * size)
        if rng.random() < 0.5:
            cv2.ellipse(shape, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
        else:
            corners = cv2.boxPoints((centre, (2 * axes[0], 2 * axes[1]), float(rng.uniform(0, 180))))
            cv2.fillPoly(shape, [corners.astype(np.int32)], 1)
        image[shape > 0] = _filling(size, scenery, rng)[: sides[1], : sides[0]][shape > 0]
        part[shape[scale // 2 :: scale, scale // 2 :: scale] > 0] = 0


def _filling(size: int, scenery: Image, rng: np.random.Generator) -> Image:
    """Return the texture (S, S, 3) of an occluder: a piece of an image, a noisy colour, or two colours in blots."""
    kind = rng.integers(3)
    if kind == 0:
        side = int(rng.uniform(0.15, 0.5) * min(scenery.shape[:2]))
        top, left = (int(rng.integers(n - side)) for n in scenery.shape[:2])
        piece = np.ascontiguousarray(scenery[top : top + side, left : left + side])
        return np.asarray(cv2.resize(piece, (size, size), interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    if kind == 1:
        noise = rng.normal(0, rng.uniform(0, 25), (size, size, 3))
        return np.asarray(np.clip(rng.uniform(0, 255, 3) + noise, 0, 255), dtype=np.uint8)
    cells = int(rng.integers(3, 24))
    blots = np.asarray(cv2.resize(rng.random((cells, cells)), (size, size), interpolation=cv2.INTER_CUBIC))
    mix = np.clip(0.5 + rng.uniform(0.5, 3.0) * (blots - 0.5), 0, 1)[..., None]
    one, other = rng.uniform(0, 255, (2, 3))
    return np.asarray(np.clip(mix * one + (1 - mix) * other, 0, 255), dtype=np.uint8)
