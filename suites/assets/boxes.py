"""Boxes with hinged lids: open on top, the lid on a stiff hinge along one upper edge.

A box's frame lies in the middle of its bottom: x from the hinge to the front, z up. Its lid's frame lies in the middle
of the hinge; with the lid shut (joint 0) it is parallel to the box's.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.assets.mesh import Parts, cylinder_mesh
from kinebench_drake.suites.assets.model import (
    AssetKind,
    Body,
    Joint,
    JointKind,
    Material,
    Model,
    Site,
    SurfaceFinish,
    Visual,
)
from kinebench_drake.suites.assets.texture import (
    Texture,
    brushed,
    cardboard,
    checks,
    leather,
    planks,
    stripes,
    wallpaper,
    wood,
)

RIMMED, FLUSH = "box/rimmed", "box/flush"
"""Boxes whose lid stands out over the front and the sides, and boxes whose lid ends with the walls."""
WIDTH_M, DEPTH_M, HEIGHT_M = (0.14, 0.18), (0.12, 0.145), (0.085, 0.11)
"""Least and greatest size along the hinge, from the hinge to the front, and without the lid, of rimmed boxes."""
FLUSH_WIDTH_M, FLUSH_HEIGHT_M = (0.11, 0.14), (0.075, 0.10)
"""The same of flush boxes, which are narrow enough for the fingers to reach down beside them when they lie."""
OVERHANG_M = (0.010, 0.014)
"""How far a rimmed lid stands out over the front and the sides."""
INSET_M = 0.001
"""How far a flush lid stays behind the walls at its sides: what it clears the table by when the box lies."""
OPEN_RAD = (np.radians(105.0), np.radians(120.0))
"""Where the stop of a lid is."""
MATERIALS = ("cardboard", "wood", "plastic", "tin", "leather", "paper")
"""What boxes are made of, in turn."""
TIGHT = 5.0
"""How much harder a tight hinge moves."""

_R_HINGE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # x along -y of the box: up is positive
_THIN_M = 0.0006  # of linings and labels
_PALETTE = np.array(
    [
        [188, 62, 54], [52, 96, 158], [72, 132, 84], [222, 168, 60], [120, 82, 142], [58, 142, 148],
        [206, 112, 70], [168, 172, 176], [64, 70, 82], [204, 142, 158], [232, 222, 200], [110, 140, 62],
    ],
    dtype=np.float64,
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """Surfaces of a box's parts."""

    walls: SurfaceFinish
    lid: SurfaceFinish
    lining: SurfaceFinish
    trim: SurfaceFinish
    label: bool
    words: str
    density: float


def tight(model: Model) -> Model:
    """The same box with a hinge that moves `TIGHT` times as hard."""
    bodies = tuple(
        body if body.joint is None else replace(body, joint=replace(body.joint, damping=TIGHT * body.joint.damping))
        for body in model.bodies
    )
    return replace(model, bodies=bodies)


def _color(srgb: ArrayLike) -> tuple[float, float, float]:
    """Linear RGB of an sRGB colour (3,) 0..255."""
    r, g, b = (np.asarray(srgb, dtype=np.float64) / 255.0) ** 2.2
    return float(r), float(g), float(b)


def _look(index: int, rng: np.random.Generator) -> _Look:
    material = MATERIALS[index % len(MATERIALS)]
    first, second, third = _PALETTE[rng.permutation(len(_PALETTE))[:3]] * rng.uniform(0.85, 1.1, (3, 1))
    plain = partial(SurfaceFinish, roughness=float(rng.uniform(0.35, 0.8)))
    lining, trim = plain(color=_color(third)), plain(color=_color(second))
    steel = SurfaceFinish(color=(0.42, 0.42, 0.44), roughness=0.35, metallic=0.6)
    word, density = material, 500.0
    match material:
        case "cardboard":
            walls = SurfaceFinish(texture=cardboard(rng), roughness=0.9)
            lid, lining, density = SurfaceFinish(texture=cardboard(rng), roughness=0.9), walls, 350.0
            trim = SurfaceFinish(color=_color([206, 178, 128]), roughness=0.35)  # tape
        case "wood":
            tree, other = rng.permutation(["oak", "pine", "walnut", "cherry", "teak", "mahogany", "maple"])[:2]
            walls = SurfaceFinish(texture=planks(rng, str(tree), boards=6), roughness=0.6)
            lid = SurfaceFinish(texture=wood(rng, str(other if index % 4 < 2 else tree)), roughness=0.5)
            word, trim, density = "wooden", steel, 600.0
        case "plastic":
            walls, lid = plain(color=_color(first)), plain(color=_color(second))
            trim, density = plain(color=_color([236, 236, 232])), 800.0
        case "tin":
            walls = SurfaceFinish(texture=_tin(rng, first), roughness=0.4, metallic=0.35)
            lid = SurfaceFinish(texture=_tin(rng, second), roughness=0.35, metallic=0.35)
            lining, word, density = SurfaceFinish(texture=brushed(rng), roughness=0.4, metallic=0.5), "tin", 900.0
        case "leather":
            walls, lid = (SurfaceFinish(texture=leather(rng, color), roughness=0.55) for color in (first, 0.8 * first))
            trim = steel
        case _:
            pattern = _paper(rng, index, first, second)
            walls, lid = SurfaceFinish(texture=pattern, roughness=0.8), plain(color=_color(second))
            word, density = "gift", 400.0
    return _Look(
        walls=walls, lid=lid, lining=lining, trim=trim, label=bool(rng.random() < 0.6), words=word, density=density
    )


def _tin(rng: np.random.Generator, color: Array) -> Texture:
    return brushed(rng, 0.75 * color + 40.0)


def _paper(rng: np.random.Generator, index: int, first: Array, second: Array) -> Texture:
    match index // len(MATERIALS) % 4:
        case 0:
            return stripes(rng, (first, second))
        case 1:
            return checks(rng, first, second)
        case 2:
            return wallpaper(rng, second, first, "dots")
        case _:
            return wallpaper(rng, first, second, "diamonds")


def _base(width: float, depth: float, height: float, wall: float, look: _Look, density: float) -> Body:
    x, y, t = depth / 2.0, width / 2.0, wall
    parts = Parts()
    parts.panel([-x, -y, 0.0], [x, y, t], look.walls)
    parts.panel([-x, -y, t], [-x + t, y, height], look.walls)
    parts.panel([x - t, -y, t], [x, y, height], look.walls)
    parts.panel([-x + t, -y, t], [x - t, -y + t, height], look.walls)
    parts.panel([-x + t, y - t, t], [x - t, y, height], look.walls)
    parts.panel([-x + t, -y + t, t], [x - t, y - t, t + _THIN_M], look.lining, bevel_m=0.0, solid=False)
    if look.label:
        low, high = [x, -0.22 * width, 0.25 * height], [x + _THIN_M, 0.22 * width, 0.65 * height]
        parts.panel(low, high, look.trim, bevel_m=0.0, solid=False)
    knuckle = cylinder_mesh(0.0035, 0.2 * width, sections=16)
    R_YZ = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for side in (-1.0, 1.0):
        X = make_pose(R_YZ, [-x - 0.001, side * 0.28 * width, height])
        parts.visuals.append(Visual(mesh=knuckle, surface=look.trim, X_BodyV=X))
    return parts.body("base", Material(density=density))


def _lid(length: float, width: float, thick: float, depth: float, look: _Look, joint: Joint, wall: float) -> Body:
    parts, y, inner = Parts(), width / 2.0, 0.5 * width - 2.5 * wall
    parts.panel([0.0, -y, 0.0], [length, y, thick], look.lid, bevel_m=0.0015)
    low, high = [2.0 * wall, -inner, -_THIN_M], [depth - 2.0 * wall, inner, 0.0]
    parts.panel(low, high, look.lining, bevel_m=0.0, solid=False)
    if look.label:
        low, high = [0.35 * length, -y, thick], [0.55 * length, y, thick + _THIN_M]
        parts.panel(low, high, look.trim, bevel_m=0.0, solid=False)
    return parts.body("lid", Material(density=look.density, static_friction=0.5, dynamic_friction=0.4), joint)


def _box(kind: str, asset_id: str, index: int, rng: np.random.Generator) -> Model:
    flush, look = kind == FLUSH, _look(index, rng)
    width = float(rng.uniform(*(FLUSH_WIDTH_M if flush else WIDTH_M)))
    depth = float(rng.uniform(*DEPTH_M))
    height = float(rng.uniform(*(FLUSH_HEIGHT_M if flush else HEIGHT_M)))
    wall, thick = float(rng.uniform(0.004, 0.006)), float(rng.uniform(0.005, 0.008))
    overhang = float(rng.uniform(*OVERHANG_M))
    front, side = (0.0, -INSET_M) if flush else (overhang, overhang)
    open_rad = float(rng.uniform(*OPEN_RAD))
    at_hinge = [-depth / 2.0, 0.0, height]
    joint = Joint(
        kind=JointKind.HINGE,
        X_ParentJ=make_pose(_R_HINGE, at_hinge),
        X_BodyJ=make_pose(_R_HINGE, np.zeros(3)),
        lower=0.0,
        upper=open_rad,
        friction=float(rng.uniform(0.0, 0.05)),
        damping=float(rng.uniform(0.03, 0.08)),
    )
    return Model(
        kind=kind,
        asset_id=asset_id,
        words=f"{look.words} box",
        bodies=(
            _base(width, depth, height, wall, look, look.density),
            _lid(depth + front, width + 2.0 * side, thick, depth, look, joint, wall),
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
        sites={"hinge": Site(body="base", X_BodyS=make_pose(np.eye(3), at_hinge))},
    )


KINDS = tuple(AssetKind(name=name, make=partial(_box, name)) for name in (RIMMED, FLUSH))
"""Kinds of this family."""
