"""Cubes to stack, pull and store; square pegs to stand upright; target marks; and obstacles to pass by."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.scene.mesh import BodyParts, box_collider, frustum, lathe
from kinebench_drake.suites.scene.model import (
    AssetMaker,
    AssetModel,
    Collider,
    ColliderKind,
    Material,
    SurfaceFinish,
)
from kinebench_drake.suites.scene.texture import Texture, gradient, rgb, srgb, tileable_noise

COLORS = {"red": (0.65, 0.03, 0.03), "green": (0.04, 0.42, 0.06), "blue": (0.03, 0.09, 0.6)}
"""Linear RGB of cubes."""
EDGE_M = (0.036, 0.044)
"""Least and greatest edge of a cube."""
PEG_LENGTH_M = (0.205, 0.235)
PEG_WIDTH_M = (0.042, 0.050)
"""Least and greatest length, and width and height, of a peg."""
_PEG_RED = (0.62, 0.03, 0.03)
_PEG_BLUE = (0.03, 0.10, 0.55)
_PEG_BAND = (0.75, 0.72, 0.66)
_PIXELS = 64
OBSTACLE_RADIUS_M = (0.018, 0.026)
"""Least and greatest radius of an obstacle's foot; of a block, half its diagonal."""
TARGET_RADIUS_M = (0.060, 0.075)
"""Least and greatest radius of a target."""


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
    body = parts.body("cube", material)
    return AssetModel(asset_id=asset_id, words=f"{name} cube", bodies=(body,), size={"edge_m": edge})


def _peg_surface(color: ArrayLike, grained: bool, rng: np.random.Generator) -> SurfaceFinish:
    light = srgb(np.clip(np.array(color) * rng.uniform(0.8, 1.25, size=3), 0.0, 1.0))
    grain = tileable_noise(rng, 64, slope=1.0, stretch=8.0) if grained else np.ones((64, 64))
    return SurfaceFinish(texture=gradient((0.65 * light, light), grain), roughness=float(rng.uniform(0.4, 0.9)))


def _peg(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    length = float(rng.uniform(*PEG_LENGTH_M))
    width = float(rng.uniform(*PEG_WIDTH_M))
    grained = index % 2 == 1
    banded = index % 4 >= 2
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
    body = parts.body("peg", material)
    return AssetModel(
        asset_id=asset_id, words="red and blue peg", bodies=(body,), size={"length_m": length, "width_m": width}
    )


TARGET_HEIGHT_M = 0.0008
"""Thickness of a target."""
OBSTACLE_HEIGHT_M = (0.085, 0.13)
"""Least and greatest height of an obstacle."""


def _target(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    radius = float(rng.uniform(*TARGET_RADIUS_M))
    edges = np.linspace(radius, 0.0, (3, 5, 4)[index % 3] + 1)
    red = (float(rng.uniform(0.5, 0.75)), 0.02, float(rng.uniform(0.01, 0.04)))
    white = (float(rng.uniform(0.75, 0.9)),) * 3
    parts = BodyParts()
    for i, (outer, inner) in enumerate(pairwise(edges)):
        ring = [[outer, 0.0], [outer, TARGET_HEIGHT_M], [inner, TARGET_HEIGHT_M]]
        parts.visual(lathe(ring, sections=64), SurfaceFinish(color=white if i % 2 else red, roughness=0.9))
    return AssetModel(
        asset_id=asset_id,
        words="red and white target",
        bodies=(parts.body("target", Material()),),
        size={"radius_m": radius},
    )


def _color(rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw a saturated colour other than the cubes' red and green."""
    wheel = np.array([[0.75, 0.35, 0.02], [0.05, 0.15, 0.55], [0.35, 0.08, 0.45], [0.02, 0.35, 0.4], [0.75, 0.6, 0.05]])
    return rgb(np.clip(wheel[rng.integers(len(wheel))] * rng.uniform(0.7, 1.2, size=3), 0.0, 1.0))


def _parts(*shapes: tuple[Array, SurfaceFinish], colliders: list[Collider]) -> BodyParts:
    """Return surfaces of revolution from profiles (N, 2) of radius and height, with colliders."""
    parts = BodyParts(colliders=colliders)
    for profile, surface in shapes:
        parts.visual(lathe(profile, sections=40), surface)
    return parts


def _bottle(h: float, r: float, rng: np.random.Generator) -> BodyParts:
    neck = 0.42 * r
    shoulder = 0.62 * h
    collar = 0.80 * h
    cap = 0.16 * h
    body = np.array(
        [[0.0, 0.0], [r - 0.002, 0.0], [r, 0.002], [r, shoulder], [0.92 * r, shoulder + 0.25 * (collar - shoulder)],
         [0.62 * r, shoulder + 0.75 * (collar - shoulder)], [neck, collar], [neck, h - 0.5 * cap]]
    )  # fmt: skip
    top = np.array([[0.0, h - cap], [neck + 0.0015, h - cap], [neck + 0.0015, h - 0.001], [neck + 0.0005, h], [0.0, h]])
    label = np.array([[r, 0.2 * h], [r + 0.0004, 0.2 * h], [r + 0.0004, 0.5 * h], [r, 0.5 * h]])
    points = [(r, 0.0), (r, shoulder), (neck, collar), (neck, h)]
    return _parts(
        (body, SurfaceFinish(color=_color(rng), roughness=0.25, specular=0.6)),
        (top, SurfaceFinish(color=(0.85, 0.85, 0.82), roughness=0.5)),
        (label, SurfaceFinish(color=(0.8, 0.78, 0.7), roughness=0.9)),
        colliders=[frustum(low, high, sections=24) for low, high in pairwise(points)],
    )


def _can(h: float, r: float, rng: np.random.Generator) -> BodyParts:
    side = np.array([[0.9 * r, 0.0], [r, 0.004], [r, h - 0.004], [0.93 * r, h - 0.001]])
    lids = np.array([[0.93 * r, h - 0.001], [0.92 * r, h], [0.88 * r, h], [0.86 * r, h - 0.002], [0.0, h - 0.002]])
    steel = SurfaceFinish(color=(0.6, 0.6, 0.62), roughness=0.35, metallic=0.7, specular=0.5)
    band = np.array([[r, 0.35 * h], [r + 0.0003, 0.35 * h], [r + 0.0003, 0.65 * h], [r, 0.65 * h]])
    return _parts(
        (side, SurfaceFinish(color=_color(rng), roughness=0.35, specular=0.5)),
        (lids, steel),
        (band, SurfaceFinish(color=(0.85, 0.83, 0.8), roughness=0.5)),
        colliders=[frustum((r, 0.0), (r, h), sections=24)],
    )


def _post(h: float, r: float, rng: np.random.Generator) -> BodyParts:
    foot = 0.008
    stem = 0.45 * r
    ball = 0.55 * r
    angle = np.linspace(-1.0, np.pi / 2.0, 9)
    wood = np.clip(np.array([0.5, 0.3, 0.13]) * rng.uniform(0.6, 1.3), 0.0, 1.0)
    profile = np.concatenate(
        [
            [[0.0, 0.0], [r, 0.0], [r, foot - 0.002], [r - 0.002, foot], [stem, foot], [stem, h - 1.85 * ball]],
            np.column_stack([ball * np.cos(angle), h - ball + ball * np.sin(angle)]),
        ]
    )
    return _parts(
        (profile, SurfaceFinish(color=rgb(wood), roughness=0.7)),
        colliders=[
            frustum((r, 0.0), (r, foot), sections=24),
            frustum((stem, foot), (stem, h - ball), sections=24),
            Collider(kind=ColliderKind.SPHERE, size=(ball,), X_BodyC=make_pose(np.eye(3), [0.0, 0.0, h - ball])),
        ],
    )


def _block(h: float, r: float, rng: np.random.Generator) -> BodyParts:
    side = np.sqrt(2.0) * r
    size = [side, side, h]
    center = [0.0, 0.0, h / 2.0]
    surface = SurfaceFinish(color=_color(rng), roughness=float(rng.uniform(0.5, 0.9)))
    parts = BodyParts(uv_per_m=1.0)
    parts.box(size, center, surface, bevel_m=0.002)
    return parts


_SHAPES: tuple[tuple[str, Callable[[float, float, np.random.Generator], BodyParts], float], ...] = (
    ("bottle", _bottle, 450.0),
    ("can", _can, 450.0),
    ("wooden post", _post, 650.0),
    ("block", _block, 400.0),
)
"""Name, shape from height and radius, and density [kg/m^3] of each kind of obstacle."""


def _obstacle(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    height = float(rng.uniform(*OBSTACLE_HEIGHT_M))
    radius = float(rng.uniform(*OBSTACLE_RADIUS_M))
    words, make, density = _SHAPES[index % len(_SHAPES)]
    material = Material(density=density, static_friction=0.6, dynamic_friction=0.5, angular_damping=0.1)
    return AssetModel(
        asset_id=asset_id,
        words=words,
        bodies=(make(height, radius, rng).body("obstacle", material),),
        size={"height_m": height, "radius_m": radius},
    )


KINDS: dict[str, AssetMaker] = {
    **{f"cube/{color}": partial(_cube, color) for color in COLORS},
    "peg": _peg,
    "mark/target": _target,
    "obstacle/upright": _obstacle,
}
"""Cubes of each colour; pegs along x with the red end at -x, plain or grained, some with a light band in the middle;
flat targets with the origin on the table; bottles, cans, posts and blocks with the origin at the foot's centre."""
