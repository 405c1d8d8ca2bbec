"""Faucets that stand on the table: a body with a spout, and a handle that turns about the vertical axis.

The origin is on the table below the handle's axis. The handle's lever points along x at half its travel; the first body
is fixed. All parts within the lever's sweep except the hub are below it, so that a finger can sweep along.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose, rotation_z
from kinebench_drake.suites.scene.mesh import BodyParts, frustum, lathe, sweep, unit_ring
from kinebench_drake.suites.scene.model import (
    AssetModel,
    ColliderKind,
    Joint,
    JointKind,
    Material,
    SurfaceFinish,
    site_at,
)
from kinebench_drake.suites.scene.texture import rgb

LEVER_HEIGHT_M = (0.095, 0.125)
"""Least and greatest height of the lever's centre line."""
LEVER_M = (0.062, 0.095)
"""Least and greatest reach of the lever from the axis, over all shapes."""
RANGE_RAD = (1.55, 1.85)
"""Least and greatest travel of the handle."""
_SECTIONS = 20  # of the colliders around round parts


class _FaucetParts(BodyParts):
    """Builder of a body from the shapes of which faucets consist."""

    def revolve(self, profile: ArrayLike, surface: SurfaceFinish) -> None:
        """Add a closed solid of revolution about z; each segment of its profile (N, 2) is a collider."""
        rz = np.asarray(profile, dtype=np.float64)
        self.visual(lathe(rz, sections=36), surface)
        for low, high in pairwise(rz):
            if high[1] - low[1] > 1e-4:
                self.colliders.append(frustum(*[(max(r, 5e-4), z) for r, z in (low, high)], sections=_SECTIONS))

    def tube(self, points: ArrayLike, radii: ArrayLike, surface: SurfaceFinish) -> None:
        """Add a round tube along a smooth curve (N, 3), with radii interpolated from evenly spaced ones."""
        p = np.asarray(points, dtype=np.float64)
        knots = np.atleast_1d(radii)
        r = np.interp(np.linspace(0.0, 1.0, len(p)), np.linspace(0.0, 1.0, len(knots)), knots)
        self.visual(sweep(p, r, sections=20), surface)
        chain = np.unique(np.append(np.arange(0, len(p), max(1, len(p) // 8)), len(p) - 1))
        for i, j in pairwise(chain):
            across = _rotation_to((p[j] - p[i]) / np.linalg.norm(p[j] - p[i]))[:, 1:]
            points = np.concatenate([p[k] + r[k] * unit_ring(_SECTIONS) @ across.T for k in (i, j)])
            self.hull(points)

    def block(self, size: Sequence[float], center: ArrayLike, surface: SurfaceFinish, *, yaw_rad: float = 0.0) -> None:
        """Add a box with a bevel that suits its extents, rotated about z."""
        self.box(size, center, surface, R=rotation_z(yaw_rad), bevel_m=min(0.0025, 0.2 * min(size)))

    def ball(self, radius_m: float, at: ArrayLike, surface: SurfaceFinish) -> None:
        """Add a sphere by its centre."""
        angle = np.linspace(-np.pi / 2.0, np.pi / 2.0, 13)
        mesh = lathe(radius_m * np.column_stack([np.cos(angle), np.sin(angle)]), sections=24)
        X = make_pose(np.eye(3), at)
        self.visual(mesh, surface, X)
        self.collider(ColliderKind.SPHERE, (radius_m,), X)


def _rotation_to(x: Array) -> Array:
    """Return a rotation (3, 3) whose first axis is the unit vector `x`."""
    y = np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _curve(points: ArrayLike) -> Array:
    """Return a smooth curve from the first to the last of the points (N, 3) by corner cutting (Chaikin 1974)."""
    p = np.asarray(points, dtype=np.float64)
    for _ in range(4):
        cut = np.stack([0.75 * p[:-1] + 0.25 * p[1:], 0.25 * p[:-1] + 0.75 * p[1:]], axis=1).reshape(-1, 3)
        p = np.concatenate([p[:1], cut, p[-1:]])
    return p


def _at(angle_rad: float, points_rz: ArrayLike) -> Array:
    """Return points (N, 3) at distances and heights (N, 2) in the vertical half-plane at an angle about z."""
    rz = np.asarray(points_rz, dtype=np.float64)
    return np.column_stack([rz[:, 0] * np.cos(angle_rad), rz[:, 0] * np.sin(angle_rad), rz[:, 1]])


@dataclass(frozen=True, slots=True, kw_only=True)
class _FaucetDesign:
    """Properties of an instance common to all shapes."""

    height: float
    """Height of the lever's centre line [m]."""
    lever: float
    """Reach of the lever [m]."""
    spout: float
    """Angle of the spout from the lever's direction at half travel [rad]."""
    metal: SurfaceFinish
    accent: SurfaceFinish
    rng: np.random.Generator


_Shape = Callable[[_FaucetDesign, _FaucetParts, _FaucetParts], float]
"""Adds parts to the base and the handle; returns half the lever's width at the point where it is pushed [m].

The handle's frame has its origin on the axis at the lever's height and x along the lever.
"""


def _mixer(d: _FaucetDesign, base: _FaucetParts, handle: _FaucetParts) -> float:
    """Make a basin mixer: cylinder, short spout, one flat lever on top."""
    r = float(d.rng.uniform(0.021, 0.026))
    top = d.height - 0.012
    base.revolve(
        [[0.0, 0.0], [1.25 * r, 0.0], [1.25 * r, 0.006], [1.05 * r, 0.009], [r, 0.012], [r, top], [0.0, top]], d.metal
    )
    z = 0.55 * d.height
    reach = float(d.rng.uniform(0.085, 0.11))
    spout = [[0.0, z], [0.5 * reach, z + 0.012], [reach, z + 0.012], [reach + 0.004, z - 0.022]]
    base.tube(_curve(_at(d.spout, spout)), 0.0105, d.metal)
    handle.revolve(
        [[0.0, -0.0115], [r, -0.0115], [r, 0.004], [0.85 * r, 0.010], [0.5 * r, 0.0135], [0.0, 0.0145]], d.metal
    )
    handle.block([d.lever, 0.016, 0.010], [0.5 * d.lever, 0.0, 0.0], d.metal)
    return 0.008


def _cross(d: _FaucetDesign, base: _FaucetParts, handle: _FaucetParts) -> float:
    """Make a pillar tap: a waisted post and a cross of four arms with knobs."""
    h = d.height
    base.revolve(
        [[0.0, 0.0], [0.031, 0.0], [0.031, 0.006], [0.023, 0.014], [0.018, 0.4 * h], [0.021, 0.5 * h],
         [0.021, 0.72 * h], [0.012, 0.76 * h], [0.010, h - 0.014], [0.0, h - 0.014]],
        d.metal,
    )  # fmt: skip
    z = 0.6 * h
    reach = float(d.rng.uniform(0.085, 0.11))
    spout = [[0.0, z], [0.45 * reach, z + 0.006], [0.9 * reach, z + 0.008], [reach, z - 0.03]]
    base.tube(_curve(_at(d.spout, spout)), [0.013, 0.010], d.metal)
    handle.revolve([[0.0, -0.0135], [0.013, -0.0135], [0.015, 0.0], [0.013, 0.009], [0.0, 0.0115]], d.metal)
    handle.revolve([[0.0, 0.0105], [0.009, 0.0105], [0.008, 0.013], [0.0, 0.014]], d.accent)
    for k in range(4):
        handle.tube(_at(k * np.pi / 2.0, [[0.010, 0.0], [d.lever - 0.008, 0.0]]), [0.0055, 0.0065], d.metal)
        handle.ball(0.0085, _at(k * np.pi / 2.0, [[d.lever - 0.0085, 0.0]])[0], d.metal)
    return 0.0075


def _gooseneck(d: _FaucetDesign, base: _FaucetParts, handle: _FaucetParts) -> float:
    """Make a kitchen faucet: a plate with a high bent neck at one end and the lever's post at the other."""
    gap = float(d.rng.uniform(0.10, 0.12))
    h = d.height
    base.block([gap + 0.06, 0.052, 0.012], [-0.5 * gap, 0.0, 0.006], d.metal)
    base.revolve([[0.0, 0.012], [0.020, 0.012], [0.017, 0.02], [0.016, h - 0.012], [0.0, h - 0.012]], d.metal)
    high = float(d.rng.uniform(0.165, 0.19))
    reach = float(d.rng.uniform(0.08, 0.10))
    away = np.sign(d.spout) * (np.pi - 0.7)
    neck = [[0.0, 0.012], [0.0, 0.75 * high], [0.0, high], [reach, high], [reach, 0.66 * high]]
    end = [[reach, 0.66 * high], [reach, 0.58 * high]]
    base.tube(_curve(_at(away, neck)) - [gap, 0.0, 0.0], 0.010, d.metal)
    base.tube(_at(away, end) - [gap, 0.0, 0.0], 0.0125, d.accent)
    base.tube([[-gap, 0.0, 0.010], [-gap, 0.0, 0.045]], 0.016, d.metal)
    handle.revolve([[0.0, -0.0115], [0.0165, -0.0115], [0.0165, 0.004], [0.012, 0.010], [0.0, 0.012]], d.metal)
    lever = [[0.0, 0.0], [0.5 * d.lever, 0.0], [d.lever - 0.0075, 0.003]]
    handle.tube(_curve(_at(0.0, lever)), [0.0055, 0.0075], d.metal)
    handle.ball(0.0075, [d.lever - 0.0075, 0.0, 0.003], d.metal)
    return 0.0075


def _modern(d: _FaucetDesign, base: _FaucetParts, handle: _FaucetParts) -> float:
    """Make a square faucet: a pillar, a straight spout, a long flat lever."""
    a = float(d.rng.uniform(0.036, 0.044))
    h = d.height
    square = round(d.spout / (np.pi / 2.0)) * np.pi / 2.0
    base.block([a + 0.016, a + 0.016, 0.006], [0.0, 0.0, 0.003], d.metal)
    base.block([a, a, h - 0.012], [0.0, 0.0, 0.5 * (h - 0.012)], d.metal)
    reach = float(d.rng.uniform(0.09, 0.12))
    z = 0.58 * h
    base.block([reach, 0.026, 0.016], _at(square, [[0.5 * reach + 0.01, z]])[0], d.metal, yaw_rad=square)
    base.block([0.016, 0.016, 0.006], _at(square, [[reach, z - 0.010]])[0], d.accent, yaw_rad=square)
    handle.block([a, a, 0.018], [0.0, 0.0, -0.002], d.metal)
    handle.block([d.lever, 0.018, 0.009], [0.5 * d.lever, 0.0, 0.0], d.metal)
    return 0.009


def _garden(d: _FaucetDesign, base: _FaucetParts, handle: _FaucetParts) -> float:
    """Make a garden tap on a board: a pipe, a nozzle that bends down, a handle with two wings."""
    back = float(d.rng.uniform(0.10, 0.115))
    h = d.height
    z = h - 0.052
    plank = SurfaceFinish(color=rgb(np.array([0.34, 0.2, 0.09]) * d.rng.uniform(0.7, 1.3)), roughness=0.8)
    base.block([0.018, 0.10, z + 0.03], [-back, 0.0, 0.5 * (z + 0.03)], plank)
    base.block([0.075, 0.10, 0.012], [-back + 0.028, 0.0, 0.006], plank)
    base.tube([[-back, 0.0, z], [0.0, 0.0, z]], 0.0115, d.metal)
    base.tube([[-back, 0.0, z], [-back + 0.014, 0.0, z]], 0.022, d.metal)
    base.revolve(
        [[0.0, z - 0.020], [0.016, z - 0.020], [0.018, z], [0.014, z + 0.016], [0.009, z + 0.020], [0.008, h - 0.010],
         [0.0, h - 0.010]],
        d.metal,
    )  # fmt: skip
    nozzle = [[0.0, 0.0, z], [0.038, 0.0, z + 0.004], [0.05, 0.0, z], [0.052, 0.0, z - 0.035]]
    base.tube(_curve(nozzle), 0.0115, d.metal)
    handle.revolve([[0.0, -0.0095], [0.011, -0.0095], [0.012, 0.004], [0.008, 0.009], [0.0, 0.010]], d.accent)
    wing = np.array([[0.004, 0.0, 0.0], [0.6 * d.lever, 0.0, 0.0], [d.lever - 0.008, 0.0, 0.0]])
    for sign in (1.0, -1.0):
        handle.tube(wing * [sign, sign, 1.0], [0.0055, 0.006, 0.008], d.accent)
        handle.ball(0.008, [sign * (d.lever - 0.008), 0.0, 0.0], d.accent)
    return 0.007


def _bell(d: _FaucetDesign, base: _FaucetParts, handle: _FaucetParts) -> float:
    """Make an old-fashioned tap: a bell-shaped body, a swan-neck spout, a thin lever with a china ball."""
    h = d.height
    base.revolve(
        [[0.0, 0.0], [0.034, 0.0], [0.034, 0.005], [0.028, 0.012], [0.022, 0.25 * h], [0.0175, 0.45 * h],
         [0.022, 0.6 * h], [0.023, 0.68 * h], [0.016, 0.76 * h], [0.010, h - 0.011], [0.0, h - 0.011]],
        d.metal,
    )  # fmt: skip
    reach = float(d.rng.uniform(0.09, 0.115))
    spout = [[0.0, 0.35 * h], [0.35 * reach, 0.32 * h], [0.55 * reach, 0.68 * h], [reach, 0.68 * h], [reach, 0.45 * h]]
    base.tube(_curve(_at(d.spout, spout)), 0.0092, d.metal)
    handle.revolve([[0.0, -0.0105], [0.012, -0.0105], [0.015, 0.0], [0.009, 0.010], [0.0, 0.013]], d.metal)
    lever = [[0.006, 0.0, 0.0], [0.6 * d.lever, 0.0, 0.0], [d.lever - 0.012, 0.0, 0.0]]
    handle.tube(lever, [0.006, 0.005, 0.005], d.metal)
    handle.ball(0.0115, [d.lever - 0.0115, 0.0, 0.0], d.accent)
    return 0.0055


_SHAPES: tuple[tuple[_Shape, tuple[float, float]], ...] = (
    (_mixer, (0.080, LEVER_M[1])),
    (_cross, (LEVER_M[0], 0.070)),
    (_gooseneck, (0.085, LEVER_M[1])),
    (_modern, (0.085, LEVER_M[1])),
    (_garden, (LEVER_M[0], 0.070)),
    (_bell, (0.080, LEVER_M[1])),
)
"""Shapes, each with the least and greatest reach of its lever [m]."""
_METALS = {
    "chrome": SurfaceFinish(color=(0.62, 0.64, 0.67), roughness=0.22, metallic=0.45, specular=0.9),
    "brass": SurfaceFinish(color=(0.62, 0.40, 0.11), roughness=0.3, metallic=0.45, specular=0.8),
    "black": SurfaceFinish(color=(0.022, 0.022, 0.025), roughness=0.45, specular=0.5),
    "white": SurfaceFinish(color=(0.78, 0.78, 0.76), roughness=0.3, specular=0.5),
    "copper": SurfaceFinish(color=(0.6, 0.25, 0.13), roughness=0.3, metallic=0.45, specular=0.8),
}
_ACCENTS = ((0.65, 0.03, 0.03), (0.03, 0.1, 0.5), (0.8, 0.8, 0.76), (0.03, 0.3, 0.12))
_TURN = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Joint frame: its x axis, about which joints rotate, is the body's z."""


def _faucet(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    make, levers = _SHAPES[index % len(_SHAPES)]
    finish = list(_METALS)[(index // len(_SHAPES) + index) % len(_METALS)]
    design = _FaucetDesign(
        height=float(rng.uniform(*LEVER_HEIGHT_M)),
        lever=float(rng.uniform(*levers)),
        spout=float(rng.choice([-1.0, 1.0]) * rng.uniform(1.4, 2.6)),
        metal=_METALS[finish],
        accent=SurfaceFinish(color=_ACCENTS[rng.integers(len(_ACCENTS))], roughness=0.35, specular=0.5),
        rng=rng,
    )
    base = _FaucetParts(uv_per_m=1.0)
    handle = _FaucetParts(uv_per_m=1.0)
    half_width = make(design, base, handle)
    travel = float(rng.uniform(*RANGE_RAD))
    joint = Joint(
        kind=JointKind.HINGE,
        X_ParentJ=make_pose(rotation_z(-travel / 2.0) @ _TURN, [0.0, 0.0, design.height]),
        X_BodyJ=make_pose(_TURN, np.zeros(3)),
        upper=travel,
        friction=float(rng.uniform(0.05, 0.2)),
        damping=float(rng.uniform(0.05, 0.2)),
    )
    brass = Material(density=2500.0, static_friction=0.4, dynamic_friction=0.3)
    return AssetModel(
        asset_id=asset_id,
        words=f"{finish} faucet",
        bodies=(base.body("body", Material()), handle.body("handle", brass, joint)),
        size={"range_rad": travel, "height_m": design.height, "lever_m": design.lever, "half_width_m": half_width},
        sites={"lever": site_at("handle", [design.lever, 0.0, 0.0])},
    )


KINDS = {"faucet": _faucet}
"""Faucets of six shapes in five finishes."""
