"""Low cabinets with one drawer that slides along x.

The cabinet's frame is at the centre of its underside: x points in the direction in which the drawer opens, z up. The
drawer's frame coincides with it when shut; the joint position is the opening.
"""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import make_pose
from kinebench_drake.suites.scene.mesh import BodyParts, box_collider, cylinder_mesh, lathe, sweep
from kinebench_drake.suites.scene.model import (
    AssetModel,
    ColliderKind,
    Joint,
    JointKind,
    Material,
    SurfaceFinish,
    site_at,
)
from kinebench_drake.suites.scene.texture import brushed, mix, rgb, wood

WIDTH_M = (0.172, 0.198)
DEPTH_M = (0.168, 0.188)
HEIGHT_M = (0.114, 0.126)
"""Least and greatest extents: perpendicular to the drawer's travel, along it, and height."""
TRAVEL_M = (0.108, 0.124)
"""Least and greatest travel of the drawer."""
HANDLES = ("bar", "knob", "lip")
FINISHES = ("wood", "paint", "metal", "front")
FEET = ("legs", "plinth")
"""Kinds of handles (bow, knob, or a ledge along the upper edge of the front), of finishes (wood, paint, metal, or wood
with a painted front), and of feet."""
_CLEARANCE_M = 0.003  # between the drawer and the cabinet
_WALL_M = 0.007  # thickness of the tray's walls
_FLOOR_M = 0.006  # thickness of the tray's floor
_BACK_M = 0.006  # thickness of the cabinet's back
_WOOD_PER_M = 3.3
_R_OUTWARD = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # rotates z to x
_R_SIDEWAYS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # rotates x to y
_WOOD_KINDS = ("oak", "pine", "walnut", "beech", "maple", "cherry", "teak", "ash", "mahogany")
_PAINTS = {
    "white": (0.75, 0.74, 0.70),
    "blue": (0.05, 0.16, 0.36),
    "green": (0.10, 0.26, 0.15),
    "yellow": (0.68, 0.46, 0.06),
    "grey": (0.22, 0.24, 0.26),
    "turquoise": (0.07, 0.37, 0.38),
    "cream": (0.71, 0.61, 0.42),
    "black": (0.03, 0.03, 0.035),
}
_FITTINGS = (
    SurfaceFinish(color=(0.55, 0.56, 0.58), roughness=0.3, metallic=0.7),
    SurfaceFinish(color=(0.60, 0.42, 0.14), roughness=0.35, metallic=0.7),
    SurfaceFinish(color=(0.03, 0.03, 0.03), roughness=0.5),
    SurfaceFinish(color=(0.70, 0.68, 0.63), roughness=0.4),
)

_GAP_M = 0.001
"""Gap between the shut drawer's front and the cabinet."""
_INSIDE_M = 0.044
"""Least length of the tray that stays in the cabinet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Dimensions:
    """Dimensions of a cabinet [m]."""

    width: float
    depth: float
    height: float
    travel: float
    panel: float
    """Thickness of the cabinet's panels."""
    foot: float
    """Height of the feet."""
    front: float
    """Thickness of the drawer's front."""
    wall: float
    """Height of the tray's walls above its floor."""

    @property
    def face(self) -> float:
        """X of the cabinet's front."""
        return self.depth / 2.0

    @property
    def floor(self) -> float:
        """Height of the upper side of the tray's floor."""
        return self.foot + self.panel + _CLEARANCE_M + _FLOOR_M

    @property
    def front_top(self) -> float:
        """Height of the upper edge of the drawer's front."""
        return self.height - 0.003

    @property
    def front_bottom(self) -> float:
        """Height of the lower edge of the drawer's front."""
        return self.foot + 0.002

    @property
    def tray_x(self) -> tuple[float, float]:
        """X of the tray's inner back and front, the drawer shut."""
        return -self.face + _BACK_M + 2.0 * _CLEARANCE_M + _WALL_M, self.face + _GAP_M

    @property
    def tray_width(self) -> float:
        """Inner width of the tray."""
        return self.width - 2.0 * (self.panel + _CLEARANCE_M + _WALL_M)


def _draw_dimensions(rng: np.random.Generator) -> _Dimensions:
    depth = float(rng.uniform(*DEPTH_M))
    return _Dimensions(
        width=float(rng.uniform(*WIDTH_M)),
        depth=depth,
        height=float(rng.uniform(*HEIGHT_M)),
        travel=float(min(rng.uniform(*TRAVEL_M), depth - _BACK_M - 2.0 * _CLEARANCE_M - _INSIDE_M)),
        panel=float(rng.uniform(0.0095, 0.012)),
        foot=float(rng.uniform(0.007, 0.011)),
        front=float(rng.uniform(0.012, 0.016)),
        wall=float(rng.uniform(0.034, 0.041)),
    )


def _carcass(
    m: _Dimensions, feet: str, outside: SurfaceFinish, inside: SurfaceFinish, fitting: SurfaceFinish
) -> BodyParts:
    """Make the cabinet without its drawer."""
    parts = BodyParts(_WOOD_PER_M)
    x = m.face
    y = m.width / 2.0
    p = m.panel
    parts.panel([-x, -y, m.height - p], [x, y, m.height], outside, bevel_m=0.002)
    parts.panel([-x, -y + p, m.foot], [x, y - p, m.foot + p], inside)
    parts.panel([-x, -y, m.foot], [x, -y + p, m.height - p], outside)
    parts.panel([-x, y - p, m.foot], [x, y, m.height - p], outside)
    parts.panel([-x, -y + p, m.foot + p], [-x + _BACK_M, y - p, m.height - p], inside, bevel_m=0.0)
    if feet == "plinth":
        parts.panel([-x + 0.008, -y + 0.008, 0.0], [x - 0.012, y - 0.008, m.foot], outside)
        return parts
    for sx, sy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        center = [sx * (x - 0.016), sy * (y - 0.014), m.foot / 2.0]
        parts.visual(cylinder_mesh(0.009, m.foot), fitting, make_pose(np.eye(3), center))
        parts.colliders.append(box_collider([0.016, 0.016, m.foot], center))
    return parts


def _tray(m: _Dimensions, front: SurfaceFinish, inside: SurfaceFinish) -> BodyParts:
    """Make the drawer without its handle."""
    parts = BodyParts(_WOOD_PER_M)
    y = m.tray_width / 2.0
    back, face = m.tray_x
    top = m.floor + m.wall
    parts.panel([back - _WALL_M, -y - _WALL_M, m.floor - _FLOOR_M], [face, y + _WALL_M, m.floor], inside, bevel_m=0.0)
    parts.panel([back - _WALL_M, -y - _WALL_M, m.floor], [face, -y, top], inside)
    parts.panel([back - _WALL_M, y, m.floor], [face, y + _WALL_M, top], inside)
    parts.panel([back - _WALL_M, -y, m.floor], [back, y, top], inside)
    wide = m.width / 2.0 - 0.001
    parts.panel([face, -wide, m.front_bottom], [face + m.front, wide, m.front_top], front, bevel_m=0.002)
    return parts


def _add_handle(
    parts: BodyParts, m: _Dimensions, handle: str, front: SurfaceFinish, fitting: SurfaceFinish, size: float
) -> float:
    """Add a handle to the drawer's front, `size` 0..1 from small to large; return x of the foremost part at the top.

    Bows and knobs sit below the middle, so that fingers can press on the front above them.
    """
    out = m.tray_x[1] + m.front
    z = m.front_bottom + 0.36 * (m.front_top - m.front_bottom)
    if handle == "lip":
        reach = 0.009 + 0.006 * size
        wide = m.width / 2.0 - 0.001
        parts.panel([out, -wide, m.front_top - 0.011], [out + reach, wide, m.front_top], front, bevel_m=0.003)
        return out + reach
    if handle == "knob":
        r = 0.010 + 0.003 * size
        length = 0.022
        profile = [
            [0.0, 0.0], [0.6 * r, 0.0], [0.45 * r, 0.35 * length], [0.9 * r, 0.55 * length], [r, 0.7 * length],
            [0.9 * r, 0.87 * length], [0.5 * r, 0.97 * length], [0.0, length],
        ]  # fmt: skip
        parts.visual(lathe(profile, sections=28, crease_rad=0.9), fitting, make_pose(_R_OUTWARD, [out, 0.0, z]))
        X = make_pose(np.eye(3), [out + length / 2.0, 0.0, z])
        parts.collider(ColliderKind.CYLINDER, (0.9 * r, length / 2.0), X)
        return out
    half = 0.024 + 0.014 * size
    reach = 0.020
    r = 0.0036
    bend = 0.008
    turn = np.linspace(0.0, np.pi / 2.0, 6)
    arc = np.stack([reach - bend + bend * np.sin(turn), half - bend + bend * np.cos(turn)], axis=1)
    side = np.concatenate([[[0.0, half]], arc])
    points = np.concatenate([side, side[::-1] * [1.0, -1.0]])
    bow = np.column_stack([out + points[:, 0], points[:, 1], np.full(len(points), z)])
    parts.visual(sweep(bow, np.full(len(bow), r), sections=14), fitting)
    parts.collider(ColliderKind.CAPSULE, (r, half - bend), make_pose(_R_SIDEWAYS, [out + reach, 0.0, z]))
    for y in (-half, half):
        parts.colliders.append(box_collider([reach, 2.0 * r, 2.0 * r], [out + reach / 2.0, y, z]))
    return out


def _surfaces(finish: str, rng: np.random.Generator) -> tuple[str, SurfaceFinish, SurfaceFinish, SurfaceFinish]:
    """Draw the name, and the surfaces of the cabinet, of the drawer's front and of the inside."""
    kind = str(rng.choice(_WOOD_KINDS))
    paint = str(rng.choice(list(_PAINTS)))
    shade = rng.uniform(0.85, 1.1)
    painted = SurfaceFinish(
        color=rgb(min(shade * c, 1.0) for c in _PAINTS[paint]), roughness=float(rng.uniform(0.35, 0.7))
    )
    wooden = SurfaceFinish(texture=wood(rng, kind), roughness=float(rng.uniform(0.5, 0.8)))
    pale = SurfaceFinish(texture=wood(rng, str(rng.choice(["maple", "pine", "ash"]))), roughness=0.8)
    if finish == "wood":
        return f"{kind} cabinet", wooden, wooden, pale
    if finish == "paint":
        return f"{paint} cabinet", painted, painted, pale
    if finish == "front":
        return f"{kind} cabinet", wooden, painted, pale
    grey = rng.uniform(130, 185) + rng.uniform(-6, 6, 3)
    steel = SurfaceFinish(
        texture=mix(brushed(rng, grey), grey, np.full((1, 1), 0.7)),
        roughness=float(rng.uniform(0.35, 0.5)),
        metallic=float(rng.uniform(0.3, 0.6)),
    )
    return "metal cabinet", steel, steel, SurfaceFinish(color=(0.30, 0.31, 0.33), roughness=0.6)


def _cabinet(asset_id: str, index: int, rng: np.random.Generator) -> AssetModel:
    handle = HANDLES[index % 3]
    finish = FINISHES[(index // 3) % 4]
    m = _draw_dimensions(rng)
    words, outside, front, inside = _surfaces(finish, rng)
    fitting = _FITTINGS[int(rng.integers(len(_FITTINGS)))]
    carcass = _carcass(m, FEET[index // 12], outside, inside, fitting)
    tray = _tray(m, front, inside)
    press = _add_handle(tray, m, handle, front, fitting, float(rng.uniform()))
    material = Material(density=float(rng.uniform(450.0, 700.0)), static_friction=0.45, dynamic_friction=0.4)
    slide = Joint(
        kind=JointKind.SLIDER,
        upper=m.travel,
        friction=float(rng.uniform(0.02, 0.08)),
        damping=float(rng.uniform(20.0, 36.0)),
    )
    back, face = m.tray_x
    return AssetModel(
        asset_id=asset_id,
        words=words,
        bodies=(carcass.body("cabinet", material), tray.body("drawer", material, slide)),
        size={
            "width_m": m.width,
            "depth_m": m.depth,
            "height_m": m.height,
            "travel_m": m.travel,
            "tray_length_m": face - back,
            "tray_width_m": m.tray_width,
            "wall_m": m.wall,
            "reach_m": max(float(v.mesh.vertices[:, 0].max() + v.X_BodyV[0, 3]) for v in tray.visuals) - m.face,
        },
        sites={
            "edge": site_at("cabinet", [m.face, 0.0, m.height]),
            "pull": site_at("drawer", [face, 0.0, m.front_top]),
            "push": site_at("drawer", [press, 0.0, m.front_top]),
            "tray": site_at("drawer", [0.5 * (back + face), 0.0, m.floor]),
        },
    )


KINDS = {"cabinet": _cabinet}
"""Cabinets; sites: `edge` (upper edge over the drawer), `pull` and `push` (top of the drawer's front, inner and outer
side), `tray` (centre of the tray's floor)."""
