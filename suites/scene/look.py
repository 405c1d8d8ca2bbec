"""Looks of the surroundings: seeded libraries of table tops, backgrounds (wall and floor) and lights.

The looks differ in kind, not only in shade. Table tops are neither as white as the robot nor as saturated as the
objects on them; lights come from all sides, and no image is over- or underexposed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.scene import texture
from kinebench_drake.suites.scene.mesh import box_collider, box_visual
from kinebench_drake.suites.scene.model import Material, RigidBody, SurfaceFinish, Visual
from kinebench_drake.suites.scene.texture import Texture
from kinebench_drake.suites.seeding import generator

LOOKS = 24
"""Number of looks of each sort."""
SORTS = ("table", "background", "light")
"""Sorts of looks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TiledFinish:
    """Finish of a table top, wall or floor."""

    surface: SurfaceFinish
    uv_per_m: float
    """Repetitions of the texture per metre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Background:
    """Room behind the robot."""

    wall: TiledFinish
    floor: TiledFinish
    skirting: SurfaceFinish
    """Skirting board along the foot of the wall."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Illumination of the scene."""

    ambient: tuple[float, float, float]
    """Linear RGB of the ambient light."""
    key_direction: tuple[float, float, float]
    """Direction of travel of the main light in B; it casts shadows."""
    key_color: tuple[float, float, float]
    """Linear RGB."""
    fill_direction: tuple[float, float, float]
    """Direction of travel of a weaker light in B, without shadows."""
    fill_color: tuple[float, float, float]
    """Linear RGB."""


_Make = Callable[[np.random.Generator], Texture]
_Recipe = tuple[_Make, float, float]  # image, size of one repetition [m], roughness


def _along_y(make: _Make) -> _Make:
    """Return a recipe of the same image with rows and columns exchanged."""
    return lambda rng: np.ascontiguousarray(make(rng).swapaxes(0, 1))


def _wood(kind: str, length_m: float = 0.5, roughness: float = 0.5) -> _Recipe:
    return _along_y(lambda rng: texture.wood(rng, kind, size=512)), length_m, roughness


def _planks(kind: str, boards: int, length_m: float, roughness: float = 0.6) -> _Recipe:
    return _along_y(lambda rng: texture.planks(rng, kind, boards=boards)), length_m, roughness


_TABLES: tuple[_Recipe, ...] = (
    _planks("oak", 6, 0.8),
    (lambda rng: texture.granite(rng, "grey"), 0.3, 0.35),
    (lambda rng: texture.woven(rng, (84, 104, 128), (116, 134, 154)), 0.14, 0.95),
    _wood("walnut"),
    (lambda rng: texture.speckle(rng, (176, 166, 152), [(120, 84, 66), (96, 100, 104), (206, 198, 182)]), 0.4, 0.45),
    _planks("pine", 4, 0.6),
    (lambda rng: texture.concrete(rng, (136, 134, 130)), 0.9, 0.85),
    (lambda rng: texture.checks(rng, (92, 112, 142), (206, 202, 192)), 0.22, 0.95),
    _wood("beech"),
    (lambda rng: texture.marble(rng, (66, 84, 78), (164, 176, 168)), 0.8, 0.3),
    (lambda rng: texture.leather(rng, (122, 84, 60)), 0.16, 0.55),
    _planks("weathered", 5, 0.7, 0.9),
    (lambda rng: texture.woven(rng, (186, 174, 150), (162, 150, 126)), 0.12, 0.95),
    _wood("teak", 0.4),
    (lambda rng: texture.tiles(rng, (150, 160, 146), (196, 192, 182)), 0.4, 0.35),
    (lambda rng: texture.granite(rng, "beige"), 0.35, 0.4),
    (lambda rng: texture.tartan(rng, [(98, 108, 106), (140, 88, 78), (70, 80, 98), (184, 168, 132)]), 0.3, 0.95),
    _wood("cherry", 0.45, 0.4),
    (lambda rng: texture.speckle(rng, (120, 134, 128), [(92, 108, 104), (160, 168, 158)], cycles=60.0), 0.5, 0.5),
    _planks("ash", 3, 0.5),
    (lambda rng: texture.brushed(rng, (140, 143, 148)), 0.5, 0.45),
    (lambda rng: texture.stripes(rng, [(82, 92, 114), (190, 182, 164)], count=8), 0.4, 0.95),
    (lambda rng: texture.carpet(rng, (118, 96, 108)), 0.35, 1.0),
    (lambda rng: texture.marble(rng, (186, 180, 172), (108, 102, 98)), 0.7, 0.35),
)

_WALLS: tuple[_Recipe, ...] = (
    (lambda rng: texture.plaster(rng, (206, 198, 182)), 0.6, 0.95),
    (lambda rng: texture.bricks(rng), 0.62, 0.95),
    (lambda rng: texture.wallpaper(rng, (172, 180, 168), (140, 154, 140), "leaves"), 0.6, 0.95),
    (lambda rng: texture.plaster(rng, (142, 158, 170)), 0.6, 0.95),
    (lambda rng: texture.concrete(rng), 1.6, 0.95),
    _planks("pine", 6, 0.8, 0.7),
    (lambda rng: texture.wallpaper(rng, (196, 186, 166), (174, 158, 132), "stripes"), 0.8, 0.95),
    (lambda rng: texture.tiles(rng, (188, 196, 192), (150, 150, 146)), 0.6, 0.35),
    (lambda rng: texture.plaster(rng, (176, 124, 98)), 0.6, 0.95),
    (lambda rng: texture.bricks(rng, (198, 194, 186), (178, 174, 166)), 0.62, 0.9),
    (lambda rng: texture.wallpaper(rng, (116, 130, 150), (146, 158, 172), "dots"), 0.5, 0.95),
    (lambda rng: texture.plaster(rng, (160, 168, 142)), 0.6, 0.95),
    _wood("walnut", 0.9, 0.6),
    (lambda rng: texture.plaster(rng, (196, 172, 120)), 0.6, 0.95),
    (lambda rng: texture.wallpaper(rng, (184, 164, 158), (160, 134, 130), "diamonds"), 0.6, 0.95),
    (lambda rng: texture.plaster(rng, (92, 98, 106)), 0.6, 0.95),
    (lambda rng: texture.tiles(rng, (88, 126, 126), (186, 186, 178), other=(112, 146, 142)), 0.8, 0.35),
    (lambda rng: texture.bricks(rng, (164, 148, 122), (142, 136, 126), rows=10), 0.7, 0.95),
    (lambda rng: texture.plaster(rng, (194, 164, 160)), 0.6, 0.95),
    _planks("weathered", 5, 0.8, 0.9),
    (lambda rng: texture.wallpaper(rng, (190, 188, 178), (150, 164, 174), "waves"), 0.7, 0.95),
    (lambda rng: texture.speckle(rng, (172, 136, 98), [(136, 98, 64), (194, 162, 122)], cycles=30.0), 0.5, 0.95),
    (_along_y(lambda rng: texture.stripes(rng, [(176, 186, 190), (150, 166, 174)], count=4)), 1.2, 0.95),
    (lambda rng: texture.marble(rng, (192, 184, 172), (138, 126, 112)), 1.6, 0.4),
)

_FLOORS: tuple[_Recipe, ...] = (
    (lambda rng: texture.planks(rng, "oak"), 0.7, 0.6),
    (lambda rng: texture.concrete(rng, (132, 130, 126)), 1.6, 0.9),
    (lambda rng: texture.parquet(rng, "oak"), 1.0, 0.5),
    (lambda rng: texture.carpet(rng, (140, 128, 112)), 0.6, 1.0),
    (lambda rng: texture.tiles(rng, (128, 124, 118)), 1.6, 0.4),
    (lambda rng: texture.planks(rng, "walnut"), 0.7, 0.5),
    (lambda rng: texture.speckle(rng, (140, 140, 130), [(110, 112, 104), (168, 166, 152)]), 0.5, 0.5),
    (lambda rng: texture.tiles(rng, (186, 180, 168), (120, 118, 114), other=(84, 86, 90)), 1.4, 0.4),
    (lambda rng: texture.planks(rng, "pine"), 0.7, 0.6),
    (lambda rng: texture.carpet(rng, (92, 100, 114)), 0.6, 1.0),
    (lambda rng: texture.parquet(rng, "cherry"), 1.0, 0.5),
    (lambda rng: texture.granite(rng, "rose"), 0.5, 0.4),
)
_SKIRTINGS = ((0.55, 0.54, 0.51), (0.2, 0.11, 0.06), (0.12, 0.12, 0.13), (0.36, 0.25, 0.15))

_SIDES_RAD = {"front": 0.0, "front left": 0.8, "left": 1.6, "behind left": 2.5, "behind": np.pi}
_SIDES_RAD |= {"behind right": -2.5, "right": -1.6, "front right": -0.8}
_LIGHTS: tuple[tuple[str, float, float, float, float], ...] = (  # from, slope, strength, ambient, warmth -1..1
    ("front left", 1.6, 1.5, 0.32, 0.0),
    ("right", 1.0, 1.6, 0.3, 0.7),
    ("front", 5.0, 1.3, 0.36, -0.3),
    ("left", 1.2, 1.5, 0.26, 0.4),
    ("behind right", 1.7, 1.5, 0.36, 0.2),
    ("front right", 1.2, 1.7, 0.24, -0.7),
    ("left", 4.0, 1.0, 0.5, 0.1),
    ("front", 1.4, 1.5, 0.3, 0.9),
    ("right", 1.7, 1.3, 0.34, -0.5),
    ("behind left", 1.6, 1.7, 0.3, 0.8),
    ("front left", 1.0, 1.8, 0.2, 0.3),
    ("right", 6.0, 1.5, 0.28, 0.6),
    ("front right", 2.4, 1.1, 0.44, 0.0),
    ("left", 0.9, 1.7, 0.34, -0.9),
    ("behind", 2.2, 1.5, 0.34, -0.2),
    ("front", 2.2, 1.2, 0.26, -0.6),
    ("right", 1.3, 1.3, 0.25, 0.3),
    ("front left", 2.6, 1.6, 0.3, 0.8),
    ("left", 1.6, 1.2, 0.24, -0.3),
    ("front right", 1.5, 1.4, 0.38, 0.5),
    ("behind left", 2.4, 1.2, 0.42, -0.6),
    ("front", 8.0, 1.0, 0.22, 0.2),
    ("right", 2.6, 1.7, 0.26, -0.1),
    ("front left", 1.3, 1.1, 0.22, -0.8),
)


def look_ids(sort: str) -> tuple[str, ...]:
    """Return the ids of a sort's looks, such as "table/03".

    Raises:
        UsageError: the sort is unknown.
    """
    if sort not in SORTS:
        raise UsageError(f"no sort of look {sort!r}; there are {', '.join(SORTS)}")
    return tuple(f"{sort}/{i:02d}" for i in range(LOOKS))


def _find(sort: str, look_id: str) -> tuple[int, np.random.Generator]:
    """Return the number of a look and its random generator; raise UsageError if the id is unknown."""
    ids = look_ids(sort)
    if look_id not in ids:
        raise UsageError(f"no {sort} {look_id!r}; there are {ids[0]} to {ids[-1]}")
    return ids.index(look_id), generator("look", look_id)


def _finish(recipe: _Recipe, rng: np.random.Generator) -> TiledFinish:
    make, length_m, roughness = recipe
    return TiledFinish(surface=SurfaceFinish(texture=make(rng), roughness=roughness), uv_per_m=1.0 / length_m)


@lru_cache(maxsize=64)
def table(look_id: str) -> TiledFinish:
    """Make the table top with an id.

    Raises:
        UsageError: the id is unknown.
    """
    index, rng = _find("table", look_id)
    return _finish(_TABLES[index], rng)


@lru_cache(maxsize=64)
def background(look_id: str) -> Background:
    """Make the background with an id.

    Raises:
        UsageError: the id is unknown.
    """
    index, rng = _find("background", look_id)
    return Background(
        wall=_finish(_WALLS[index], rng),
        floor=_finish(_FLOORS[index % len(_FLOORS)], rng),
        skirting=SurfaceFinish(color=_SKIRTINGS[index % len(_SKIRTINGS)], roughness=0.5),
    )


def _tint(strength: float, warmth: float) -> tuple[float, float, float]:
    """Return the linear RGB of a light from bluish (-1) to reddish (1), for a camera balanced in between."""
    return strength * (1.0 + 0.13 * warmth), strength * (1.0 - 0.03 * abs(warmth)), strength * (1.0 - 0.36 * warmth)


@lru_cache(maxsize=64)
def light(look_id: str) -> Light:
    """Make the light with an id.

    Raises:
        UsageError: the id is unknown.
    """
    index, rng = _find("light", look_id)
    side, slope, strength, ambient, warmth = _LIGHTS[index]
    azimuth = _SIDES_RAD[side] + float(rng.uniform(-0.25, 0.25))
    behind = side.startswith("behind")
    other = (0.4 if behind else 0.3) * strength
    return Light(
        ambient=_tint(ambient, 0.4 * warmth),
        key_direction=(-float(np.cos(azimuth)), -float(np.sin(azimuth)), -slope),
        key_color=_tint(strength, warmth),
        fill_direction=(-1.0, 0.8 * float(np.sin(azimuth)), -0.7),
        fill_color=_tint(other, 0.4 * warmth),
    )


TABLE_SIZE_M = (1.5, 2.4, 0.04)
"""Extents along x, y, z."""
TABLE_CENTER_M = (0.55, 0.0, -0.02)
"""Centre in B; the top is z = 0."""
FLOOR_M = -0.75
"""z of the floor."""
WALL_M = -2.8
"""x of the wall behind the robot."""
WALL_TOP_M = 1.3
"""z of the wall's upper edge: out of view, and low enough for light from behind the wall."""
SKIRTING_M = (0.03, 8.0, 0.09)
"""Extents of the skirting board along the foot of the wall."""
_ROOM_M = 8.0


def _slab(size: tuple[float, float, float], center: tuple[float, float, float], look: TiledFinish) -> Visual:
    return box_visual(size, center, look.surface, bevel_m=0.0, uv_per_m=look.uv_per_m)


def surroundings(table: TiledFinish, background: Background) -> dict[str, RigidBody]:
    """Return the static bodies of table, wall and floor by name, in B."""
    wall_height_m, foot_m = WALL_TOP_M - FLOOR_M, FLOOR_M + 0.5 * SKIRTING_M[2]
    skirting = TiledFinish(surface=background.skirting, uv_per_m=1.0)
    return {
        "table": RigidBody(
            name="table",
            visuals=(_slab(TABLE_SIZE_M, TABLE_CENTER_M, table),),
            colliders=(box_collider(TABLE_SIZE_M, TABLE_CENTER_M),),
            material=Material(static_friction=0.6, dynamic_friction=0.5, restitution=0.0),
        ),
        "wall": RigidBody(
            name="wall",
            visuals=(
                _slab(
                    (0.1, _ROOM_M, wall_height_m), (WALL_M - 0.05, 0.0, FLOOR_M + 0.5 * wall_height_m), background.wall
                ),
                _slab(SKIRTING_M, (WALL_M, 0.0, foot_m), skirting),
            ),
        ),
        "floor": RigidBody(
            name="floor",
            visuals=(_slab((_ROOM_M, _ROOM_M, 0.1), (WALL_M + 0.5 * _ROOM_M, 0.0, FLOOR_M - 0.05), background.floor),),
        ),
    }
