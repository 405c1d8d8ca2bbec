"""Textures of fruit skins: rows from the lower end to the upper one, columns once around."""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array
from kinebench_drake.suites.scene.texture import Texture, gradient, grains, mix, shade, tileable_noise

SIZE = 192
"""Number of rows and of columns of a skin."""
_HEIGHT = ((np.arange(SIZE) + 0.5) / SIZE)[:, None]
"""(SIZE, 1) height of each row, 0 at the lower end, 1 at the upper."""
_AROUND = (2.0 * np.pi * (np.arange(SIZE) + 0.5) / SIZE)[None, :]
"""(1, SIZE) angle of each column about the axis [rad]."""


def _ramp(x: Array, low: float, high: float) -> Array:
    """Return the smooth step from 0 below `low` to 1 above `high`."""
    s = np.clip((x - low) / (high - low), 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))


def _jitter(rng: np.random.Generator, color: ArrayLike, spread: float = 0.1) -> Array:
    """Return a colour (3,) with random factors per channel."""
    return np.asarray(color, dtype=np.float64) * rng.uniform(1.0 - spread, 1.0 + 0.5 * spread, 3)


def _dots(rng: np.random.Generator, count: int, radius_px: float, *, low: float = 0.05, high: float = 0.95) -> Array:
    """Return weights (SIZE, SIZE) of round dots at random places between two heights."""
    weight = np.zeros((SIZE, SIZE))
    far = int(np.ceil(1.4 * radius_px)) + 1
    near = np.arange(-far, far + 1)
    for v, u, r in zip(
        rng.uniform(low, high, count),
        rng.uniform(0.0, 1.0, count),
        radius_px * rng.uniform(0.6, 1.4, count),
        strict=True,
    ):
        row = round(v * SIZE)
        column = round(u * SIZE)
        off = np.hypot((row + near - v * SIZE)[:, None], (column + near - u * SIZE)[None, :])
        patch = np.ix_((row + near) % SIZE, (column + near) % SIZE)
        weight[patch] = np.maximum(weight[patch], np.clip(r + 0.5 - off, 0.0, 1.0))
    return weight


def apple(rng: np.random.Generator, index: int) -> Texture:
    """Return an apple skin: red, yellow with a red cheek, or green in turn; streaked, paler at both ends, dotted."""
    ground = _jitter(rng, [(206, 190, 84), (222, 190, 78), (138, 176, 52), (214, 172, 76)][index % 4])
    blush = _jitter(rng, [(166, 22, 24), (196, 44, 30), (176, 198, 76), (140, 12, 26)][index % 4])
    streaks = tileable_noise(rng, SIZE, slope=1.0, stretch=12.0).T
    v = _HEIGHT
    cheek = 0.5 + 0.5 * np.cos(_AROUND - rng.uniform(0.0, 2.0 * np.pi))
    cover = (0.95, 0.35, 0.45, 1.0)[index % 4] + 0.55 * (cheek - 0.5) + 1.4 * (streaks - 0.5)
    cover = _ramp(cover, 0.1, 0.85) * _ramp(v, 0.03, 0.2) * (1.0 - 0.8 * _ramp(v, 0.78, 0.93))
    skin = mix(gradient((ground, blush), cover), (96, 110, 40), 0.6 * _ramp(v, 0.9, 0.99) + np.zeros_like(cover))
    return mix(skin, (236, 214, 160), 0.55 * _dots(rng, 130, 0.9))


def peach(rng: np.random.Generator, index: int) -> Texture:
    """Return a peach skin: yellow with a soft red cheek, downy."""
    ground = _jitter(rng, (240, 178, 96) if index % 3 else (244, 208, 150))
    blush = _jitter(rng, (206, 70, 58) if index % 2 else (188, 48, 62))
    cheek = np.cos(_AROUND - rng.uniform(0.0, 2.0 * np.pi)) + 1.5 * (tileable_noise(rng, SIZE, slope=1.6) - 0.5)
    skin = gradient((ground, blush), 0.95 * _ramp(cheek + 0.5 * (_HEIGHT - 0.5), -0.7, 0.9))
    return shade(skin, 1.0 + 0.12 * (grains(rng, SIZE, 60.0) - 0.5))


def orange(rng: np.random.Generator, index: int) -> Texture:
    """Return an orange skin with pores and a green star at the upper end."""
    skin = shade(
        np.broadcast_to(_jitter(rng, (240, 122 + 7 * (index % 4), 18), 0.05), (SIZE, SIZE, 3)),
        1.0 + 0.14 * (tileable_noise(rng, SIZE) - 0.5),
    )
    bumps = grains(rng, SIZE, 30.0)
    skin = shade(skin, 1.0 + 0.4 * (np.roll(bumps, 1, (0, 1)) - bumps) - 0.5 * np.clip(bumps - 0.62, 0.0, 0.3))
    return mix(skin, _jitter(rng, (116, 122, 46)), _ramp(_HEIGHT + 0.012 * np.cos(5.0 * _AROUND), 0.945, 0.965))


def pear(rng: np.random.Generator, index: int) -> Texture:
    """Return a pear skin: green, yellow or with a red cheek in turn; dotted, brown around the stalk."""
    ground = _jitter(rng, [(176, 186, 70), (216, 198, 88), (196, 188, 80)][index % 3])
    blush = _jitter(rng, [(136, 164, 58), (196, 168, 62), (184, 84, 50)][index % 3])
    cheek = np.cos(_AROUND - rng.uniform(0.0, 2.0 * np.pi)) + 1.6 * (tileable_noise(rng, SIZE) - 0.5)
    skin = gradient((ground, blush), 0.8 * _ramp(cheek, -0.3, 0.9))
    russet = _ramp(_HEIGHT + 0.25 * (tileable_noise(rng, SIZE, slope=1.2) - 0.5), 0.84, 1.0)
    skin = mix(skin, (142, 104, 52), 0.75 * np.maximum(russet, _ramp(1.0 - _HEIGHT, 0.95, 0.99)))
    return mix(skin, (126, 94, 44), 0.6 * _dots(rng, 200, 0.8))


def banana(rng: np.random.Generator, index: int) -> Texture:
    """Return a banana skin: yellow between dark ends, slightly green or freckled in turn, darker along its ridges."""
    ground = _jitter(rng, (234, 198, 54), 0.06)
    v = _HEIGHT + 0.03 * (tileable_noise(rng, SIZE) - 0.5)
    skin = shade(np.broadcast_to(ground, (SIZE, SIZE, 3)), 1.0 + 0.1 * (tileable_noise(rng, SIZE) - 0.5))
    green = np.maximum(_ramp(v, 0.66, 0.92), 0.7 * _ramp(1.0 - v, 0.8, 0.95))
    skin = mix(skin, (150, 170, 58), (0.75, 0.25, 0.1)[index % 3] * green)
    ridge = np.clip(np.cos(5.0 * _AROUND), 0.0, 1.0) ** 24 + np.zeros_like(v)
    skin = mix(skin, (170, 130, 40), 0.45 * ridge)
    skin = mix(skin, (112, 74, 30), 0.75 * _dots(rng, (12, 40, 110)[index % 3], 1.4, low=0.12, high=0.88))
    return mix(skin, (64, 44, 26), np.maximum(_ramp(1.0 - v, 0.93, 0.965), _ramp(v, 0.95, 0.985)))


def strawberry(rng: np.random.Generator, index: int) -> Texture:
    """Return a strawberry skin: red with rows of pale seeds in dents, paler under the leaves."""
    v = _HEIGHT
    u = _AROUND
    top = _jitter(rng, (214, 60, 40) if index % 3 else (228, 120, 84))
    skin = gradient((_jitter(rng, (176, 12, 24)), _jitter(rng, (196, 20, 28)), top), v + np.zeros_like(u))
    dent = np.zeros((SIZE, SIZE))
    seed = np.zeros((SIZE, SIZE))
    rows = 11
    for row in range(rows):
        middle = (row + 0.7) / (rows + 0.6)
        count = max(4, round(15 * np.sin(np.pi * (0.08 + 0.75 * middle))))
        wide = ((u / (2.0 * np.pi) * count + 0.5 * (row % 2)) % 1.0 - 0.5) / count * 2.0
        far = np.hypot(wide / 0.022, ((v - middle) * 0.95) / 0.03)
        dent = np.maximum(dent, 1.0 - _ramp(far, 0.6, 1.25))
        seed = np.maximum(seed, 1.0 - _ramp(far, 0.35, 0.6))
    return mix(shade(skin, 1.0 - 0.25 * dent), (228, 196, 92), seed)


SKINS = {skin.__name__: skin for skin in (apple, banana, orange, peach, pear, strawberry)}
"""Texture of each fruit from a random generator and the instance's number."""
