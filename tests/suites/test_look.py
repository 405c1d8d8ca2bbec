"""Textures and looks: seamless, reproducible, neither over- nor underexposed."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.scene import look, texture
from kinebench_drake.suites.scene.look import WALL_M, WALL_TOP_M, surroundings
from kinebench_drake.suites.scene.texture import Texture

RED = (170, 50, 50)
SAND = (200, 190, 170)
SLATE = (80, 90, 100)
MAKERS: dict[str, Callable[[np.random.Generator], Texture]] = {
    "wood": lambda rng: texture.wood(rng, "walnut"),
    "planks": lambda rng: texture.planks(rng, "pine", boards=5),
    "parquet": lambda rng: texture.parquet(rng, "beech"),
    "marble": lambda rng: texture.marble(rng, SAND, SLATE),
    "granite": lambda rng: texture.granite(rng, "rose"),
    "concrete": texture.concrete,
    "plaster": texture.plaster,
    "speckle": lambda rng: texture.speckle(rng, SAND, [RED, SLATE]),
    "woven": lambda rng: texture.woven(rng, SAND, SLATE),
    "checks": lambda rng: texture.checks(rng, SAND, SLATE),
    "tartan": lambda rng: texture.tartan(rng, [SAND, SLATE, RED]),
    "stripes": lambda rng: texture.stripes(rng, [SAND, SLATE]),
    "carpet": lambda rng: texture.carpet(rng, SLATE),
    "leather": lambda rng: texture.leather(rng, SLATE),
    "cardboard": texture.cardboard,
    "brushed": texture.brushed,
    "bricks": texture.bricks,
    "tiles": lambda rng: texture.tiles(rng, SAND, other=SLATE),
    **{
        f"wallpaper {motif}": lambda rng, motif=motif: texture.wallpaper(rng, SAND, SLATE, motif)
        for motif in ("dots", "diamonds", "waves", "leaves", "stripes")
    },
}


@pytest.mark.parametrize("name", MAKERS)
def test_textures_tile_without_a_seam_and_repeat_by_seed(name: str) -> None:
    image = MAKERS[name](np.random.default_rng(3))
    assert image.dtype == np.uint8
    assert image.shape == (len(image), len(image), 3)
    assert np.array_equal(image, MAKERS[name](np.random.default_rng(3)))
    for axis in (0, 1):
        values = image.astype(np.float64)
        steps = np.abs(values - np.roll(values, 1, axis)).mean(axis=(1 - axis, 2))
        assert steps[0] <= 1.05 * steps[1:].max()


def test_looks_are_reproducible_and_pairwise_different() -> None:
    for make, sort in ((look.table, "table"), (look.background, "background"), (look.light, "light")):
        looks = [make(look_id) for look_id in look.look_ids(sort)]
        if sort == "light":
            assert looks == [make.__wrapped__(look_id) for look_id in look.look_ids(sort)]
            assert len(set(looks)) == look.LOOKS
            continue
        images = [x.surface.texture if isinstance(x, look.TiledFinish) else x.wall.surface.texture for x in looks]
        again = make.__wrapped__(look.look_ids(sort)[7])
        finish = again if isinstance(again, look.TiledFinish) else again.wall
        assert np.array_equal(finish.surface.texture, images[7])
        assert not any(np.array_equal(a, b) for a, b in combinations(images, 2))


def test_tables_are_neither_dark_nor_as_white_as_the_robot() -> None:
    for look_id in look.look_ids("table"):
        image = look.table(look_id).surface.texture
        assert image is not None
        assert 0.04 < ((image / 255.0) ** 2.2).mean() < 0.45, look_id


def test_lights_come_from_all_sides_above_the_wall_and_are_bright_enough() -> None:
    lights = [look.light(look_id) for look_id in look.look_ids("light")]
    for one in lights:
        key = np.array(one.key_direction)
        on_table = np.array(one.ambient) + np.array(one.key_color) * -key[2] / np.linalg.norm(key)
        assert 0.7 < on_table.mean() < 2.2
        if key[0] > 0.0:  # from behind the robot: the wall throws no shadow on the table
            assert WALL_M + WALL_TOP_M * key[0] / -key[2] < -0.2
            assert -key[2] >= 1.3 * key[0]
    level = np.array([[one.key_direction[0], one.key_direction[1]] for one in lights])
    assert min((level[:, 0] > 0.5).sum(), (level[:, 0] < -0.5).sum()) >= 3
    assert min((level[:, 1] > 0.5).sum(), (level[:, 1] < -0.5).sum()) >= 3
    warmth = np.array([one.key_color[0] / one.key_color[2] for one in lights])
    assert warmth.min() < 0.85
    assert warmth.max() > 1.3


def test_the_table_top_is_at_height_zero() -> None:
    table = surroundings(look.table("table/00"), look.background("background/00"))["table"]
    [top] = table.colliders
    [visual] = table.visuals
    assert top.X_BodyC[2, 3] + top.size[2] == pytest.approx(0.0, abs=1e-12)
    assert (visual.mesh.vertices[:, 2] + visual.X_BodyV[2, 3]).max() == pytest.approx(0.0, abs=1e-12)


def test_an_unknown_look_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="table/23"):
        look.table("table/24")
    with pytest.raises(UsageError, match="background"):
        look.look_ids("sky")
