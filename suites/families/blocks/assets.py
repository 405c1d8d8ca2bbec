"""Cubes to stack, pull and store, and square pegs with one red and one blue end to stand upright."""

from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array
from kinebench_drake.suites.scene.mesh import BodyParts, box_collider
from kinebench_drake.suites.scene.model import AssetMaker, AssetModel, Material, SurfaceFinish
from kinebench_drake.suites.scene.texture import Texture, gradient, srgb, tileable_noise

COLORS = {"red": (0.65, 0.03, 0.03), "green": (0.04, 0.42, 0.06), "blue": (0.03, 0.09, 0.6)}
"""Linear RGB of cubes."""
EDGE_M = (0.036, 0.044)
"""Least and greatest edge of a cube."""
PEG_LENGTH_M, PEG_WIDTH_M = (0.205, 0.235), (0.042, 0.050)
"""Least and greatest length, and width and height, of a peg."""
_PEG_RED, _PEG_BLUE, _PEG_BAND = (0.62, 0.03, 0.03), (0.03, 0.10, 0.55), (0.75, 0.72, 0.66)
_PIXELS = 64


def _texel_positions() -> tuple[Array, Array]:
    """Return x and y of each texel of a face, -0.5..0.5 of the edge from its centre; the centre is texel 0."""
    u = (np.arange(_PIXELS) + 0.5) / _PIXELS
    u = np.where(u > 0.5, u - 1.0, u)
    x, y = np.meshgrid(u, u)
    return x, y


def _rim(light: Array, dark: Array, rng: np.random.Generator) -> Texture:
    """Make a face with a darker rim."""
    x, y = _texel_positions()
    return gradient((light, dark), (np.maximum(np.abs(x), np.abs(y)) > rng.uniform(0.38, 0.44)).astype(np.float64))


def _ring(light: Array, dark: Array, rng: np.random.Generator) -> Texture:
    """Make a face with a darker ring."""
    x, y = _texel_positions()
    radius = rng.uniform(0.26, 0.34)
    return gradient((light, dark), (np.abs(np.hypot(x, y) - radius) < rng.uniform(0.04, 0.07)).astype(np.float64))


def _grain(light: Array, dark: Array, rng: np.random.Generator) -> Texture:
    """Make a face of painted wood with visible grain."""
    return gradient((dark, light), 0.3 + 0.7 * tileable_noise(rng, _PIXELS, slope=1.0, stretch=8.0))


_FINISHES = (lambda light, dark, _: gradient((light, dark), np.zeros((_PIXELS, _PIXELS))), _rim, _ring, _grain)


def _cube(name: str, asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    edge = float(rng.uniform(*EDGE_M))
    light = srgb(np.clip(np.array(COLORS[name]) * rng.uniform(0.75, 1.25, size=3), 0.0, 1.0))
    surface = SurfaceFinish(
        roughness=float(rng.uniform(0.35, 0.9)), texture=_FINISHES[index % len(_FINISHES)](light, 0.6 * light, rng)
    )
    parts = BodyParts(uv_per_m=1.0 / edge)
    parts.box([edge] * 3, np.zeros(3), surface, bevel_m=0.0015)
    material = Material(density=float(rng.uniform(350.0, 700.0)), static_friction=0.9, dynamic_friction=0.8)
    body, words = parts.body("cube", material), f"{name} cube"
    return AssetModel(kind=f"cube/{name}", asset_id=asset_id, words=words, bodies=(body,), size={"edge_m": edge})


def _peg_surface(color: ArrayLike, grained: bool, rng: np.random.Generator) -> SurfaceFinish:
    light = srgb(np.clip(np.array(color) * rng.uniform(0.8, 1.25, size=3), 0.0, 1.0))
    grain = tileable_noise(rng, 64, slope=1.0, stretch=8.0) if grained else np.ones((64, 64))
    return SurfaceFinish(texture=gradient((0.65 * light, light), grain), roughness=float(rng.uniform(0.4, 0.9)))


def _peg(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    length, width = float(rng.uniform(*PEG_LENGTH_M)), float(rng.uniform(*PEG_WIDTH_M))
    grained, banded = index % 2 == 1, index % 4 >= 2
    band = float(rng.uniform(0.006, 0.014)) if banded else 0.0
    half = 0.5 * (length - band)
    pieces = [
        (half, -0.5 * (half + band), _peg_surface(_PEG_RED, grained, rng)),
        (half, 0.5 * (half + band), _peg_surface(_PEG_BLUE, grained, rng)),
    ]
    if banded:
        pieces.append((band, 0.0, _peg_surface(_PEG_BAND, grained, rng)))
    parts = BodyParts(uv_per_m=1.0 / width, colliders=[box_collider([length, width, width], np.zeros(3))])
    for piece, x, surface in pieces:
        parts.box([piece, width, width], [x, 0.0, 0.0], surface, bevel_m=0.0015, solid=False)
    material = Material(density=float(rng.uniform(800.0, 1000.0)), static_friction=0.3, dynamic_friction=0.3)
    body, size = parts.body("peg", material), {"length_m": length, "width_m": width}
    return AssetModel(kind="peg", asset_id=asset_id, words="red and blue peg", bodies=(body,), size=size)


KINDS: dict[str, AssetMaker] = {**{f"cube/{color}": partial(_cube, color) for color in COLORS}, "peg": _peg}
"""Cubes of each colour; pegs along x with the red end at -x, plain or grained, some with a light band in the middle."""
