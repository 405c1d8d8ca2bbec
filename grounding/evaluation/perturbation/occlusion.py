"""Things before the gripper: textured shapes that drift over it and hide a given share of what is seen of it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.evaluation.perturbation.seen import Frames, Masks, Seen, centroids, to_bytes, turning

_SHAPES = 2
_LOBES = (2, 3, 5)  # bumps around a shape's outline
_BUMP = 0.16  # their height over the shape's radius
_PERIOD = 16  # frames in which a shape drifts to another place
_DRIFT = 0.45  # of the way from the gripper's middle to its outline
_TEXTURE_PX = 128
_MIN_PX = 20


def occlude(frames: Frames, masks: Masks, rng: np.random.Generator, share: float) -> Seen:
    """Hide `share` (0..1) of the gripper's visible pixels in every frame behind two shapes.

    Their places drift smoothly with the gripper; their common size is what hides the wanted share.
    """
    middle = centroids(masks)
    drift = turning(rng, len(frames), _PERIOD, (_SHAPES, 2))
    outlines = rng.uniform(0, 2 * np.pi, (_SHAPES, len(_LOBES)))
    turns = rng.uniform(-0.04, 0.04, _SHAPES)  # [rad] a frame
    textures = [texture(rng) for _ in range(_SHAPES)]
    out, left = frames.astype(np.float32), masks.copy()
    height, width = masks.shape[1:]
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    for i, mask in enumerate(masks):
        if share <= 0.0 or mask.sum() < _MIN_PX:
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
    return Seen(frames=to_bytes(out), masks=left)


def _gauge(x: Array, y: Array, phases: Array, turn: float) -> Array:
    """Distance from a shape's middle over the radius of its outline there: the shape of size s is where it is <= s."""
    angle = np.arctan2(y, x) + turn
    radius = 1.0 + _BUMP * sum(np.cos(k * angle + phase) for k, phase in zip(_LOBES, phases, strict=True))
    return np.asarray(np.hypot(x, y) / radius)


def texture(rng: np.random.Generator) -> NDArray[np.float32]:
    """A picture (128, 128, 3) in 0..255 that repeats without a seam: two colours mixed by noise of mixed grain."""
    spectrum = np.zeros((_TEXTURE_PX, _TEXTURE_PX))
    for grain in (2.0, 5.0, 14.0):
        noise = cv2.GaussianBlur(
            np.tile(rng.normal(0, 1, (_TEXTURE_PX, _TEXTURE_PX)), (3, 3)).astype(np.float32), (0, 0), grain
        )[_TEXTURE_PX : 2 * _TEXTURE_PX, _TEXTURE_PX : 2 * _TEXTURE_PX]
        spectrum += noise / float(noise.std())
    mix = (0.5 + 0.35 * np.tanh(spectrum))[..., None]
    one, other = rng.uniform(20, 235, (2, 3))
    return np.asarray(mix * one + (1 - mix) * other, dtype=np.float32)
