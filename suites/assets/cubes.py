"""Small cubes to stack, pull and store."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.suites.assets.mesh import block, board
from kinebench_drake.suites.assets.model import AssetKind, Body, Material, Model, SurfaceFinish
from kinebench_drake.suites.assets.texture import blend, tileable_noise

COLORS = {"red": (0.65, 0.03, 0.03), "green": (0.04, 0.42, 0.06), "blue": (0.03, 0.09, 0.6)}
"""Linear RGB."""
EDGE_M = (0.036, 0.044)
"""Least and greatest edge."""
_PIXELS = 64


def _face() -> tuple[Array, Array]:
    """Where each texel lies on a face, -0.5..0.5 of the edge from its middle; the middle is texel 0."""
    u = (np.arange(_PIXELS) + 0.5) / _PIXELS
    u = np.where(u > 0.5, u - 1.0, u)
    x, y = np.meshgrid(u, u)
    return x, y


def _plain(light: Array, dark: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    return blend(light, dark, np.zeros((_PIXELS, _PIXELS)))


def _framed(light: Array, dark: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """A darker rim around each face."""
    x, y = _face()
    return blend(light, dark, (np.maximum(np.abs(x), np.abs(y)) > rng.uniform(0.38, 0.44)).astype(np.float64))


def _inlaid(light: Array, dark: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """A darker ring on each face."""
    x, y = _face()
    outer = rng.uniform(0.26, 0.34)
    return blend(light, dark, (np.abs(np.hypot(x, y) - outer) < rng.uniform(0.04, 0.07)).astype(np.float64))


def _grained(light: Array, dark: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Painted wood, through which the grain shows."""
    return blend(dark, light, 0.3 + 0.7 * tileable_noise(rng, _PIXELS, slope=1.0, stretch=8.0))


_FINISHES = (_plain, _framed, _inlaid, _grained)


def _cube(name: str, asset_id: str, index: int, rng: np.random.Generator) -> Model:
    edge = float(rng.uniform(*EDGE_M))
    color = np.clip(np.array(COLORS[name]) * rng.uniform(0.75, 1.25, size=3), 0.0, 1.0)
    light = 255.0 * color ** (1.0 / 2.2)
    surface = SurfaceFinish(
        roughness=float(rng.uniform(0.35, 0.9)), texture=_FINISHES[index % len(_FINISHES)](light, 0.6 * light, rng)
    )
    body = Body(
        name="cube",
        visuals=(board([edge] * 3, np.zeros(3), surface, bevel_m=0.0015, uv_per_m=1.0 / edge),),
        colliders=(block([edge] * 3, np.zeros(3)),),
        material=Material(density=float(rng.uniform(350.0, 700.0)), static_friction=0.9, dynamic_friction=0.8),
    )
    return Model(kind=f"cube/{name}", asset_id=asset_id, words=f"{name} cube", bodies=(body,), size={"edge_m": edge})


KINDS = tuple(AssetKind(name=f"cube/{color}", make=partial(_cube, color)) for color in COLORS)
"""Cubes of each colour."""
