"""Fruits of graspable size, in the orientation in which they rest on the table.

The origin is the centre of the thickest part, where to grasp; for long fruits the fingers close along y.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from kinebench_drake.geometry import Array, rotation_exp
from kinebench_drake.suites.families.fruits.peel import SKINS
from kinebench_drake.suites.scene.mesh import BodyParts, arc_length, lathe, smooth_mesh, sparse_hull, sweep
from kinebench_drake.suites.scene.model import AssetModel, Material, Mesh, SurfaceFinish, Visual

FRUITS = ("apple", "banana", "orange", "peach", "pear", "strawberry")
"""Names of the fruits."""
_BROWN = (0.11, 0.06, 0.025)
_GREEN = (0.07, 0.2, 0.03)
_FLAT_M = 0.0009
"""Depth by which a fruit's underside is flattened, as by its weight."""
_FLAT_SIDE_M = 0.0007
"""Depth by which long fruits are flattened on each side, so that they do not turn between the fingers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _FruitShape:
    """Upright fruit; its axis is z, the thickest part at z = 0."""

    skin: Mesh
    parts: tuple[Visual, ...] = ()
    """Stalk and leaves."""
    solids: tuple[Array, ...] = ()
    """Points (N, 3) of each convex collider; empty: the skin's hull."""
    R_BodyShape: Array | None = None
    """Rotation (3, 3) to the resting orientation; None: upright."""
    roughness: float = 0.5
    density: float = 850.0


def _globe(profile: Array, bend: Callable[[Array, Array], Array] | None = None) -> Mesh:
    """Return a surface of revolution with texture coordinates 0..1.

    `bend` returns factors (V,) on the radius from the angle (V,) [rad] and the height (V,) 0..1.
    """
    mesh = lathe(profile, sections=36)  # of surfaces of revolution
    uv = mesh.uv / mesh.uv.max(axis=0)
    vertices = np.array(mesh.vertices)
    if bend is not None:
        vertices[:, :2] *= bend(np.arctan2(vertices[:, 1], vertices[:, 0]), uv[:, 1])[:, None]
    return smooth_mesh(vertices, mesh.faces, uv, crease_rad=1.0)


def _profile(knots: ArrayLike, count: int = 26) -> Array:
    """Return a smooth profile (count, 2) through radii and heights (K, 2)."""
    p = np.asarray(knots, dtype=np.float64)
    along = arc_length(p)
    s = np.linspace(0.0, along[-1], count)
    return np.column_stack([PchipInterpolator(along, p[:, i])(s) for i in range(2)])


def _stalk(foot: ArrayLike, head: ArrayLike, radius_m: float, color: tuple[float, float, float] = _BROWN) -> Visual:
    """Return a thin stalk, slightly thicker at its head."""
    s = np.linspace(0.0, 1.0, 6)[:, None]
    a = np.asarray(foot, dtype=np.float64)
    b = np.asarray(head, dtype=np.float64)
    bow = 0.12 * np.linalg.norm(b - a) * np.sin(np.pi * s) * np.array([0.0, 1.0, 0.0])
    return Visual(
        mesh=sweep(a + s * (b - a) + bow, radius_m * np.array([0.8, 0.75, 0.7, 0.8, 1.2, 1.2]), sections=8),
        surface=SurfaceFinish(color=color, roughness=0.9),
    )


def _leaf(length_m: float, width_m: float, bow_m: float) -> tuple[Array, Array]:
    """Return vertices and two-sided triangles of a leaf from the origin along x that rises by `bow_m` in its middle."""
    s = np.linspace(0.0, 1.0, 9)
    wide = 0.5 * width_m * np.sin(np.pi * s**0.8) ** 0.8
    rise = 4.0 * bow_m * s * (1.0 - s)
    edge = [np.column_stack([length_m * s, sign * wide, rise + 0.15 * wide]) for sign in (-1.0, 1.0)]
    vertices = np.concatenate([edge[0], np.column_stack([length_m * s, 0.0 * s, rise]), edge[1]])
    faces = [([k, k + 1, k + 10], [k, k + 10, k + 9]) for row in (0, 9) for k in range(row, row + 8)]
    upper = np.array(faces).reshape(-1, 3)
    return vertices, np.concatenate([upper, upper[:, ::-1]])


def _leaves(leaves: Sequence[tuple[Array, Array]], surface: SurfaceFinish) -> Visual:
    """Return one visual of several leaves (vertices, faces)."""
    starts = np.cumsum([0, *(len(v) for v, _ in leaves)])
    vertices = np.concatenate([v for v, _ in leaves])
    faces = np.concatenate([f + start for (_, f), start in zip(leaves, starts, strict=False)])
    return Visual(mesh=smooth_mesh(vertices, faces, vertices[:, :2]), surface=surface)


def _apple(rng: np.random.Generator, index: int) -> _FruitShape:
    r = float(rng.uniform(0.0255, 0.0295))
    h = float(rng.uniform(0.86, 0.93)) * r
    top = float(rng.uniform(0.42, 0.52))
    knots = [[0.0, -0.78], [0.16, -0.86], [0.36, -1.0], [0.62, -0.86], [0.88, -0.42], [1.0, 0.12], [0.93, 0.55],
             [top + 0.24, 0.86], [top, 0.96], [0.26, 0.86], [0.08, 0.62], [0.0, 0.58]]  # fmt: skip
    lobes = float(rng.uniform(0.01, 0.025))
    phase = rng.uniform(0.0, 2.0 * np.pi)
    skin = _globe(
        _profile(knots) * [r, h], lambda angle, v: 1.0 + lobes * np.cos(5.0 * angle + phase) * np.abs(2.0 * v - 1.0)
    )
    tip = np.array([rng.uniform(-0.1, 0.1) * r, rng.uniform(-0.1, 0.1) * r, h + 0.0045])
    parts = [_stalk([0.0, 0.0, 0.58 * h], tip, 0.0011)]
    if index % 2:
        vertices, faces = _leaf(0.62 * r, 0.3 * r, 0.06 * r)
        turn = rotation_exp([0.0, 0.0, rng.uniform(-np.pi, np.pi)]) @ rotation_exp([0.0, -0.12, 0.0])
        parts.append(
            _leaves([(vertices @ turn.T + [0.0, 0.0, 0.97 * h], faces)], SurfaceFinish(color=_GREEN, roughness=0.6))
        )
    return _FruitShape(skin=skin, parts=tuple(parts), roughness=0.35)


def _orange(rng: np.random.Generator, index: int) -> _FruitShape:
    r = float(rng.uniform(0.0260, 0.0300))
    h = float(rng.uniform(0.92, 0.97)) * r
    t = np.linspace(-np.pi / 2.0, np.pi / 2.0, 25)
    profile = np.column_stack([r * np.cos(t), h * np.sin(t)])
    profile[[0, -1], 0] = 0.0
    profile[-1, 1] -= 0.02 * h
    return _FruitShape(skin=_globe(profile), roughness=0.45)


def _peach(rng: np.random.Generator, index: int) -> _FruitShape:
    r = float(rng.uniform(0.0260, 0.0295))
    h = float(rng.uniform(0.88, 0.94)) * r
    knots = [[0.0, -0.98], [0.35, -0.94], [0.68, -0.74], [0.92, -0.38], [1.0, 0.05], [0.93, 0.45], [0.70, 0.78],
             [0.42, 0.95], [0.22, 0.93], [0.07, 0.8], [0.0, 0.76]]  # fmt: skip
    deep = float(rng.uniform(0.05, 0.09))
    wide = float(rng.uniform(0.14, 0.2))
    phase = rng.uniform(-np.pi, np.pi)

    def crease(angle: Array, v: Array) -> Array:
        off = (angle - phase + np.pi) % (2.0 * np.pi) - np.pi
        groove = np.exp(-((off / wide) ** 2)) - 0.5 * np.exp(-((off / (2.5 * wide)) ** 2))
        return np.asarray(1.0 - deep * groove * np.sin(np.pi * np.clip(1.15 * v - 0.05, 0.0, 1.0)))

    return _FruitShape(skin=_globe(_profile(knots) * [r, h], crease), roughness=0.95)


def _pear(rng: np.random.Generator, index: int) -> _FruitShape:
    r = float(rng.uniform(0.0245, 0.0275))
    long = float(rng.uniform(1.75, 2.1)) * r
    neck = float(rng.uniform(0.42, 0.52))
    knots = [[0.0, -0.80 * r], [0.2 * r, -0.86 * r], [0.42 * r, -0.84 * r], [0.78 * r, -0.58 * r], [r, 0.0],
             [0.88 * r, 0.45 * r], [0.5 * (neck + 0.8) * r, 0.48 * long], [neck * r, 0.78 * long],
             [0.75 * neck * r, 0.96 * long], [0.3 * neck * r, long], [0.0, 0.97 * long]]  # fmt: skip
    skin = _globe(_profile(knots, 30))
    stalk = _stalk([0.0, 0.0, 0.96 * long], [0.002, 0.0, long + rng.uniform(0.008, 0.013)], 0.0013)
    return _FruitShape(skin=skin, parts=(stalk,), R_BodyShape=_lying(skin), roughness=0.5)


def _strawberry(rng: np.random.Generator, index: int) -> _FruitShape:
    r = float(rng.uniform(0.0180, 0.0210))
    long = float(rng.uniform(1.35, 1.75)) * r
    knots = [[0.0, -long], [0.24 * r, -0.95 * long], [0.55 * r, -0.66 * long], [0.82 * r, -0.32 * long], [r, 0.0],
             [0.93 * r, 0.3 * r], [0.66 * r, 0.5 * r], [0.25 * r, 0.53 * r], [0.0, 0.5 * r]]  # fmt: skip
    skin = _globe(_profile(knots))
    leaves = []
    phase = rng.uniform(0.0, 1.0)
    count = int(rng.integers(6, 9))
    for i in range(count):
        vertices, faces = _leaf(rng.uniform(0.72, 0.9) * r, 0.36 * r, 0.09 * r)
        turn = rotation_exp([0.0, 0.0, 2.0 * np.pi * (i + phase) / count])
        leaves.append(
            ((vertices - [0, 0, 0.1 * r] * (vertices[:, :1] / r) ** 2) @ turn.T + [0.0, 0.0, 0.55 * r], faces)
        )
    stalk = _stalk([0.0, 0.0, 0.5 * r], [0.0012, 0.0, 0.5 * r + rng.uniform(0.006, 0.010)], 0.0010, _GREEN)
    return _FruitShape(
        skin=skin,
        parts=(stalk, _leaves(leaves, SurfaceFinish(color=_GREEN, roughness=0.7))),
        R_BodyShape=_lying(skin),
        roughness=0.4,
        density=700.0,
    )


def _banana(rng: np.random.Generator, index: int) -> _FruitShape:
    r = float(rng.uniform(0.0165, 0.0182))
    length = float(rng.uniform(0.125, 0.145))
    turn = float(rng.uniform(0.8, 1.15))
    bow = length / turn
    s = np.linspace(-0.5, 0.5, 33)
    middle = np.column_stack([bow * np.sin(turn * s), bow * (np.cos(turn * s) - 1.0), 0.0 * s])
    knots = [(-0.5, 0.0), (-0.499, 0.2), (-0.475, 0.27), (-0.44, 0.55), (-0.36, 0.83), (-0.2, 0.98), (0.0, 1.0),
             (0.2, 0.96), (0.34, 0.8), (0.4, 0.5), (0.435, 0.32), (0.495, 0.27), (0.5, 0.0)]  # fmt: skip
    tube = sweep(middle, r * PchipInterpolator(*np.transpose(knots))(s), sections=25)
    uv = tube.uv / tube.uv.max(axis=0)
    angle = 2.0 * np.pi * uv[:, 0]
    axis = np.stack([np.interp(uv[:, 1], s + 0.5, middle[:, i]) for i in range(3)], axis=1)
    vertices = axis + (tube.vertices - axis) * (1.0 + 0.03 * np.cos(5.0 * angle))[:, None]
    skin = smooth_mesh(vertices, tube.faces, uv, crease_rad=1.0)
    cuts = np.linspace(0.0, 1.0, 7)
    solids = tuple(
        skin.vertices[(uv[:, 1] >= low - 0.016) & (uv[:, 1] <= high + 0.016)] for low, high in pairwise(cuts)
    )
    return _FruitShape(skin=skin, solids=solids, R_BodyShape=np.eye(3), roughness=0.6)


def _lying(skin: Mesh) -> Array:
    """Return the rotation (3, 3) about y that lays a fruit on its side with the lowest centre of mass."""
    hull = trimesh.convex.convex_hull(skin.vertices)
    points = hull.vertices - hull.center_mass
    tilts = np.linspace(0.9, 2.2, 261)
    heights = [-(points @ rotation_exp([0.0, tilt, 0.0]).T)[:, 2].min() for tilt in tilts]
    return np.asarray(rotation_exp([0.0, tilts[int(np.argmin(heights))], 0.0]))


def _rotate(mesh: Mesh, R: Array) -> Mesh:
    """Return a mesh rotated by `R` (3, 3)."""
    return replace(mesh, vertices=mesh.vertices @ R.T, normals=mesh.normals @ R.T)


_SHAPES = dict(zip(FRUITS, (_apple, _banana, _orange, _peach, _pear, _strawberry), strict=True))


def _fruit(name: str, asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    shape = _SHAPES[name](rng, index)
    R = np.eye(3) if shape.R_BodyShape is None else shape.R_BodyShape
    resting = _rotate(shape.skin, R)
    floor = float(resting.vertices[:, 2].min()) + _FLAT_M
    vertices = np.array(resting.vertices)
    vertices[:, 2] = np.maximum(vertices[:, 2], floor)
    skin = smooth_mesh(vertices, resting.faces, resting.uv, crease_rad=1.0)
    half = 0.5 * _thickness(skin) - (_FLAT_SIDE_M if shape.R_BodyShape is not None else 0.0)
    solids = [np.maximum(points @ R.T, [-1.0, -1.0, floor]) for points in shape.solids]
    solids = solids or [np.clip(skin.vertices, [-1.0, -half, floor], [1.0, half, 1.0])]
    surface = SurfaceFinish(texture=SKINS[name](rng, index), roughness=shape.roughness)
    parts = BodyParts()
    parts.visual(skin, surface)
    parts.visuals += [replace(part, mesh=_rotate(part.mesh, R)) for part in shape.parts]
    for points in solids:
        parts.hull(sparse_hull(points, directions=40 if len(solids) == 1 else 30))
    material = Material(
        density=shape.density * float(rng.uniform(0.9, 1.1)),
        static_friction=1.0,
        dynamic_friction=0.9,
        restitution=0.02,
        linear_damping=0.1,
        angular_damping=12.0,
    )
    extent = np.ptp(skin.vertices, axis=0)
    return AssetModel(
        asset_id=asset_id,
        words=name,
        bodies=(parts.body(name, material),),
        size={
            "rest_m": -floor,
            "height_m": float(extent[2]),
            "length_m": float(extent[0]),
            "width_m": float(extent[1]),
            "grip_m": _thickness(skin),
            "oblong": float(shape.R_BodyShape is not None),
            "reach_m": float(np.linalg.norm(skin.vertices[:, :2], axis=1).max()),
        },
    )


def _thickness(skin: Mesh) -> float:
    """Return the finger width that grasps the fruit at the origin [m]."""
    return float(np.ptp(skin.vertices[np.abs(skin.vertices[:, 0]) < 0.006, 1]))


KINDS = {f"fruit/{name}": partial(_fruit, name) for name in FRUITS}
"""Fruits by name; sizes: `rest_m` (height of the origin above the support), `height_m`, `length_m` and `width_m` along
x and y, `grip_m` (thickness at the origin along y), `oblong` (1 if the fingers must close along y), `reach_m`
(greatest horizontal distance from the origin)."""
