"""Pegs with one red and one blue end, to stand upright."""

import numpy as np

from kinebench_drake.suites.assets.mesh import block, board
from kinebench_drake.suites.assets.model import AssetKind, Body, Material, Model, SurfaceFinish
from kinebench_drake.suites.assets.texture import blend, tileable_noise

LENGTH_M = (0.205, 0.235)
"""Least and greatest length."""
WIDTH_M = (0.042, 0.050)
"""Least and greatest width and height."""
_RED, _BLUE, _BAND = (0.62, 0.03, 0.03), (0.03, 0.10, 0.55), (0.75, 0.72, 0.66)


def _surface(color: tuple[float, float, float], grained: bool, rng: np.random.Generator) -> SurfaceFinish:
    shade = np.clip(255.0 * np.clip(np.array(color) * rng.uniform(0.8, 1.25, size=3), 0.0, 1.0) ** (1.0 / 2.2), 0, 255)
    grain = tileable_noise(rng, 64, slope=1.0, stretch=8.0) if grained else np.ones((64, 64))
    return SurfaceFinish(texture=blend(0.65 * shade, shade, grain), roughness=float(rng.uniform(0.4, 0.9)))


def _peg(asset_id: str, index: int, rng: np.random.Generator) -> Model:
    length, width = float(rng.uniform(*LENGTH_M)), float(rng.uniform(*WIDTH_M))
    grained, banded = index % 2 == 1, index % 4 >= 2
    band = float(rng.uniform(0.006, 0.014)) if banded else 0.0
    half = 0.5 * (length - band)
    pieces = [
        (half, -0.5 * (half + band), _surface(_RED, grained, rng)),
        (half, 0.5 * (half + band), _surface(_BLUE, grained, rng)),
    ]
    if banded:
        pieces.append((band, 0.0, _surface(_BAND, grained, rng)))
    body = Body(
        name="peg",
        visuals=tuple(
            board([piece, width, width], [x, 0.0, 0.0], surface, bevel_m=0.0015, uv_per_m=1.0 / width)
            for piece, x, surface in pieces
        ),
        colliders=(block([length, width, width], np.zeros(3)),),
        material=Material(density=float(rng.uniform(800.0, 1000.0)), static_friction=0.3, dynamic_friction=0.3),
    )
    return Model(
        kind="peg",
        asset_id=asset_id,
        words="red and blue peg",
        bodies=(body,),
        size={"length_m": length, "width_m": width},
    )


KINDS = (AssetKind(name="peg", make=_peg),)
"""Square pegs along x, the red end at -x; plain or grained, some with a light band in the middle."""
