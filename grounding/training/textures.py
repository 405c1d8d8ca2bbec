"""Procedural looks for tables, walls and objects: noise, wood, checks, stripes, cloth."""

import cv2
import numpy as np
from numpy.typing import NDArray

_SIZE = 256


def _noise(rng: np.random.Generator, octaves: int) -> NDArray[np.float32]:
    """Value noise (256, 256) in 0..1: random grids of doubling resolution and halving weight, summed."""
    total = np.zeros((_SIZE, _SIZE), np.float32)
    for octave in range(octaves):
        cells = 2 ** (octave + 2)
        grid = rng.random((cells, cells), dtype=np.float32)
        total += np.asarray(cv2.resize(grid, (_SIZE, _SIZE), interpolation=cv2.INTER_CUBIC)) * 0.5**octave
    total -= total.min()
    return total / max(float(total.max()), 1e-6)


def random_texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    """One random texture (256, 256, 4) uint8 RGBA; the same generator state gives the same bytes."""
    y, x = np.mgrid[0:_SIZE, 0:_SIZE].astype(np.float32) / _SIZE
    pattern = rng.integers(5)
    noise = _noise(rng, int(rng.integers(2, 7)))
    frequency = float(rng.uniform(2, 14))
    if pattern == 0:
        blend = noise
    elif pattern == 1:  # wood: rings of a distorted distance
        blend = 0.5 + 0.5 * np.sin(2 * np.pi * frequency * (x + 0.25 * noise))
    elif pattern == 2:
        blend = ((np.floor(x * frequency) + np.floor(y * frequency)) % 2).astype(np.float32)
    elif pattern == 3:
        blend = 0.5 + 0.5 * np.sign(np.sin(2 * np.pi * frequency * (x * np.cos(noise[0, 0] * 6) + y)))
    else:  # cloth: a fine weave over soft noise
        blend = 0.6 * noise + 0.4 * (0.5 + 0.25 * (np.sin(x * 400) + np.sin(y * 400)))
    blend = np.clip(blend * rng.uniform(0.4, 1.0) + 0.1 * _noise(rng, 5), 0, 1)[..., None]
    first, second = rng.uniform(0, 255, 3), rng.uniform(0, 255, 3)
    if rng.random() < 0.5:  # tables and walls are more often of related than of clashing colours
        second = np.clip(first + rng.normal(0, 40, 3), 0, 255)
    colour = first * blend + second * (1 - blend)
    return np.dstack([colour, np.full((_SIZE, _SIZE), 255.0)]).astype(np.uint8)
