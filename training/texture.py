"""Random textures and photographs for the surfaces and backgrounds of training images."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

_SIZE = 256


def _noise(rng: np.random.Generator, octaves: int) -> NDArray[np.float32]:
    """Return value noise (256, 256) in 0..1: a sum of random grids with doubling resolution and halving weight."""
    total = np.zeros((_SIZE, _SIZE), np.float32)
    for octave in range(octaves):
        cells = 2 ** (octave + 2)
        grid = rng.random((cells, cells), dtype=np.float32)
        total += np.asarray(cv2.resize(grid, (_SIZE, _SIZE), interpolation=cv2.INTER_CUBIC)) * 0.5**octave
    total -= total.min()
    return total / max(float(total.max()), 1e-6)


def random_texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return a random texture (256, 256, 4) RGBA; the same generator state gives the same bytes."""
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
    first = rng.uniform(0, 255, 3)
    second = rng.uniform(0, 255, 3)
    if rng.random() < 0.5:  # similar colours are more frequent on real tables and walls
        second = np.clip(first + rng.normal(0, 40, 3), 0, 255)
    colour = first * blend + second * (1 - blend)
    return np.dstack([colour, np.full((_SIZE, _SIZE), 255.0)]).astype(np.uint8)


_PHOTOGRAPHS = ("astronaut", "chelsea", "coffee", "grass", "gravel", "motorcycle_left", "motorcycle_right", "rocket")
"""Names in `skimage.data`; all are public domain or CC0 according to that package."""


@cache
def photographs() -> tuple[NDArray[np.uint8], ...]:
    """Return the photographs (H, W, 3) that the installed scikit-image contains."""
    import skimage

    folder = Path(skimage.__file__).with_name("data")
    images = (cv2.imread(str(path)) for name in _PHOTOGRAPHS for path in sorted(folder.glob(f"{name}.*")))
    return tuple(np.ascontiguousarray(image[..., ::-1], dtype=np.uint8) for image in images if image is not None)


def random_photograph(rng: np.random.Generator, size: int) -> NDArray[np.uint8]:
    """Return a random piece (size, size, 3) of a photograph, scaled and mirrored at random."""
    images = photographs()
    image = images[int(rng.integers(len(images)))]
    side = int(rng.uniform(0.2, 1.0) * min(image.shape[:2]))
    top, left = (int(rng.integers(n - side + 1)) for n in image.shape[:2])
    piece = image[top : top + side, left : left + side]
    piece = piece[:, ::-1] if rng.random() < 0.5 else piece
    return np.asarray(cv2.resize(np.ascontiguousarray(piece), (size, size), interpolation=cv2.INTER_AREA), np.uint8)
