"""Boxes open at the top, with a lid on a stiff hinge along one upper edge.

The box's frame is at the centre of its bottom: x from the hinge to the front, z up. The lid's frame is at the middle of
the hinge; with the lid shut (joint 0) it is parallel to the box's.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.scene.mesh import BodyParts, cylinder_mesh
from kinebench_drake.suites.scene.model import (
    AssetModel,
    Joint,
    Material,
    RigidBody,
    SurfaceFinish,
    lid_hinge,
    site_at,
)
from kinebench_drake.suites.scene.texture import (
    Texture,
    brushed,
    cardboard,
    checks,
    leather,
    linear_rgb,
    planks,
    stripes,
    wallpaper,
    wood,
)

RIMMED = "box/rimmed"
FLUSH = "box/flush"
"""Kinds of boxes: the lid overhangs the front and the sides, or ends flush with the walls."""
WIDTH_M = (0.14, 0.18)
DEPTH_M = (0.12, 0.145)
HEIGHT_M = (0.085, 0.11)
"""Least and greatest extent of rimmed boxes: along the hinge, from hinge to front, and height without the lid."""
FLUSH_WIDTH_M = (0.11, 0.14)
FLUSH_HEIGHT_M = (0.075, 0.10)
"""The same of flush boxes, narrow enough for the fingers to reach down beside them when they lie."""
OVERHANG_M = (0.010, 0.014)
"""Least and greatest overhang of a rimmed lid at the front and the sides."""
OPEN_RAD = (np.radians(105.0), np.radians(120.0))
"""Least and greatest opening of a lid."""
MATERIALS = ("cardboard", "wood", "plastic", "tin", "leather", "paper")
"""Materials of boxes, assigned in turn."""

_THIN_M = 0.0006  # thickness of linings and labels
_PALETTE = np.array(
    [
        [188, 62, 54], [52, 96, 158], [72, 132, 84], [222, 168, 60], [120, 82, 142], [58, 142, 148],
        [206, 112, 70], [168, 172, 176], [64, 70, 82], [204, 142, 158], [232, 222, 200], [110, 140, 62],
    ],
    dtype=np.float64,
)  # fmt: skip

INSET_M = 0.001
"""Inset of a flush lid at its sides, which is its clearance from the table when the box lies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _BoxDesign:
    """Surfaces and density of a box."""

    walls: SurfaceFinish
    lid: SurfaceFinish
    lining: SurfaceFinish
    trim: SurfaceFinish
    label: bool
    words: str
    density: float


TIGHT = 5.0
"""Factor of the damping of a tight hinge."""


def with_tight_hinge(model: AssetModel) -> AssetModel:
    """Return the same box with a hinge of `TIGHT` times the damping."""
    bodies = tuple(
        body if body.joint is None else replace(body, joint=replace(body.joint, damping=TIGHT * body.joint.damping))
        for body in model.bodies
    )
    return replace(model, bodies=bodies)


def _design(index: int, rng: np.random.Generator) -> _BoxDesign:
    """Draw the surfaces of a box."""
    material = MATERIALS[index % len(MATERIALS)]
    first, second, third = _PALETTE[rng.permutation(len(_PALETTE))[:3]] * rng.uniform(0.85, 1.1, (3, 1))
    plain = partial(SurfaceFinish, roughness=float(rng.uniform(0.35, 0.8)))
    lining = plain(color=linear_rgb(third))
    trim = plain(color=linear_rgb(second))
    steel = SurfaceFinish(color=(0.42, 0.42, 0.44), roughness=0.35, metallic=0.6)
    word = material
    density = 500.0
    match material:
        case "cardboard":
            walls = SurfaceFinish(texture=cardboard(rng), roughness=0.9)
            lid = SurfaceFinish(texture=cardboard(rng), roughness=0.9)
            lining = walls
            density = 350.0
            trim = SurfaceFinish(color=linear_rgb([206, 178, 128]), roughness=0.35)  # tape
        case "wood":
            tree, other = rng.permutation(["oak", "pine", "walnut", "cherry", "teak", "mahogany", "maple"])[:2]
            walls = SurfaceFinish(texture=planks(rng, str(tree), boards=6), roughness=0.6)
            lid = SurfaceFinish(texture=wood(rng, str(other if index % 4 < 2 else tree)), roughness=0.5)
            word = "wooden"
            trim = steel
            density = 600.0
        case "plastic":
            walls = plain(color=linear_rgb(first))
            lid = plain(color=linear_rgb(second))
            trim = plain(color=linear_rgb([236, 236, 232]))
            density = 800.0
        case "tin":
            walls = SurfaceFinish(texture=brushed(rng, 0.75 * first + 40.0), roughness=0.4, metallic=0.35)
            lid = SurfaceFinish(texture=brushed(rng, 0.75 * second + 40.0), roughness=0.35, metallic=0.35)
            lining = SurfaceFinish(texture=brushed(rng), roughness=0.4, metallic=0.5)
            word = "tin"
            density = 900.0
        case "leather":
            walls, lid = (SurfaceFinish(texture=leather(rng, color), roughness=0.55) for color in (first, 0.8 * first))
            trim = steel
        case _:
            walls = SurfaceFinish(texture=_paper(rng, index, first, second), roughness=0.8)
            lid = plain(color=linear_rgb(second))
            word = "gift"
            density = 400.0
    return _BoxDesign(
        walls=walls, lid=lid, lining=lining, trim=trim, label=bool(rng.random() < 0.6), words=word, density=density
    )


def _paper(rng: np.random.Generator, index: int, first: Array, second: Array) -> Texture:
    """Make gift paper in two colours."""
    patterns = (
        lambda: stripes(rng, (first, second)),
        lambda: checks(rng, first, second),
        lambda: wallpaper(rng, second, first, "dots"),
        lambda: wallpaper(rng, first, second, "diamonds"),
    )
    return patterns[index // len(MATERIALS) % len(patterns)]()


def _base(width: float, depth: float, height: float, wall: float, design: _BoxDesign) -> RigidBody:
    x = depth / 2.0
    y = width / 2.0
    t = wall
    parts = BodyParts()
    parts.panel([-x, -y, 0.0], [x, y, t], design.walls)
    parts.panel([-x, -y, t], [-x + t, y, height], design.walls)
    parts.panel([x - t, -y, t], [x, y, height], design.walls)
    parts.panel([-x + t, -y, t], [x - t, -y + t, height], design.walls)
    parts.panel([-x + t, y - t, t], [x - t, y, height], design.walls)
    parts.panel([-x + t, -y + t, t], [x - t, y - t, t + _THIN_M], design.lining, bevel_m=0.0, solid=False)
    if design.label:
        low = [x, -0.22 * width, 0.25 * height]
        parts.panel(low, [x + _THIN_M, 0.22 * width, 0.65 * height], design.trim, bevel_m=0.0, solid=False)
    knuckle = cylinder_mesh(0.0035, 0.2 * width, sections=16)
    R_YZ = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for side in (-1.0, 1.0):
        parts.visual(knuckle, design.trim, make_pose(R_YZ, [-x - 0.001, side * 0.28 * width, height]))
    return parts.body("base", Material(density=design.density))


def _lid(
    length: float, width: float, thick: float, depth: float, wall: float, design: _BoxDesign, joint: Joint
) -> RigidBody:
    parts = BodyParts()
    y = width / 2.0
    inner = 0.5 * width - 2.5 * wall
    parts.panel([0.0, -y, 0.0], [length, y, thick], design.lid, bevel_m=0.0015)
    low = [2.0 * wall, -inner, -_THIN_M]
    high = [depth - 2.0 * wall, inner, 0.0]
    parts.panel(low, high, design.lining, bevel_m=0.0, solid=False)
    if design.label:
        low = [0.35 * length, -y, thick]
        high = [0.55 * length, y, thick + _THIN_M]
        parts.panel(low, high, design.trim, bevel_m=0.0, solid=False)
    return parts.body("lid", Material(density=design.density, static_friction=0.5, dynamic_friction=0.4), joint)


def _box(kind: str, asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    flush = kind == FLUSH
    design = _design(index, rng)
    width = float(rng.uniform(*(FLUSH_WIDTH_M if flush else WIDTH_M)))
    depth = float(rng.uniform(*DEPTH_M))
    height = float(rng.uniform(*(FLUSH_HEIGHT_M if flush else HEIGHT_M)))
    wall = float(rng.uniform(0.004, 0.006))
    thick = float(rng.uniform(0.005, 0.008))
    overhang = float(rng.uniform(*OVERHANG_M))
    front, side = (0.0, -INSET_M) if flush else (overhang, overhang)
    open_rad = float(rng.uniform(*OPEN_RAD))
    p_hinge = [-depth / 2.0, 0.0, height]
    friction = float(rng.uniform(0.0, 0.05))
    joint = lid_hinge(p_hinge, open_rad, friction=friction, damping=float(rng.uniform(0.03, 0.08)))
    return AssetModel(
        asset_id=asset_id,
        words=f"{design.words} box",
        bodies=(
            _base(width, depth, height, wall, design),
            _lid(depth + front, width + 2.0 * side, thick, depth, wall, design, joint),
        ),
        size={
            "width_m": width,
            "depth_m": depth,
            "height_m": height,
            "lid_m": depth + front,
            "lid_thickness_m": thick,
            "overhang_m": front,
            "open_rad": open_rad,
        },
        sites={"hinge": site_at("base", p_hinge)},
    )


KINDS = {name: partial(_box, name) for name in (RIMMED, FLUSH)}
"""Rimmed and flush boxes."""
