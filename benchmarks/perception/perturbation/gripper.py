"""Perturbations located at the gripper: deformation and occlusion."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.io.frames import Frames

Masks = NDArray[np.bool_]
"""(T, H, W)."""


def centroids(masks: Masks) -> Array:
    """Return the centroid (T, 2) of each mask as x, y [px], pixel centres at integers.

    An empty mask gets the centroid of the nearest frame, or the image centre if all are empty.
    """
    n, height, width = masks.shape
    points = np.full((n, 2), np.nan)
    for i, mask in enumerate(masks):
        v, u = np.nonzero(mask)
        if len(u):
            points[i] = u.mean(), v.mean()
    nonempty = np.flatnonzero(np.isfinite(points[:, 0]))
    if not len(nonempty):
        return np.tile([(width - 1) / 2, (height - 1) / 2], (n, 1))
    nearest = nonempty[np.abs(np.arange(n)[:, None] - nonempty).argmin(axis=1)]
    return np.asarray(points[nearest])


def smooth_noise(rng: np.random.Generator, frames: int, period: int, shape: tuple[int, ...]) -> Array:
    """Return random values (frames, *shape) of unit variance, interpolated smoothly between draws `period` apart."""
    keys = rng.normal(0.0, 1.0, (-(-frames // period) + 1, *shape))
    number, s = np.divmod(np.arange(frames) / period, 1.0)
    a = keys[number.astype(int)]
    b = keys[number.astype(int) + 1]
    angle = (s * np.pi / 2).reshape(-1, *[1] * len(shape))
    return np.asarray(np.cos(angle) * a + np.sin(angle) * b)


def to_bytes(values: NDArray[np.floating]) -> Frames:
    """Return values rounded and clipped to 0..255."""
    return np.asarray(np.clip(np.rint(values), 0, 255).astype(np.uint8))


_NODES = 5
"""Nodes of the deformation field across the gripper."""
_PERIOD = 8
"""Frames between two random deformation fields."""
_MIN_PX = 20


def deform(frames: Frames, masks: Masks, rng: np.random.Generator, rms_px: float) -> tuple[Frames, Masks]:
    """Warp the gripper so that its pixels move by `rms_px`, root mean square over its mask in every frame.

    The similarity transform that fits the field best is subtracted, so that the true pose remains the best fit. The
    warp fades out off the gripper.
    """
    nodes = smooth_noise(rng, len(frames), _PERIOD, (_NODES, _NODES, 2))
    middle = centroids(masks)
    out = np.array(frames)
    for i, mask in enumerate(masks):
        if mask.sum() >= _MIN_PX:
            shift = displacement(mask, nodes[i], middle[i], rms_px)
            v, u = np.mgrid[0 : mask.shape[0], 0 : mask.shape[1]].astype(np.float32)
            x = u + shift[..., 0].astype(np.float32)
            y = v + shift[..., 1].astype(np.float32)
            out[i] = cv2.remap(frames[i], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return out, masks


def displacement(mask: NDArray[np.bool_], nodes: Array, middle: Array, rms_px: float) -> Array:
    """Return the offset (H, W, 2) [px] at which each pixel samples the image.

    Args:
        mask: (H, W) the gripper.
        nodes: (n, n, 2) the field on a grid over the gripper, of any magnitude.
        middle: (2,) centroid of the mask [px].
        rms_px: root mean square of the offsets over the mask [px].
    """
    v, u = np.nonzero(mask)
    reach = 1.1 * max(float(np.abs(u - middle[0]).max()), float(np.abs(v - middle[1]).max()), 4.0)
    height, width = mask.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    n = len(nodes)
    at = [((a - m) / reach + 1.0) * (n - 1) / 2 for a, m in ((x, middle[0]), (y, middle[1]))]
    smooth = cv2.resize(nodes.astype(np.float32), (16 * n, 16 * n), interpolation=cv2.INTER_CUBIC)
    maps = [((a + 0.5) * 16 - 0.5).astype(np.float32) for a in at]
    field = np.asarray(
        cv2.remap(smooth, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float64
    )
    here = np.stack([x - middle[0], y - middle[1]], axis=-1).astype(np.float64)
    field -= _similarity(here[mask], field[mask], here)
    field *= rms_px / max(float(np.sqrt((field[mask] ** 2).sum(axis=1).mean())), 1e-9)
    return field * _window(mask, reach)[..., None]


def _similarity(where: Array, moved: Array, everywhere: Array) -> Array:
    """Fit a similarity to offsets `moved` (n, 2) at points `where` (n, 2); return its offsets at all points."""
    (x, y) = where.T
    one = np.ones(len(where))
    none = np.zeros(len(where))
    A = np.concatenate([np.stack([one, none, x, -y], axis=1), np.stack([none, one, y, x], axis=1)])
    a, b, size, turn = np.linalg.lstsq(A, moved.T.reshape(-1), rcond=None)[0]
    x = everywhere[..., 0]
    y = everywhere[..., 1]
    return np.stack([a + size * x - turn * y, b + size * y + turn * x], axis=-1)


def _window(mask: NDArray[np.bool_], reach: float) -> Array:
    """Return a weight (H, W): 1 on the gripper, falling smoothly to 0 within a third of its reach."""
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(away / (reach / 3), 0.0, 1.0)), dtype=np.float64)


_SHAPES = 2
_LOBES = (2, 3, 5)
"""Numbers of bumps around the outline of a shape."""
_BUMP = 0.16
"""Height of the bumps / the radius of the shape."""
_TEXTURE_PERIOD = 16
"""Frames between two random places of a shape."""
_DRIFT = 0.45
"""Distance of a shape from the gripper's centroid / the gripper's radius."""
_TEXTURE_PX = 128
_MIN_OCCLUDER_PX = 20


def occlude(frames: Frames, masks: Masks, rng: np.random.Generator, share: float) -> tuple[Frames, Masks]:
    """Hide `share` (0..1) of the gripper's visible pixels in every frame behind two textured shapes.

    The shapes follow the gripper and drift smoothly; their common size is chosen to hide the requested share.
    """
    middle = centroids(masks)
    drift = smooth_noise(rng, len(frames), _TEXTURE_PERIOD, (_SHAPES, 2))
    outlines = rng.uniform(0, 2 * np.pi, (_SHAPES, len(_LOBES)))
    turns = rng.uniform(-0.04, 0.04, _SHAPES)  # [rad / frame]
    textures = [texture(rng) for _ in range(_SHAPES)]
    out = np.array(frames, np.float32)
    left = masks.copy()
    height, width = masks.shape[1:]
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    for i, mask in enumerate(masks):
        if share <= 0.0 or mask.sum() < _MIN_OCCLUDER_PX:
            continue
        spread = np.sqrt(mask.sum() / np.pi)
        places = middle[i] + _DRIFT * spread * drift[i]
        gauges = np.stack([_gauge(x - p[0], y - p[1], outlines[k], turns[k] * i) for k, p in enumerate(places)])
        nearest = gauges.argmin(axis=0)
        gauge = gauges.min(axis=0)
        size = float(np.quantile(gauge[mask], share))
        opacity = np.clip(size - gauge + 0.5, 0.0, 1.0)[..., None].astype(np.float32)
        paint = np.zeros((height, width, 3), np.float32)
        for k, p in enumerate(places):
            u, v = (np.rint(a).astype(int) % _TEXTURE_PX for a in (x - p[0], y - p[1]))
            paint = np.where((nearest == k)[..., None], textures[k][v, u], paint)
        out[i] += opacity * (paint - out[i])
        left[i] &= gauge > size
    return to_bytes(out), left


def _gauge(x: Array, y: Array, phases: Array, turn: float) -> Array:
    """Return the distance from a shape's centre / the radius of its outline; a shape of size s covers values <= s."""
    angle = np.arctan2(y, x) + turn
    radius = 1.0 + _BUMP * sum(np.cos(k * angle + phase) for k, phase in zip(_LOBES, phases, strict=True))
    return np.asarray(np.hypot(x, y) / radius)


def texture(rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a seamless texture (128, 128, 3) in 0..255: two colours mixed by noise of several scales."""
    spectrum = np.zeros((_TEXTURE_PX, _TEXTURE_PX))
    for grain in (2.0, 5.0, 14.0):
        noise = cv2.GaussianBlur(
            np.tile(rng.normal(0, 1, (_TEXTURE_PX, _TEXTURE_PX)), (3, 3)).astype(np.float32), (0, 0), grain
        )[_TEXTURE_PX : 2 * _TEXTURE_PX, _TEXTURE_PX : 2 * _TEXTURE_PX]
        spectrum += noise / float(noise.std())
    mix = (0.5 + 0.35 * np.tanh(spectrum))[..., None]
    one, other = rng.uniform(20, 235, (2, 3))
    return np.asarray(mix * one + (1 - mix) * other, dtype=np.float32)
