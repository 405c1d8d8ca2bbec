"""Looks of the place: table tops, backgrounds (wall and floor) and lights, each a seeded library."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.assets.model import Surface
from kinebench_drake.suites.assets.texture import blend, tileable_noise
from kinebench_drake.suites.seeding import generator

LOOKS = 24
"""Looks of each sort."""
SORTS = ("table", "background", "light")
"""Sorts of looks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """How the table top looks."""

    surface: Surface
    uv_per_m: float
    """Repetitions of the texture a metre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Background:
    """What is behind the robot."""

    wall: Surface
    floor: Surface
    uv_per_m: float
    """Repetitions of both textures a metre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Where light comes from."""

    ambient: tuple[float, float, float]
    """Linear RGB from everywhere."""
    key_direction: tuple[float, float, float]
    """The way the brightest light goes, in B; it casts shadows."""
    key_color: tuple[float, float, float]
    """Its linear RGB."""
    fill_direction: tuple[float, float, float]
    """The way a weaker light goes, without shadows."""
    fill_color: tuple[float, float, float]
    """Its linear RGB."""


def look_ids(sort: str) -> tuple[str, ...]:
    """The ids of a sort's looks, such as "table/03".

    Raises:
        UsageError: there is no such sort.
    """
    if sort not in SORTS:
        raise UsageError(f"no sort of look {sort!r}; there are {', '.join(SORTS)}")
    return tuple(f"{sort}/{i:02d}" for i in range(LOOKS))


def _rng(sort: str, look_id: str) -> np.random.Generator:
    ids = look_ids(sort)
    if look_id not in ids:
        raise UsageError(f"no {sort} {look_id!r}; there are {ids[0]} to {ids[-1]}")
    return generator("look", look_id)


@lru_cache(maxsize=64)
def table(look_id: str) -> Table:
    """The table top of an id.

    Raises:
        UsageError: there is none.
    """
    rng = _rng("table", look_id)
    image = blend(rng.uniform(60, 160, 3), rng.uniform(120, 230, 3), tileable_noise(rng, 256, stretch=8.0))
    return Table(surface=Surface(texture=image, roughness=float(rng.uniform(0.4, 0.9))), uv_per_m=1.5)


@lru_cache(maxsize=64)
def background(look_id: str) -> Background:
    """The background of an id.

    Raises:
        UsageError: there is none.
    """
    rng = _rng("background", look_id)
    wall = blend(rng.uniform(120, 200, 3), rng.uniform(160, 240, 3), tileable_noise(rng, 256))
    floor = blend(rng.uniform(60, 120, 3), rng.uniform(100, 180, 3), tileable_noise(rng, 256))
    return Background(
        wall=Surface(texture=wall, roughness=0.95), floor=Surface(texture=floor, roughness=0.8), uv_per_m=0.7
    )


@lru_cache(maxsize=64)
def light(look_id: str) -> Light:
    """The light of an id.

    Raises:
        UsageError: there is none.
    """
    rng = _rng("light", look_id)
    tint = rng.uniform(0.85, 1.0, 3)
    azimuth = rng.uniform(-np.pi, np.pi)
    key = rng.uniform(0.9, 1.5) * tint
    ambient = rng.uniform(0.22, 0.4)
    return Light(
        ambient=(ambient, ambient, ambient),
        key_direction=(float(np.cos(azimuth)), float(np.sin(azimuth)), float(-rng.uniform(1.3, 2.2))),
        key_color=(float(key[0]), float(key[1]), float(key[2])),
        fill_direction=(-1.0, 0.0, -0.7),
        fill_color=(0.35, 0.35, 0.35),
    )
