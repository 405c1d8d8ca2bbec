"""Small cubes to stack, pull and store."""

from functools import partial

import numpy as np

from kinebench_drake.suites.assets.mesh import box_mesh
from kinebench_drake.suites.assets.model import Body, Collider, ColliderKind, Kind, Material, Model, Surface, Visual

COLORS = {"red": (0.65, 0.03, 0.03), "green": (0.04, 0.42, 0.06), "blue": (0.03, 0.09, 0.6)}
"""Linear RGB."""
EDGE_M = (0.036, 0.044)
"""Least and greatest edge."""


def _cube(name: str, asset_id: str, index: int, rng: np.random.Generator) -> Model:
    edge = float(rng.uniform(*EDGE_M))
    color = np.clip(np.array(COLORS[name]) * rng.uniform(0.75, 1.25, size=3), 0.0, 1.0)
    surface = Surface(
        color=(float(color[0]), float(color[1]), float(color[2])), roughness=float(rng.uniform(0.35, 0.9))
    )
    body = Body(
        name="cube",
        visuals=(Visual(mesh=box_mesh([edge] * 3, bevel_m=0.0015), surface=surface),),
        colliders=(Collider(kind=ColliderKind.BOX, size=(edge / 2.0,) * 3),),
        material=Material(density=float(rng.uniform(350.0, 700.0)), static_friction=0.9, dynamic_friction=0.8),
    )
    return Model(kind=f"cube/{name}", asset_id=asset_id, words=f"{name} cube", bodies=(body,), size={"edge_m": edge})


KINDS = tuple(Kind(name=f"cube/{color}", make=partial(_cube, color)) for color in COLORS)
"""Cubes of each colour."""
