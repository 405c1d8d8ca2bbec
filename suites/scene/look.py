"""Looks of the surroundings: seeded libraries of table tops, backgrounds (wall and floor) and lights, in looks.json.

The looks differ in kind, not only in shade. Table tops are neither as white as the robot nor as saturated as the
objects on them; lights come from all sides, and no image is over- or underexposed.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from pydantic import TypeAdapter

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


_TEXTURES: Mapping[str, Callable[..., Texture]] = {
    make.__name__: make
    for make in (
        *(texture.bricks, texture.brushed, texture.carpet, texture.checks, texture.concrete, texture.granite),
        *(texture.leather, texture.marble, texture.parquet, texture.planks, texture.plaster, texture.speckle),
        *(texture.stripes, texture.tartan, texture.tiles, texture.wallpaper, texture.wood, texture.woven),
    )
}
"""Textures by their name in looks.json."""
_SIDES_RAD = {"front": 0.0, "front left": 0.8, "left": 1.6, "behind left": 2.5, "behind": np.pi}
_SIDES_RAD |= {"behind right": -2.5, "right": -1.6, "front right": -0.8}


@dataclass(frozen=True, slots=True, kw_only=True)
class _FinishRecipe:
    """Finish of a table top, wall or floor in looks.json."""

    texture: str
    """One of `_TEXTURES`."""
    arguments: dict[str, Any]
    """Its arguments other than the random generator."""
    size_m: float
    """Size of one repetition."""
    roughness: float
    along_y: bool = False
    """True if rows and columns are exchanged."""

    def finish(self, rng: np.random.Generator) -> TiledFinish:
        """Make the finish."""
        image = _TEXTURES[self.texture](rng, **self.arguments)
        if self.along_y:
            image = np.ascontiguousarray(image.swapaxes(0, 1))
        return TiledFinish(surface=SurfaceFinish(texture=image, roughness=self.roughness), uv_per_m=1.0 / self.size_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class _LightRecipe:
    """Light in looks.json."""

    side: str
    """Where the main light comes from, one of `_SIDES_RAD`."""
    slope: float
    """Tangent of its elevation."""
    strength: float
    ambient: float
    warmth: float
    """Colour from bluish (-1) to reddish (1)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Recipes:
    """Content of looks.json; each sort of look cycles through its lists."""

    tables: list[_FinishRecipe]
    walls: list[_FinishRecipe]
    floors: list[_FinishRecipe]
    skirtings: list[tuple[float, float, float]]
    """Linear RGB."""
    lights: list[_LightRecipe]


@lru_cache
def _recipes() -> _Recipes:
    text = (files("kinebench_drake.suites") / "data" / "looks.json").read_text(encoding="utf-8")
    return TypeAdapter(_Recipes).validate_json(text)


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


@lru_cache(maxsize=64)
def table(look_id: str) -> TiledFinish:
    """Make the table top with an id."""
    index, rng = _find("table", look_id)
    return _recipes().tables[index].finish(rng)


@lru_cache(maxsize=64)
def background(look_id: str) -> Background:
    """Make the background with an id."""
    index, rng = _find("background", look_id)
    recipes = _recipes()
    return Background(
        wall=recipes.walls[index].finish(rng),
        floor=recipes.floors[index % len(recipes.floors)].finish(rng),
        skirting=SurfaceFinish(color=recipes.skirtings[index % len(recipes.skirtings)], roughness=0.5),
    )


def _tint(strength: float, warmth: float) -> tuple[float, float, float]:
    """Return the linear RGB of a light from bluish (-1) to reddish (1), for a camera balanced in between."""
    return strength * (1.0 + 0.13 * warmth), strength * (1.0 - 0.03 * abs(warmth)), strength * (1.0 - 0.36 * warmth)


@lru_cache(maxsize=64)
def light(look_id: str) -> Light:
    """Make the light with an id."""
    index, rng = _find("light", look_id)
    recipe = _recipes().lights[index]
    azimuth = _SIDES_RAD[recipe.side] + float(rng.uniform(-0.25, 0.25))
    other = (0.4 if recipe.side.startswith("behind") else 0.3) * recipe.strength
    return Light(
        ambient=_tint(recipe.ambient, 0.4 * recipe.warmth),
        key_direction=(-float(np.cos(azimuth)), -float(np.sin(azimuth)), -recipe.slope),
        key_color=_tint(recipe.strength, recipe.warmth),
        fill_direction=(-1.0, 0.8 * float(np.sin(azimuth)), -0.7),
        fill_color=_tint(other, 0.4 * recipe.warmth),
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
    wall_height_m = WALL_TOP_M - FLOOR_M
    foot_m = FLOOR_M + 0.5 * SKIRTING_M[2]
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
