"""Marks on the table and obstacles that stand on it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.assets.mesh import block, board, lathe
from kinebench_drake.suites.assets.model import (
    AssetKind,
    Body,
    Collider,
    ColliderKind,
    Material,
    Model,
    SurfaceFinish,
    Visual,
)

TARGET_RADIUS_M = (0.060, 0.075)
"""Least and greatest radius of a target."""
TARGET_HEIGHT_M = 0.0008
"""How thick a target is drawn."""
OBSTACLE_HEIGHT_M = (0.085, 0.13)
"""Least and greatest height of an obstacle."""
OBSTACLE_RADIUS_M = (0.018, 0.026)
"""Least and greatest radius of an obstacle's foot; of a block half its diagonal."""
_HULL_SECTIONS = 24


def _target(asset_id: str, index: int, rng: np.random.Generator) -> Model:
    radius = float(rng.uniform(*TARGET_RADIUS_M))
    edges = np.linspace(radius, 0.0, (3, 5, 4)[index % 3] + 1)
    red = (float(rng.uniform(0.5, 0.75)), 0.02, float(rng.uniform(0.01, 0.04)))
    white = (float(rng.uniform(0.75, 0.9)),) * 3
    rings = [
        Visual(
            mesh=lathe([[outer, 0.0], [outer, TARGET_HEIGHT_M], [inner, TARGET_HEIGHT_M]], sections=64),
            surface=SurfaceFinish(color=white if i % 2 else red, roughness=0.9),
        )
        for i, (outer, inner) in enumerate(pairwise(edges))
    ]
    return Model(
        kind="mark/target",
        asset_id=asset_id,
        words="red and white target",
        bodies=(Body(name="target", visuals=tuple(rings)),),
        size={"radius_m": radius},
    )


@dataclass(frozen=True, slots=True)
class _Looks:
    """An obstacle's parts; the foot's middle is the origin."""

    words: str
    visuals: tuple[Visual, ...]
    colliders: tuple[Collider, ...]
    density: float


def _round(profile: Array, surface: SurfaceFinish) -> Visual:
    return Visual(mesh=lathe(profile, sections=40), surface=surface)


def _frustum(low: Sequence[float], high: Sequence[float]) -> Collider:
    """A solid of revolution about z between two points of its profile (radius, height) [m]."""
    angle = 2.0 * np.pi * np.arange(_HULL_SECTIONS) / _HULL_SECTIONS
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    return Collider(
        kind=ColliderKind.HULL,
        points=np.concatenate([np.column_stack([r * ring, np.full(len(ring), z)]) for r, z in (low, high)]),
    )


def _color(rng: np.random.Generator) -> tuple[float, float, float]:
    """A strong colour, none of the cubes' red and green, nor a grey."""
    wheel = np.array([[0.75, 0.35, 0.02], [0.05, 0.15, 0.55], [0.35, 0.08, 0.45], [0.02, 0.35, 0.4], [0.75, 0.6, 0.05]])
    r, g, b = np.clip(wheel[rng.integers(len(wheel))] * rng.uniform(0.7, 1.2, size=3), 0.0, 1.0)
    return float(r), float(g), float(b)


def _bottle(h: float, r: float, rng: np.random.Generator) -> _Looks:
    neck, shoulder, collar = 0.42 * r, 0.62 * h, 0.80 * h
    cap = 0.16 * h
    body = np.array(
        [[0.0, 0.0], [r - 0.002, 0.0], [r, 0.002], [r, shoulder], [0.92 * r, shoulder + 0.25 * (collar - shoulder)],
         [0.62 * r, shoulder + 0.75 * (collar - shoulder)], [neck, collar], [neck, h - 0.5 * cap]]
    )  # fmt: skip
    top = np.array([[0.0, h - cap], [neck + 0.0015, h - cap], [neck + 0.0015, h - 0.001], [neck + 0.0005, h], [0.0, h]])
    label = np.array([[r, 0.2 * h], [r + 0.0004, 0.2 * h], [r + 0.0004, 0.5 * h], [r, 0.5 * h]])
    return _Looks(
        "bottle",
        (
            _round(body, SurfaceFinish(color=_color(rng), roughness=0.25, specular=0.6)),
            _round(top, SurfaceFinish(color=(0.85, 0.85, 0.82), roughness=0.5)),
            _round(label, SurfaceFinish(color=(0.8, 0.78, 0.7), roughness=0.9)),
        ),
        (
            _frustum((r, 0.0), (r, shoulder)),
            _frustum((r, shoulder), (neck, collar)),
            _frustum((neck, collar), (neck, h)),
        ),
        450.0,
    )


def _can(h: float, r: float, rng: np.random.Generator) -> _Looks:
    side = np.array([[0.9 * r, 0.0], [r, 0.004], [r, h - 0.004], [0.93 * r, h - 0.001]])
    lids = np.array([[0.93 * r, h - 0.001], [0.92 * r, h], [0.88 * r, h], [0.86 * r, h - 0.002], [0.0, h - 0.002]])
    steel = SurfaceFinish(color=(0.6, 0.6, 0.62), roughness=0.35, metallic=0.7, specular=0.5)
    band = np.array([[r, 0.35 * h], [r + 0.0003, 0.35 * h], [r + 0.0003, 0.65 * h], [r, 0.65 * h]])
    return _Looks(
        "can",
        (
            _round(side, SurfaceFinish(color=_color(rng), roughness=0.35, specular=0.5)),
            _round(lids, steel),
            _round(band, SurfaceFinish(color=(0.85, 0.83, 0.8), roughness=0.5)),
        ),
        (_frustum((r, 0.0), (r, h)),),
        450.0,
    )


def _post(h: float, r: float, rng: np.random.Generator) -> _Looks:
    foot, stem, ball = 0.008, 0.45 * r, 0.55 * r
    angle = np.linspace(-1.0, np.pi / 2.0, 9)
    wood = np.clip(np.array([0.5, 0.3, 0.13]) * rng.uniform(0.6, 1.3), 0.0, 1.0)
    profile = np.concatenate(
        [
            [[0.0, 0.0], [r, 0.0], [r, foot - 0.002], [r - 0.002, foot], [stem, foot], [stem, h - 1.85 * ball]],
            np.column_stack([ball * np.cos(angle), h - ball + ball * np.sin(angle)]),
        ]
    )
    return _Looks(
        "wooden post",
        (_round(profile, SurfaceFinish(color=(float(wood[0]), float(wood[1]), float(wood[2])), roughness=0.7)),),
        (
            _frustum((r, 0.0), (r, foot)),
            _frustum((stem, foot), (stem, h - ball)),
            Collider(kind=ColliderKind.SPHERE, size=(ball,), X_BodyC=make_pose(np.eye(3), [0.0, 0.0, h - ball])),
        ),
        650.0,
    )


def _block(h: float, r: float, rng: np.random.Generator) -> _Looks:
    side = np.sqrt(2.0) * r
    size, center = [side, side, h], [0.0, 0.0, h / 2.0]
    surface = SurfaceFinish(color=_color(rng), roughness=float(rng.uniform(0.5, 0.9)))
    return _Looks(
        "block",
        (board(size, center, surface, bevel_m=0.002, uv_per_m=1.0),),
        (block(size, center),),
        400.0,
    )


_SHAPES: tuple[Callable[[float, float, np.random.Generator], _Looks], ...] = (_bottle, _can, _post, _block)


def _obstacle(asset_id: str, index: int, rng: np.random.Generator) -> Model:
    height, radius = float(rng.uniform(*OBSTACLE_HEIGHT_M)), float(rng.uniform(*OBSTACLE_RADIUS_M))
    looks = _SHAPES[index % len(_SHAPES)](height, radius, rng)
    body = Body(
        name="obstacle",
        visuals=looks.visuals,
        colliders=looks.colliders,
        material=Material(density=looks.density, static_friction=0.6, dynamic_friction=0.5, angular_damping=0.1),
    )
    return Model(
        kind="obstacle/upright",
        asset_id=asset_id,
        words=looks.words,
        bodies=(body,),
        size={"height_m": height, "radius_m": radius},
    )


KINDS = (AssetKind(name="mark/target", make=_target), AssetKind(name="obstacle/upright", make=_obstacle))
"""A flat target, its origin on the table; and bottles, cans, posts and blocks that stand on their origin."""
