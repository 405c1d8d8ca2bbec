"""Laptops: a base with keyboard and touchpad, and a lid with a screen on a stiff hinge.

The laptop's x axis points from the hinge to the user, y along the hinge, z up from the table. The lid has its origin on
the hinge's axis and x towards its free edge; at joint position 0 it is shut.
"""

from itertools import product

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.scene.mesh import BodyParts, cylinder_mesh, flat_mesh, smooth_mesh
from kinebench_drake.suites.scene.model import AssetModel, Material, Mesh, SurfaceFinish, lid_hinge, site_at
from kinebench_drake.suites.scene.texture import gradient, rgb, tileable_noise

WIDTH_M = (0.20, 0.25)
DEPTH_M = (0.135, 0.16)
"""Least and greatest extents of the base along and across the hinge."""
BASE_M = (0.0145, 0.0165)
FEET_M = (0.003, 0.004)
LID_M = (0.006, 0.0075)
"""Least and greatest thickness of base and lid, and height of the feet."""
GREATEST_RAD = np.deg2rad(130.0)
"""Upper limit of the hinge."""
HINGE_FROM_BACK_M = 0.006
HINGE_ABOVE_BASE_M = 0.003
GAP_M = 0.0005
"""Position of the hinge's axis, and the gap between base and shut lid."""
COLORS = {
    "silver": (0.60, 0.61, 0.63),
    "grey": (0.16, 0.165, 0.175),
    "black": (0.018, 0.018, 0.02),
    "white": (0.78, 0.78, 0.76),
    "blue": (0.03, 0.10, 0.32),
    "red": (0.38, 0.03, 0.035),
    "green": (0.05, 0.20, 0.13),
    "golden": (0.55, 0.40, 0.24),
}
"""Linear RGB of the cases, assigned in turn."""
LOGOS = ("disc", "ring", "hexagon", "square", "triangle", "star")
"""Shapes on the lid's back, assigned in turn."""

_SKIN_M = 0.0003  # distance of decals from the surface below
LIP_M = (0.0085, 0.011)
"""Least and greatest overhang of the lid over the base, under which a fingertip fits."""


def _rounded(low: ArrayLike, high: ArrayLike, z_m: float, radius_m: float) -> Array:
    """Return the outline (N, 3) of a horizontal rectangle with round corners, counter-clockwise seen from above."""
    (x0, y0) = np.asarray(low, dtype=np.float64) + radius_m
    (x1, y1) = np.asarray(high, dtype=np.float64) - radius_m
    quarter = np.linspace(0.0, np.pi / 2.0, 8)
    corners = [
        np.array([x, y]) + radius_m * np.column_stack([np.cos(turn + quarter), np.sin(turn + quarter)])
        for x, y, turn in ((x1, y1, 0.0), (x0, y1, np.pi / 2), (x0, y0, np.pi), (x1, y0, 1.5 * np.pi))
    ]
    xy = np.concatenate(corners)
    return np.column_stack([xy, np.full(len(xy), z_m)])


def _slab(points: Array, surface: SurfaceFinish) -> BodyParts:
    """Return the convex hull of points (N, 3) with smooth normals, as visual and collider."""
    hull = trimesh.convex.convex_hull(points)
    vertices = np.asarray(hull.vertices, dtype=np.float64)
    parts = BodyParts(uv_per_m=1.0)
    parts.visual(smooth_mesh(vertices, np.asarray(hull.faces), vertices[:, :2], crease_rad=0.5), surface)
    parts.hull(points)
    return parts


def _sheet(low: ArrayLike, high: ArrayLike, z_m: float, *, up: bool = True) -> Mesh:
    """Return a horizontal rectangle with texture coordinates 0..1, upright for a viewer looking along -x.

    `up`: True to face up; else it faces down, and as the lid's inside is upright for the user.
    """
    (x0, y0) = np.asarray(low, dtype=np.float64)
    (x1, y1) = np.asarray(high, dtype=np.float64)
    vertices = np.array([[x0, y0, z_m], [x1, y0, z_m], [x1, y1, z_m], [x0, y1, z_m]])
    uv = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])  # the first row of the image is at 0
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    if not up:
        faces = faces[:, ::-1]
        uv = uv * [1.0, -1.0] + [0.0, 1.0]
    return Mesh(vertices=vertices, faces=faces, normals=np.tile([0.0, 0.0, 1.0 if up else -1.0], (4, 1)), uv=uv)


def _keyboard(size_m: tuple[float, float], keys: ArrayLike, well: ArrayLike, marks: ArrayLike) -> NDArray[np.uint8]:
    """Draw a keyboard of depth and width `size_m`: five rows of keys with marks; sRGB colours 0..255."""
    height, width = (int(2000.0 * s) for s in size_m)
    image = np.empty((height, width, 3))
    image[:] = well
    rows: tuple[tuple[float, ...], ...] = (
        (1,) * 14,
        (1.5, *(1,) * 11, 1.5),
        (1.8, *(1,) * 10, 2.2),
        (2.3, *(1,) * 9, 2.7),
        (1, 1, 1.3, 5.4, 1.3, 1, 1, 1, 1),
    )
    gap = 3
    for i, row in enumerate(rows):
        top = round(gap + i * (height - gap) / 5)
        bottom = round((i + 1) * (height - gap) / 5)
        edges = np.round(gap + np.concatenate([[0.0], np.cumsum(row)]) / sum(row) * (width - gap)).astype(int)
        for left, right in zip(edges[:-1], edges[1:] - gap, strict=True):
            image[top:bottom, left:right] = keys
            if right - left < 3 * (bottom - top):
                y = (top + bottom) // 2
                x = (left + right) // 2
                image[y - 4 : y + 4, x - 1 : x + 1] = marks
                image[y - 4 : y - 2, x - 3 : x + 3] = marks
    return np.asarray(np.clip(image, 0, 255), dtype=np.uint8)


def _desktop(rng: np.random.Generator, index: int) -> NDArray[np.uint8]:
    """Draw a screen: a wallpaper with a task bar, icons and one or two windows."""
    height = 256
    width = 410
    wallpaper = gradient((rng.uniform(10, 120, 3), rng.uniform(120, 250, 3)), tileable_noise(rng, height, slope=2.2))
    image = np.repeat(wallpaper.astype(np.float64), 2, axis=1)[:, :width]
    image[-14:] = 0.25 * image[-14:] + 0.75 * np.array([30.0, 32.0, 38.0])
    for i in range(int(rng.integers(5, 10))):
        image[-11:-3, 8 + 14 * i : 16 + 14 * i] = rng.uniform(90, 255, 3)
    for i in range(int(rng.integers(3, 7))):
        image[12 + 28 * i : 26 + 28 * i, 12:26] = rng.uniform(60, 255, 3)
    for _ in range(1 + index % 2):
        y = int(rng.integers(12, 90))
        x = int(rng.integers(40, 230))
        h = min(int(rng.integers(90, 150)), height - 20 - y)
        w = min(int(rng.integers(120, 200)), width - 8 - x)
        image[y : y + h, x : x + w] = rng.uniform(225, 250)
        image[y : y + 12, x : x + w] = rng.uniform(50, 200, 3)
        for line in range(y + 20, y + h - 8, 10):
            image[line : line + 4, x + 10 : x + int(w * rng.uniform(0.4, 0.93))] = rng.uniform(70, 150)
    return np.asarray(np.clip(image, 0, 255), dtype=np.uint8)


def _logo(shape: str, radius_m: float) -> Mesh:
    """Return a flat shape at the origin facing up and pointing to -x: upright on the back of an open laptop."""
    corners = {"disc": 32, "ring": 32, "hexagon": 6, "square": 4, "triangle": 3, "star": 10}[shape]
    angle = 2.0 * np.pi * (np.arange(corners) + (0.5 if shape == "square" else 0.0)) / corners + np.pi
    outer = np.where((shape == "star") & (np.arange(corners) % 2 == 1), 0.45, 1.0) * radius_m
    rim = np.column_stack([outer * np.cos(angle), outer * np.sin(angle), np.zeros(corners)])
    inner = (0.62 if shape == "ring" else 0.0) * rim
    here = np.arange(corners)
    after = np.roll(np.arange(corners), -1)
    faces = np.concatenate(
        [np.column_stack([corners + here, here, after]), np.column_stack([corners + here, after, corners + after])]
    )
    return flat_mesh(np.concatenate([rim, inner]), faces)


def _base(rng: np.random.Generator, size: dict[str, float], case: SurfaceFinish, *, dark_keys: bool) -> BodyParts:
    """Make the base."""
    w = size["width_m"]
    d = size["depth_m"]
    feet = size["feet_m"]
    top = size["top_m"]
    radius = float(rng.uniform(0.006, 0.012))
    undercut = 0.75 * (top - feet)
    low = np.array([-d / 2.0, -w / 2.0])
    high = np.array([d / 2.0, w / 2.0])
    points = np.concatenate(
        [
            _rounded(low + 0.0008, high - 0.0008, top, radius),
            _rounded(low, high, top - 0.0008, radius),
            _rounded(low, high, top - 0.003, radius),
            _rounded(low + np.array([0.004, 0.006]), high - np.array([undercut, 0.006]), feet, radius),
        ]
    )
    ink, key = ((215, 215, 215), rng.uniform(18, 40)) if dark_keys else ((60, 60, 64), rng.uniform(200, 235))
    back = -d / 2.0 + 0.022
    keys_depth = 0.5 * d
    keys_low = [back, -0.44 * w]
    keys_high = [back + keys_depth, 0.44 * w]
    image = _keyboard((keys_depth, 0.88 * w), key * np.ones(3), 0.45 * key * np.ones(3), ink)
    pad = float(rng.uniform(0.13, 0.19)) * w
    pad_color = rgb(np.array(case.color) * 0.72 + (0.03 if max(case.color) < 0.1 else 0.0))
    dark = SurfaceFinish(color=(0.01, 0.01, 0.011), roughness=0.8)
    parts = _slab(points, case)
    decal_z = top + 0.5 * _SKIN_M
    parts.visual(_sheet(keys_low, keys_high, decal_z), SurfaceFinish(texture=image, roughness=0.8))
    pad_sheet = _sheet([back + keys_depth + 0.006, -pad], [d / 2.0 - 0.007, pad], decal_z)
    parts.visual(pad_sheet, SurfaceFinish(color=pad_color, roughness=0.35, specular=0.5))
    R_YZ = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for y in (-0.32 * w, 0.32 * w):
        X = make_pose(R_YZ, [size["hinge_x_m"], y, size["hinge_z_m"]])
        parts.visual(cylinder_mesh(HINGE_ABOVE_BASE_M, 0.16 * w), dark, X)
    for x, y in product((-0.36 * d, 0.26 * d), (-0.38 * w, 0.38 * w)):
        parts.box([0.012, 0.02, feet + 0.0004], [x, y, 0.5 * feet], dark, bevel_m=0.0, solid=False)
    for side in (-1.0, 1.0):  # sockets; the side walls taper by 6 mm over their height
        for i in range(int(rng.integers(1, 4))):
            center = [-0.3 * d + 0.02 * i, side * (w / 2.0 - 0.0022), top - 0.0052]
            parts.box([0.010, 0.0040, 0.0036], center, dark, bevel_m=0.0, solid=False)
    return parts


def _lid(rng: np.random.Generator, index: int, size: dict[str, float], case: SurfaceFinish) -> BodyParts:
    """Make the lid in its own frame."""
    w = size["width_m"]
    near = 0.004
    far = size["reach_m"]
    inner = size["inside_m"]
    outer = size["outside_m"]
    radius = float(rng.uniform(0.006, 0.012))
    low = np.array([near, -w / 2.0])
    high = np.array([far, w / 2.0])
    points = np.concatenate(
        [
            _rounded(low + 0.0008, high - 0.0008, inner, radius),
            _rounded(low, high, inner + 0.0008, radius),
            _rounded(low, high, outer - 0.0015, radius),
            _rounded(low + 0.0015, high - 0.0015, outer, radius),
        ]
    )
    border = float(rng.uniform(0.006, 0.011))
    frame_low = low + 0.004
    frame_high = high - 0.004
    screen_low = low + np.array([0.004 + 1.4 * border, 0.004 + border])
    screen_high = high - 0.004 - border
    logo = rgb(np.array(case.color) * 0.4 if max(case.color) > 0.3 else np.array([0.75, 0.75, 0.75]))
    X_logo = make_pose(np.eye(3), [0.5 * (near + far), 0.0, outer + 0.5 * _SKIN_M])
    parts = _slab(points, case)
    frame = SurfaceFinish(color=(0.008, 0.008, 0.009), roughness=0.3, specular=0.5)
    parts.visual(_sheet(frame_low, frame_high, inner - 0.3 * _SKIN_M, up=False), frame)
    screen = SurfaceFinish(texture=_desktop(rng, index), roughness=0.35, specular=0.4)
    parts.visual(_sheet(screen_low, screen_high, inner - _SKIN_M, up=False), screen)
    mesh = _logo(LOGOS[index % len(LOGOS)], float(rng.uniform(0.009, 0.015)))
    parts.visual(mesh, SurfaceFinish(color=logo, roughness=0.25, metallic=0.4), X_logo)
    return parts


def _laptop(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    name = list(COLORS)[index % len(COLORS)]
    metal = name not in ("white", "black") and rng.random() < 0.6
    case = SurfaceFinish(
        color=rgb(np.array(COLORS[name]) * rng.uniform(0.85, 1.15)),
        roughness=float(rng.uniform(0.3, 0.6)),
        metallic=0.35 if metal else 0.0,
        specular=0.4,
    )
    size = {
        "width_m": float(rng.uniform(*WIDTH_M)),
        "depth_m": float(rng.uniform(*DEPTH_M)),
        "feet_m": float(rng.uniform(*FEET_M)),
        "lip_m": float(rng.uniform(*LIP_M)),
    }
    thickness = float(rng.uniform(*LID_M))
    size["top_m"] = size["feet_m"] + float(rng.uniform(*BASE_M))
    size["hinge_x_m"] = -size["depth_m"] / 2.0 + HINGE_FROM_BACK_M
    size["hinge_z_m"] = size["top_m"] + HINGE_ABOVE_BASE_M
    size["inside_m"] = GAP_M - HINGE_ABOVE_BASE_M
    size["outside_m"] = size["inside_m"] + thickness
    size["reach_m"] = size["depth_m"] / 2.0 + size["lip_m"] - size["hinge_x_m"]
    base = _base(rng, size, case, dark_keys=name != "white" and index % 3 != 1)
    lid = _lid(rng, index, size, case)
    p_hinge = [size["hinge_x_m"], 0.0, size["hinge_z_m"]]
    friction = float(rng.uniform(0.02, 0.06))
    joint = lid_hinge(p_hinge, GREATEST_RAD, friction=friction, damping=float(rng.uniform(0.06, 0.14)))
    material = Material(
        density=float(rng.uniform(900.0, 1300.0)), static_friction=0.45, dynamic_friction=0.4, restitution=0.0
    )
    return AssetModel(
        asset_id=asset_id,
        words=f"{name} laptop",
        bodies=(base.body("base", material), lid.body("lid", material, joint)),
        size=size,
        sites={"hinge": site_at("base", p_hinge), "edge": site_at("lid", [size["reach_m"], 0.0, size["inside_m"]])},
    )


KINDS = {"laptop": _laptop}
"""Laptops; sizes: width and depth, height of the feet and of the base's top, the lid's overhang, position of the hinge
in the base, and in the lid's frame its reach from the axis and the heights of its inner and outer faces."""
