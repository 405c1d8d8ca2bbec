"""Procedural textures: tileable (size, size, 3) uint8 sRGB images from a random generator.

Colours are sRGB triples 0..255. Wood grain runs along rows, which `box_mesh` maps to a top's x; `image.swapaxes(0, 1)`
rotates it. Docstrings give the physical size of one repetition: set `uv_per_m` accordingly.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array

# rows and columns of textures
_SMALL = 256
_LARGE = 512
Texture = NDArray[np.uint8]
"""(H, W, 3) sRGB."""
WOODS: dict[str, tuple[tuple[int, int, int], tuple[int, int, int]]] = {
    "oak": ((206, 172, 126), (152, 112, 70)),
    "pine": ((226, 192, 142), (188, 138, 84)),
    "walnut": ((128, 90, 63), (78, 51, 35)),
    "beech": ((214, 172, 132), (182, 134, 96)),
    "maple": ((224, 194, 156), (198, 160, 118)),
    "cherry": ((184, 118, 78), (138, 78, 48)),
    "teak": ((172, 122, 74), (120, 78, 42)),
    "ash": ((212, 188, 154), (166, 136, 102)),
    "mahogany": ((146, 78, 54), (94, 44, 30)),
    "weathered": ((168, 158, 146), (116, 106, 96)),
}
"""Light and dark colour of each kind of wood."""
STONES: dict[str, tuple[tuple[int, int, int], ...]] = {
    "grey": ((84, 84, 88), (140, 139, 138), (176, 174, 170)),
    "rose": ((98, 78, 74), (176, 130, 116), (204, 172, 156)),
    "beige": ((128, 108, 88), (188, 166, 138), (212, 196, 172)),
}
"""Colours of the grains of each kind of granite, dark to light."""


def tileable_noise(rng: np.random.Generator, size: int, *, slope: float = 1.5, stretch: float = 1.0) -> Array:
    """Return noise (size, size) in 0..1 with amplitude ~ frequency^-slope; `stretch` > 1 elongates it along rows.

    White noise filtered in the Fourier domain, hence periodic.
    """
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.rfftfreq(size), indexing="ij")
    f = np.hypot(fy, fx * stretch)
    f[0, 0] = np.inf
    return _filter_noise(rng, size, f**-slope)


def grains(rng: np.random.Generator, size: int, cycles: float) -> Array:
    """Return band-pass noise (size, size) in 0..1: blobs of similar size, `cycles` of them across the image."""
    fy, fx = np.meshgrid(np.fft.fftfreq(size), np.fft.rfftfreq(size), indexing="ij")
    f = size * np.hypot(fy, fx)
    f[0, 0] = 1e-9
    return _filter_noise(rng, size, np.exp(-((np.log(f / cycles) / 0.45) ** 2)))


def _filter_noise(rng: np.random.Generator, size: int, gain: Array) -> Array:
    """Return white noise multiplied by a gain in the Fourier domain, scaled to 0..1 (mean 0.5, sigma 0.2)."""
    image = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) * gain, s=(size, size))
    image = (image - image.mean()) / (image.std() + 1e-12)
    return np.asarray(np.clip(0.5 + image / 5.0, 0.0, 1.0))


def gradient(colors: Sequence[ArrayLike], weight: Array) -> Texture:
    """Return the image (H, W, 3) that interpolates evenly spaced sRGB colours at the weights (H, W) 0..1."""
    table = np.asarray(colors, dtype=np.float64)
    place = np.clip(weight, 0.0, 1.0) * (len(table) - 1)
    return _image(np.stack([np.interp(place, np.arange(len(table)), channel) for channel in table.T], axis=-1))


def shade(image: ArrayLike, factor: Array) -> Texture:
    """Multiply an image (H, W, 3) by factors (H, W)."""
    return _image(np.asarray(image, dtype=np.float64) * factor[..., None])


def mix(first: ArrayLike, second: ArrayLike, weight: Array) -> Texture:
    """Blend a second image or colour over the first (H, W, 3) with the weights (H, W) 0..1."""
    a = np.asarray(first, dtype=np.float64)
    return _image(a + np.clip(weight, 0.0, 1.0)[..., None] * (np.asarray(second, dtype=np.float64) - a))


def fill(color: ArrayLike, size: int) -> Texture:
    """Return an image (size, size, 3) of one colour."""
    return np.array(np.broadcast_to(_image(np.asarray(color, dtype=np.float64)), (size, size, 3)))


def srgb(linear: Array) -> Array:
    """Convert linear RGB 0..1 to sRGB 0..255 with a gamma of 2.2."""
    return np.asarray(255.0 * linear ** (1.0 / 2.2))


def linear_rgb(color: ArrayLike) -> tuple[float, float, float]:
    """Convert sRGB (3,) 0..255 to linear RGB with a gamma of 2.2."""
    return rgb((np.asarray(color, dtype=np.float64) / 255.0) ** 2.2)


def rgb(color: Iterable[float]) -> tuple[float, float, float]:
    """Return three numbers as a colour of `SurfaceFinish`."""
    r, g, b = color
    return float(r), float(g), float(b)


def _image(values: Array) -> Texture:
    return np.asarray(np.clip(np.round(values), 0, 255), dtype=np.uint8)


def _relief(height: Array, strength: float) -> Array:
    """Return shading factors (H, W) of a height field (H, W) lit from a corner."""
    return 1.0 + strength * (np.roll(height, 1, (0, 1)) - np.roll(height, -1, (0, 1)))


def _cells(size: int, rows: int, columns: int, shifts: ArrayLike = 0.0) -> tuple[NDArray[np.intp], Array]:
    """Return each pixel's cell number (size, size) and its distance from the cell's edge [px].

    Rows of cells are shifted by the fractions `shifts` (rows,) of a cell's width.
    """
    at = (np.arange(size) + 0.5) / size
    row = np.minimum((at * rows).astype(np.intp), rows - 1)
    v = at * rows - row
    u = at[None, :] * columns + np.broadcast_to(np.asarray(shifts, dtype=np.float64), (rows,))[row][:, None]
    column = np.floor(u).astype(np.intp)
    edge_u = (0.5 - np.abs(u - column - 0.5)) * size / columns
    edge_v = (0.5 - np.abs(v - 0.5)) * size / rows
    return row[:, None] * columns + column % columns, np.minimum(edge_u, edge_v[:, None])


def _patches(rng: np.random.Generator, size: int, count: int) -> Array:
    """Return values (size, size) in 0..1, constant on each of `count` by `count` patches with wavy edges."""
    at = (np.arange(size) + 0.5) / size * count
    u, v = (4.0 * grains(rng, size, 0.8 * count) for _ in range(2))
    rows, columns = (np.floor(x).astype(np.intp) % count for x in (at[:, None] + v, at[None, :] + u))
    return np.asarray(rng.uniform(size=(count, count))[rows, columns])


def wood(rng: np.random.Generator, kind: str = "oak", *, size: int = 256) -> Texture:
    """Return plain wood of one of `WOODS`, grain along rows; about 0.3 m."""
    warp = tileable_noise(rng, size, slope=2.0, stretch=5.0) - 0.5
    phase = int(rng.integers(5, 11)) * np.arange(size)[:, None] / size + rng.uniform(2.0, 5.0) * warp
    ring = phase - np.floor(phase)
    late = ring**2 * np.clip((1.0 - ring) / 0.12, 0.0, 1.0)
    fibre = tileable_noise(rng, size, slope=0.7, stretch=28.0) - 0.5
    image = gradient(WOODS[kind], 0.32 + 0.5 * late + 1.1 * fibre + 0.25 * warp)
    return shade(image, 1.0 - 0.9 * np.clip(-fibre - 0.28, 0.0, 0.2))


def planks(rng: np.random.Generator, kind: str = "oak", *, boards: int = 4) -> Texture:
    """Return wooden boards with seams, grain along rows; about 0.15 m per board."""
    grain = wood(rng, kind, size=_LARGE)
    cell, edge = _cells(_LARGE, boards, 1, rng.uniform(0.0, 1.0, boards))
    image = np.empty_like(grain)
    for board in range(boards):
        rows = slice(board * _LARGE // boards, (board + 1) * _LARGE // boards)
        image[rows] = np.roll(grain, rng.integers(0, _LARGE, 2), (0, 1))[rows]
    return shade(image, rng.normal(1.0, 0.06, boards)[cell] * (1.0 - 0.45 * np.clip(1.6 - edge, 0.0, 1.0)))


def parquet(rng: np.random.Generator, kind: str = "oak") -> Texture:
    """Return wooden squares with alternating grain direction; about 0.15 m per square."""
    grain = wood(rng, kind, size=_LARGE)
    cells = 4
    cell, edge = _cells(_LARGE, cells, cells)
    across = (cell // cells + cell % cells) % 2 == 1
    _, slat = _cells(_LARGE, 4 * cells, cells)
    slat = np.where(across, slat.T, slat)
    image = np.where(across[..., None], grain.swapaxes(0, 1), grain)
    seams = 0.4 * np.clip(1.5 - edge, 0.0, 1.0) + 0.15 * np.clip(1.2 - slat, 0.0, 1.0)
    return shade(image, rng.normal(1.0, 0.05, cells * cells)[cell] * (1.0 - seams))


def marble(rng: np.random.Generator, ground: ArrayLike, vein: ArrayLike) -> Texture:
    """Return marble with veins in one colour on another; about 0.7 m."""
    field = tileable_noise(rng, _LARGE, slope=1.7)
    fine = tileable_noise(rng, _LARGE, slope=1.5)
    veins = np.exp(-np.abs(field - 0.5) / 0.012) + 0.5 * np.exp(-np.abs(fine - 0.42) / 0.008)
    clouds = 0.5 * np.clip(field - 0.35, 0.0, 1.0)
    return gradient((ground, vein), np.clip(0.75 * veins * (0.25 + 1.4 * fine * field) + clouds, 0.0, 0.9))


def granite(rng: np.random.Generator, kind: str = "grey") -> Texture:
    """Return granite of one of `STONES`; about 0.25 m."""
    crystals = _patches(rng, _SMALL, _SMALL // 6)
    fine = _patches(rng, _SMALL, _SMALL // 3)
    return gradient(STONES[kind], 0.72 * np.digitize(crystals, [0.22, 0.75]) / 2.0 + 0.28 * fine)


def concrete(rng: np.random.Generator, color: ArrayLike = (158, 156, 152)) -> Texture:
    """Return cast concrete or stucco: cloudy, with fine grain and a few pores; about 1 m."""
    clouds = tileable_noise(rng, _LARGE, slope=1.4) - 0.5
    fine = grains(rng, _LARGE, _LARGE / 4.0) - 0.5
    pores = np.clip(grains(rng, _LARGE, _LARGE / 14.0) - 0.93, 0.0, 0.07)
    return shade(fill(color, _LARGE), 1.0 + 0.35 * clouds + 0.14 * fine - 5.0 * pores)


def plaster(rng: np.random.Generator, color: ArrayLike = (222, 216, 204)) -> Texture:
    """Return a wall painted with a roller; about 0.5 m."""
    height = grains(rng, _SMALL, _SMALL / 8.0) + 0.5 * grains(rng, _SMALL, _SMALL / 20.0)
    return shade(fill(color, _SMALL), _relief(height, 0.07) + 0.06 * (tileable_noise(rng, _SMALL) - 0.5))


def speckle(
    rng: np.random.Generator, ground: ArrayLike, specks: Sequence[ArrayLike], *, cycles: float = 40.0
) -> Texture:
    """Return specks of several colours on a ground, as in terrazzo or linoleum; `cycles` of them across."""
    image = fill(ground, _SMALL)
    for speck in specks:
        image = mix(image, speck, (grains(rng, _SMALL, cycles) - 0.72) / 0.03)
    return shade(image, 1.0 + 0.1 * (tileable_noise(rng, _SMALL, slope=0.8) - 0.5))


def woven(rng: np.random.Generator, warp: ArrayLike, weft: ArrayLike, *, threads: int = 64) -> Texture:
    """Return cloth with warp threads along columns and weft along rows, of colours (3,) or (threads, 3)."""
    at = (np.arange(_SMALL) + 0.5) * threads / _SMALL
    number = np.minimum(at.astype(np.intp), threads - 1)
    round_ = 0.8 + 0.2 * np.sin(np.pi * (at - number))
    tones = rng.normal(1.0, 0.035, (2, threads))
    colors = [np.broadcast_to(np.asarray(c, dtype=np.float64), (threads, 3)) for c in (warp, weft)]
    along, across = (c[number] * (t[number] * round_)[:, None] for c, t in zip(colors, tones, strict=True))
    image = np.where(((number[:, None] + number[None, :]) % 2 == 0)[..., None], along[None, :], across[:, None])
    return shade(image, 1.0 + 0.16 * (tileable_noise(rng, _SMALL, slope=1.0) - 0.5))


def checks(rng: np.random.Generator, first: ArrayLike, second: ArrayLike) -> Texture:
    """Return gingham: cloth with eight stripes of two colours in both directions."""
    threads = 64
    own = np.where((np.arange(threads) // 8 % 2 == 0)[:, None], np.asarray(first), np.asarray(second))
    return woven(rng, own, own, threads=threads)


def tartan(rng: np.random.Generator, colors: Sequence[ArrayLike]) -> Texture:
    """Return cloth with the same irregular stripes in both directions; the first colour is the ground."""
    threads = 96
    own = np.array(np.broadcast_to(np.asarray(colors[0], dtype=np.float64), (threads, 3)))
    for color in colors[1:]:
        start = int(rng.integers(0, threads))
        width = int(rng.integers(2, threads // 5))
        for begin in (start, start + 2 * width):
            own[np.arange(begin, begin + width) % threads] = np.asarray(color)
    return woven(rng, own, own, threads=threads)


def stripes(rng: np.random.Generator, colors: Sequence[ArrayLike], *, count: int = 8) -> Texture:
    """Return `count` stripes of equal width along rows in alternating colours (`count`: a multiple of their number)."""
    number = (np.arange(_SMALL) * count // _SMALL) % len(colors)
    image = np.broadcast_to(np.asarray(colors, dtype=np.float64)[number][:, None, :], (_SMALL, _SMALL, 3))
    return shade(image, 1.0 + 0.12 * (tileable_noise(rng, _SMALL, slope=0.9) - 0.5))


def carpet(rng: np.random.Generator, color: ArrayLike) -> Texture:
    """Return a short-pile carpet; about 0.5 m."""
    tufts = grains(rng, _SMALL, _SMALL / 4.0) - 0.5
    return shade(fill(color, _SMALL), 1.0 + 0.8 * tufts + 0.2 * (tileable_noise(rng, _SMALL, slope=1.2) - 0.5))


def leather(rng: np.random.Generator, color: ArrayLike) -> Texture:
    """Return grained leather; about 0.15 m."""
    height = np.minimum(np.abs(grains(rng, _SMALL, _SMALL / 16.0) - 0.5), 0.1) * 6.0
    return shade(fill(color, _SMALL), _relief(height, 0.3) * (0.85 + 0.25 * height))


def cardboard(rng: np.random.Generator) -> Texture:
    """Return corrugated board with faint flutes along rows; about 0.2 m."""
    color = np.array([186, 148, 106]) * rng.uniform(0.85, 1.1)
    flutes = 0.025 * np.sin(2.0 * np.pi * 26.0 * np.arange(_SMALL) / _SMALL)[:, None]
    fibres = tileable_noise(rng, _SMALL, slope=0.5, stretch=3.0) - 0.5
    specks = np.clip(grains(rng, _SMALL, _SMALL / 4.0) - 0.85, 0.0, 0.15)
    clouds = tileable_noise(rng, _SMALL) - 0.5
    return shade(fill(color, _SMALL), 1.0 + flutes + 0.12 * fibres + 0.1 * clouds - 1.2 * specks)


def brushed(rng: np.random.Generator, color: ArrayLike = (176, 178, 182)) -> Texture:
    """Return metal brushed along rows; use it with metallic 0.3 to 0.8 and roughness 0.3 to 0.5."""
    return shade(fill(color, _SMALL), 1.0 + 0.3 * (tileable_noise(rng, _SMALL, slope=0.3, stretch=40.0) - 0.5))


def bricks(
    rng: np.random.Generator, brick: ArrayLike = (148, 92, 74), mortar: ArrayLike = (178, 170, 158), *, rows: int = 8
) -> Texture:
    """Return bricks in a running bond with `rows` (even) courses; about 0.08 m per course, mortar included."""
    columns = max(rows // 3, 1)
    cell, edge = _cells(_LARGE, rows, columns, np.where(np.arange(rows) % 2, 0.5, 0.0))
    rough = tileable_noise(rng, _LARGE, slope=1.0) - 0.5
    stone = shade(fill(brick, _LARGE), rng.normal(1.0, 0.11, rows * columns)[cell] + 0.35 * rough)
    joint = np.clip((_LARGE / 190.0 + 3.0 * rough - edge) / 1.5, 0.0, 1.0)
    return mix(stone, shade(fill(mortar, _LARGE), 1.0 + 0.3 * rough), joint)


def tiles(
    rng: np.random.Generator, color: ArrayLike, joint: ArrayLike = (150, 148, 144), *, other: ArrayLike | None = None
) -> Texture:
    """Return square tiles of one colour, or two alternating ones, with joints; four per row."""
    count = 4
    cell, edge = _cells(_LARGE, count, count)
    odd = ((cell // count + cell) % 2).astype(np.float64)
    image = mix(fill(color, _LARGE), color if other is None else other, odd)
    tone = rng.normal(1.0, 0.025, count * count)[cell] + 0.1 * (tileable_noise(rng, _LARGE) - 0.5)
    lip = 1.0 - 0.1 * np.clip(4.0 - edge, 0.0, 1.0)
    return mix(shade(image, tone * lip), joint, np.clip(_LARGE / 256.0 + 0.5 - edge, 0.0, 1.0))


def wallpaper(rng: np.random.Generator, ground: ArrayLike, figure: ArrayLike, motif: str = "dots") -> Texture:
    """Return wallpaper with a motif of "dots", "diamonds", "waves", "leaves" or "stripes"; about 0.4 m."""
    turn = 2.0 * np.pi * (np.arange(_SMALL) + 0.5) / _SMALL
    u = turn[None, :]
    v = turn[:, None]
    count = 4
    value = {
        "dots": np.cos(count * u) + np.cos(count * v) - 1.2,
        "diamonds": np.abs(np.cos(count * u / 2) * np.cos(count * v / 2)) - np.abs(np.sin(count * u / 2)) + 0.0 * v,
        "waves": np.cos(2 * count * v + 1.2 * np.sin(count * u)) - 0.2,
        "leaves": np.cos(count * u + 0.8 * np.sin(2 * count * v)) + 0.6 * np.cos(2 * count * v - count * u) - 0.75,
        "stripes": np.cos(2 * count * u) + 0.0 * v,
    }[motif]
    image = mix(fill(ground, _SMALL), figure, 0.5 + 6.0 * value)
    return shade(image, 1.0 + 0.08 * (tileable_noise(rng, _SMALL, slope=0.7) - 0.5))
