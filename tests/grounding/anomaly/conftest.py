"""Synthetic tracks: a smooth reach with the noise of estimated poses, one outlier in twenty frames."""

from collections.abc import Callable

import numpy as np
import pytest

from kinebench_drake.geometry import Array

N = 49


def _reach(seed: int = 0, noise_m: float = 0.004, wild: float = 0.05) -> Array:
    s = np.linspace(0, 1, N)
    p = np.stack([0.2 * np.sin(2 * np.pi * s), 0.1 * np.cos(3 * s), 0.7 - 0.1 * s], axis=1)
    rng = np.random.default_rng(seed)
    sigma = np.where(rng.random(N) < wild, 4 * noise_m, noise_m) / np.sqrt(3)
    return np.asarray(p + sigma[:, None] * rng.normal(size=p.shape))


@pytest.fixture
def reach() -> Callable[..., Array]:
    """A smooth way of 40 cm and back, at most 3 cm a frame: positions (49, 3) [m]."""
    return _reach


@pytest.fixture
def t_s() -> Array:
    return np.asarray(0.2 * np.arange(N))


@pytest.fixture
def visible() -> np.ndarray:
    return np.ones(N, dtype=bool)
