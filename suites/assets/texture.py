"""Procedural images to lay on surfaces. They repeat without a seam."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array


def tileable_noise(rng: np.random.Generator, size: int, *, slope: float = 1.5, stretch: float = 1.0) -> Array:
    """Noise (size, size) in 0..1 whose amplitude falls with frequency to the power `slope`; `stretch` > 1: along rows.

    Filtered white noise (the Fourier transform makes it periodic).
    """
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.rfftfreq(size), indexing="ij")
    f = np.hypot(fy, fx * stretch)
    f[0, 0] = np.inf
    image = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) / f**slope, s=(size, size))
    image = (image - image.mean()) / (image.std() + 1e-12)
    return np.asarray(np.clip(0.5 + image / 5.0, 0.0, 1.0))


def blend(first: ArrayLike, second: ArrayLike, weight: Array) -> NDArray[np.uint8]:
    """The image (H, W, 3) that goes from one sRGB colour (3,) 0..255 to another where `weight` (H, W) goes 0 to 1."""
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    return np.asarray(np.clip(np.round(a + weight[..., None] * (b - a)), 0, 255), dtype=np.uint8)
