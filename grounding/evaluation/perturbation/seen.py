"""Frames after a perturbation, and the gripper in them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array

Frames = NDArray[np.uint8]
"""(T, H, W, 3) RGB."""
Masks = NDArray[np.bool_]
"""(T, H, W)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What a perturbation leaves."""

    frames: Frames
    masks: Masks
    """Pixels that still show the gripper."""


def centroids(masks: Masks) -> Array:
    """Middle (T, 2) of each mask as x, y [px]; that of the nearest frame where one is empty, of the picture if all are.

    Pixel centres lie at integers.
    """
    n, height, width = masks.shape
    points = np.full((n, 2), np.nan)
    for i, mask in enumerate(masks):
        v, u = np.nonzero(mask)
        if len(u):
            points[i] = u.mean(), v.mean()
    known = np.flatnonzero(np.isfinite(points[:, 0]))
    if not len(known):
        return np.tile([(width - 1) / 2, (height - 1) / 2], (n, 1))
    nearest = known[np.abs(np.arange(n)[:, None] - known).argmin(axis=1)]
    return np.asarray(points[nearest])


def turning(rng: np.random.Generator, frames: int, period: int, shape: tuple[int, ...]) -> Array:
    """Random values (frames, *shape) of unit variance that turn smoothly, new ones every `period` frames."""
    keys = rng.normal(0.0, 1.0, (-(-frames // period) + 1, *shape))
    number, s = np.divmod(np.arange(frames) / period, 1.0)
    a, b = keys[number.astype(int)], keys[number.astype(int) + 1]
    angle = (s * np.pi / 2).reshape(-1, *[1] * len(shape))
    return np.asarray(np.cos(angle) * a + np.sin(angle) * b)


def to_bytes(values: NDArray[np.floating]) -> Frames:
    """Rounded and clipped to 0..255."""
    return np.asarray(np.clip(np.rint(values), 0, 255).astype(np.uint8))
