"""Target marks on the table and obstacles that stand on it."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.scene.mesh import BodyParts, frustum, lathe
from kinebench_drake.suites.scene.model import (
    AssetModel,
    Collider,
    ColliderKind,
    Material,
    RigidBody,
    SurfaceFinish,
    Visual,
)
from kinebench_drake.suites.scene.texture import rgb

TARGET_RADIUS_M = (0.060, 0.075)
"""Least and greatest radius of a target."""
TARGET_HEIGHT_M = 0.0008
"""Thickness of a target."""
OBSTACLE_HEIGHT_M = (0.085, 0.13)
"""Least and greatest height of an obstacle."""
OBSTACLE_RADIUS_M = (0.018, 0.026)
"""Least and greatest radius of an obstacle's foot; of a block, half its diagonal."""


def _target(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
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
    return AssetModel(
        kind="mark/target",
        asset_id=asset_id,
        words="red and white target",
        bodies=(RigidBody(name="target", visuals=tuple(rings)),),
        size={"radius_m": radius},
    )


def _color(rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw a saturated colour other than the cubes' red and green."""
    wheel = np.array([[0.75, 0.35, 0.02], [0.05, 0.15, 0.55], [0.35, 0.08, 0.45], [0.02, 0.35, 0.4], [0.75, 0.6, 0.05]])
    return rgb(np.clip(wheel[rng.integers(len(wheel))] * rng.uniform(0.7, 1.2, size=3), 0.0, 1.0))


def _parts(*shapes: tuple[Array, SurfaceFinish], colliders: list[Collider]) -> BodyParts:
    """Return surfaces of revolution from profiles (N, 2) of radius and height, with colliders."""
    visuals = [Visual(mesh=lathe(profile, sections=40), surface=surface) for profile, surface in shapes]
    return BodyParts(visuals=visuals, colliders=colliders)


def _bottle(h: float, r: float, rng: np.random.Generator) -> BodyParts:
    neck, shoulder, collar = 0.42 * r, 0.62 * h, 0.80 * h
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
    foot, stem, ball = 0.008, 0.45 * r, 0.55 * r
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
    size, center = [side, side, h], [0.0, 0.0, h / 2.0]
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
    height, radius = float(rng.uniform(*OBSTACLE_HEIGHT_M)), float(rng.uniform(*OBSTACLE_RADIUS_M))
    words, make, density = _SHAPES[index % len(_SHAPES)]
    material = Material(density=density, static_friction=0.6, dynamic_friction=0.5, angular_damping=0.1)
    return AssetModel(
        kind="obstacle/upright",
        asset_id=asset_id,
        words=words,
        bodies=(make(height, radius, rng).body("obstacle", material),),
        size={"height_m": height, "radius_m": radius},
    )


KINDS = {"mark/target": _target, "obstacle/upright": _obstacle}
"""Flat targets with the origin on the table; bottles, cans, posts and blocks with the origin at the foot's centre."""
