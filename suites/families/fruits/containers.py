"""Containers: bowls, plates, trays, baskets; and crates with three compartments side by side.

The origin is the centre of the underside.
"""

from collections.abc import Callable
from itertools import pairwise, product

import numpy as np

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.suites.scene.mesh import BodyParts, box_collider, lathe, sweep
from kinebench_drake.suites.scene.model import AssetModel, ColliderKind, Material, SurfaceFinish, Visual
from kinebench_drake.suites.scene.texture import fill, grains, shade, speckle, wood, woven

COMPARTMENTS = 3
"""Number of compartments of a crate, side by side along y."""
_SECTORS = 16
"""Number of box colliders around a round wall."""
_WOODS = ("oak", "beech", "walnut", "pine")


def _add_shell(parts: BodyParts, inner: Array, thick_m: float) -> None:
    """Add box colliders outside the inner profile (N, 2) of radius and height, one per sector, and across the floor.

    Boxes, because PhysX occasionally reports contacts with thin convex hulls that are far away. The flats of the
    polygon are as far inside the circle as its corners are outside.
    """
    half = np.pi / _SECTORS
    apothem = 2.0 * np.cos(half) / (1.0 + np.cos(half))
    floor = apothem * inner[0, 0]
    depth = 0.5 * inner[0, 1]
    for k in range(_SECTORS):
        R = rotation_exp([0.0, 0.0, 2.0 * half * k])
        if k < _SECTORS // 2:
            size = (float(floor), float(floor * np.tan(half)), float(depth))
            parts.collider(ColliderKind.BOX, size, make_pose(R, [0.0, 0.0, depth]))
        for low, high in pairwise(inner):
            run = (high - low) * [apothem, 1.0]
            length = float(np.linalg.norm(run))
            along = np.array([run[0], 0.0, run[1]]) / length
            across = np.array([along[2], 0.0, -along[0]])  # outwards
            middle = 0.5 * (low + high) * [apothem, 1.0]
            center = np.array([middle[0], 0.0, middle[1]]) + 0.5 * thick_m * across
            size = (0.5 * length, float(apothem * high[0] * np.tan(half)), 0.5 * thick_m)
            turn = R @ np.stack([along, [0.0, 1.0, 0.0], np.cross(along, [0.0, 1.0, 0.0])], axis=1)
            parts.collider(ColliderKind.BOX, size, make_pose(turn, R @ center))


def _asset(asset_id: str, words: str, parts: BodyParts, size: dict[str, float], mass_kg: float) -> AssetModel:
    """Return a container of box colliders, with the density that gives it its mass."""
    volume = sum(8.0 * float(np.prod(collider.size)) for collider in parts.colliders)
    material = Material(density=mass_kg / volume, static_friction=0.9, dynamic_friction=0.8, restitution=0.02)
    return AssetModel(asset_id=asset_id, words=words, bodies=(parts.body("container", material),), size=size)


def _round(
    asset_id: str,
    words: str,
    inner: Array,
    thick_m: float,
    surface: SurfaceFinish,
    mass_kg: float,
    *,
    extra: tuple[Visual, ...] = (),
) -> AssetModel:
    """Return a round vessel from its inner profile (N, 2), from the floor's edge to the rim."""
    along = np.gradient(inner, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    outer = inner + thick_m * np.column_stack([along[:, 1], -along[:, 0]])
    outer[0] = [inner[0, 0] - 0.002, 0.0]
    outer[-1] = inner[-1] + [thick_m, 0.0]
    outer[:, 1] = np.maximum(outer[:, 1], 0.0)
    rim = inner[-1]
    lip = [[rim[0] + 0.5 * thick_m + 0.5 * thick_m * np.cos(a), rim[1] + 0.5 * thick_m * np.sin(a)]
           for a in np.linspace(0.0, np.pi, 7)]  # fmt: skip
    foot = np.array([[0.0, 0.0005], [outer[0, 0] - 0.003, 0.0005], [outer[0, 0], 0.0]])
    profile = np.concatenate([foot, outer[1:-1], lip, inner[-2::-1], [[0.0, inner[0, 1]]]])
    coarse = [0, *range(2, len(inner) - 1, 2), len(inner) - 1]
    parts = BodyParts()
    parts.visual(lathe(profile, sections=56, uv_per_m=6.0), surface)
    parts.visuals += extra
    _add_shell(parts, inner[coarse], thick_m)
    return _asset(
        asset_id,
        words,
        parts,
        {
            "inner_x_m": 2.0 * float(rim[0]),
            "inner_y_m": 2.0 * float(rim[0]),
            "round": 1.0,
            "reach_m": float(rim[0] + thick_m),
            "floor_m": float(inner[0, 1]),
            "rim_m": float(rim[1] + 0.5 * thick_m),
        },
        mass_kg,
    )


def _glazed(rng: np.random.Generator) -> SurfaceFinish:
    """Draw a glazed ceramic surface, plain or speckled."""
    wheel = [(226, 222, 212), (96, 134, 168), (178, 84, 58), (120, 152, 120), (214, 180, 110), (70, 82, 110)]
    color = np.array(wheel[rng.integers(len(wheel))]) * rng.uniform(0.9, 1.08, 3)
    if rng.random() < 0.5:
        image = speckle(rng, color, [0.75 * color, np.minimum(1.12 * color, 255)])
    else:
        image = shade(fill(color, 128), 1.0 + 0.08 * (grains(rng, 128, 6.0) - 0.5))
    return SurfaceFinish(texture=image, roughness=float(rng.uniform(0.2, 0.45)), specular=0.5)


def _bowl(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    rim = float(rng.uniform(0.080, 0.088))
    floor = float(rng.uniform(0.045, 0.054))
    height = float(rng.uniform(0.042, 0.050))
    thick = float(rng.uniform(0.004, 0.006))
    s = np.linspace(0.0, 1.0, 9)
    inner = np.column_stack([floor + (rim - floor) * np.sin(0.5 * np.pi * s), thick + (height - thick) * s**1.6])
    wooden = index % 3 == 2
    surface = SurfaceFinish(texture=wood(rng, str(rng.choice(_WOODS))), roughness=0.5) if wooden else _glazed(rng)
    return _round(asset_id, "wooden bowl" if wooden else "bowl", inner, thick, surface, 0.55)


def _plate(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    rim = float(rng.uniform(0.086, 0.094))
    floor = float(rng.uniform(0.068, 0.074))
    height = float(rng.uniform(0.026, 0.030))
    thick = 0.004
    s = np.linspace(0.0, 1.0, 7)
    inner = np.column_stack([floor + (rim - floor) * s, thick + (height - thick) * s**0.8])
    return _round(asset_id, "deep plate", inner, thick, _glazed(rng), 0.6)


def _basket(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    rim = float(rng.uniform(0.080, 0.088))
    floor = float(rng.uniform(0.068, 0.074))
    height = float(rng.uniform(0.042, 0.050))
    thick = 0.006
    s = np.linspace(0.0, 1.0, 7)
    inner = np.column_stack([floor + (rim - floor) * s**0.8, thick + (height - thick) * s])
    straw = np.array([190, 148, 92]) * rng.uniform(0.75, 1.1)
    surface = SurfaceFinish(texture=woven(rng, straw, 0.72 * straw, threads=24), roughness=0.9)
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    lobes = 0.0008 * np.sin(24.0 * turn)
    around = rim + 0.5 * thick
    braid = sweep(
        np.column_stack([around * np.cos(turn), around * np.sin(turn), height + 0.001 + lobes]),
        np.full(len(turn), 0.0042) + 0.5 * np.abs(lobes),
        sections=10,
        uv_per_m=12.0,
    )
    dark = SurfaceFinish(texture=woven(rng, 0.8 * straw, 0.6 * straw, threads=12), roughness=0.9)
    return _round(asset_id, "basket", inner, thick, surface, 0.5, extra=(Visual(mesh=braid, surface=dark),))


def _tray(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    x = float(rng.uniform(0.145, 0.160))
    y = float(rng.uniform(0.155, 0.170))
    height = float(rng.uniform(0.030, 0.040))
    thick = float(rng.uniform(0.007, 0.010))
    floor = 0.006
    grain = wood(rng, str(rng.choice(_WOODS)))
    if index % 8 >= 4:
        color = np.array([(196, 60, 48), (64, 110, 150), (232, 226, 210)][index % 3], dtype=np.float64)
        grain = shade(fill(color, 256), grain.mean(axis=-1) / grain.mean())
    side = SurfaceFinish(texture=grain, roughness=0.55)
    inside = SurfaceFinish(texture=shade(grain, np.full(grain.shape[:2], 0.86)), roughness=0.7)
    parts = BodyParts()
    parts.box([x, y, floor], [0.0, 0.0, floor / 2.0], inside, bevel_m=0.0)
    for extents, center in _walls(x, y, height, thick):
        parts.box(extents, center, side, bevel_m=0.0016)
    reach = float(np.hypot(x / 2.0 + thick, y / 2.0 + thick))
    return _asset(
        asset_id,
        "tray",
        parts,
        {"inner_x_m": x, "inner_y_m": y, "round": 0.0, "reach_m": reach, "floor_m": floor, "rim_m": height},
        0.6,
    )


def _walls(x: float, y: float, height: float, thick: float) -> list[tuple[list[float], list[float]]]:
    """Return extents and centres of four walls around an interior of `x` by `y`."""
    return [
        wall
        for sign in (-1.0, 1.0)
        for wall in (
            ([thick, y + 2.0 * thick, height], [sign * (x + thick) / 2.0, 0.0, height / 2.0]),
            ([x, thick, height], [0.0, sign * (y + thick) / 2.0, height / 2.0]),
        )
    ]


_STYLES = (_bowl, _basket, _tray, _plate)


def _crate(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    cell = float(rng.uniform(0.082, 0.086))
    deep = float(rng.uniform(0.150, 0.158))
    divider = 0.005
    thick = float(rng.uniform(0.007, 0.009))
    floor = 0.005
    height = float(rng.uniform(0.034, 0.042))
    low = float(rng.uniform(0.018, 0.022))
    wide = COMPARTMENTS * cell + (COMPARTMENTS - 1) * divider
    grain = wood(rng, _WOODS[index % len(_WOODS)])
    side = SurfaceFinish(texture=shade(grain, np.full(grain.shape[:2], rng.uniform(0.85, 1.1))), roughness=0.75)
    dark = SurfaceFinish(texture=shade(grain, np.full(grain.shape[:2], 0.75)), roughness=0.85)
    parts = BodyParts(colliders=[box_collider([deep, wide, floor], [0.0, 0.0, floor / 2.0])])
    for k in range(COMPARTMENTS):  # floor boards, with a gap under each divider
        y = (k - 0.5 * (COMPARTMENTS - 1)) * (cell + divider)
        parts.box([deep, cell, floor], [0.0, y, floor / 2.0], dark, solid=False)
    for k in range(COMPARTMENTS - 1):
        y = (k + 1 - 0.5 * COMPARTMENTS) * (cell + divider)
        parts.box([deep, divider, low], [0.0, y, low / 2.0], side)
    slatted = index % 2 == 0
    for (x, y, _), center in _walls(deep, wide, height, thick):
        parts.colliders.append(box_collider([x, y, height], center))
        for bottom, top in [(0.0, 0.46), (0.54, 1.0)] if slatted else [(0.0, 1.0)]:
            middle = [center[0], center[1], 0.5 * (bottom + top) * height]
            parts.box([x, y, (top - bottom) * height], middle, side, solid=False)
    if slatted:  # corner posts hold the slats
        for sx, sy in product((-1.0, 1.0), repeat=2):
            center = [sx * (deep + thick) / 2.0, sy * (wide + thick) / 2.0, 0.48 * height]
            parts.box([0.6 * thick, 0.6 * thick, 0.96 * height], center, dark, solid=False)
    return _asset(
        asset_id,
        "crate",
        parts,
        {
            "inner_x_m": deep,
            "inner_y_m": wide,
            "outer_x_m": deep + 2.0 * thick,
            "pitch_m": cell + divider,
            "floor_m": floor,
            "rim_m": height,
        },
        1.2,
    )


def compartment_center(size: Callable[[str], float], number: int) -> Array:
    """Return the centre (3,) of a compartment's floor in the crate's frame [m]; compartment 0 is the one towards -y.

    Args:
        size: returns a dimension of the crate by name.
        number: compartment, 0 .. `COMPARTMENTS` - 1.
    """
    return np.array([0.0, (number - 0.5 * (COMPARTMENTS - 1)) * size("pitch_m"), size("floor_m")])


KINDS = {
    "container": lambda id, index, rng: _STYLES[index % len(_STYLES)](id, index // len(_STYLES), rng),
    "crate": _crate,
}
"""Sizes: `inner_x_m` and `inner_y_m` (width at the rim), `round` (1 if these are diameters), `reach_m` (greatest
horizontal distance from the origin), `floor_m`, `rim_m` (heights); of a crate `pitch_m` (distance between
compartments) and `outer_x_m`."""
