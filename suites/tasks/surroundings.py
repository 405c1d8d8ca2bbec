"""The fixed surroundings of every scene: a table under everything, a wall and a floor behind the robot."""

import numpy as np

from kinebench_drake.geometry import make_pose
from kinebench_drake.suites.assets.look import Background, Table
from kinebench_drake.suites.assets.mesh import box_mesh
from kinebench_drake.suites.assets.model import Body, Collider, ColliderKind, Material, Visual

TABLE_SIZE_M = (1.5, 2.4, 0.04)
"""Along x, y, z."""
TABLE_CENTER_M = (0.55, 0.0, -0.02)
"""In B; its top is z = 0."""
FLOOR_M = -0.9
"""Height of the floor."""
WALL_M = -1.3
"""x of the wall behind the robot."""
WALL_TOP_M = 1.3
"""Height of the wall's upper edge: out of view, and low enough for light from behind it."""
_ROOM_M = 8.0


def surroundings(table: Table, background: Background) -> dict[str, Body]:
    """The bodies by name, in B."""
    at_table = make_pose(np.eye(3), TABLE_CENTER_M)
    half = tuple(0.5 * x for x in TABLE_SIZE_M)
    wall, floor = [0.1, _ROOM_M, WALL_TOP_M - FLOOR_M], [_ROOM_M, _ROOM_M, 0.1]
    return {
        "table": Body(
            name="table",
            visuals=(
                Visual(mesh=box_mesh(TABLE_SIZE_M, uv_per_m=table.uv_per_m), surface=table.surface, X_BodyV=at_table),
            ),
            colliders=(Collider(kind=ColliderKind.BOX, size=half, X_BodyC=at_table),),
            material=Material(static_friction=0.6, dynamic_friction=0.5, restitution=0.0),
        ),
        "wall": Body(
            name="wall",
            visuals=(
                Visual(
                    mesh=box_mesh(wall, uv_per_m=background.uv_per_m),
                    surface=background.wall,
                    X_BodyV=make_pose(np.eye(3), [WALL_M - 0.05, 0.0, 0.5 * (WALL_TOP_M + FLOOR_M)]),
                ),
            ),
        ),
        "floor": Body(
            name="floor",
            visuals=(
                Visual(
                    mesh=box_mesh(floor, uv_per_m=background.uv_per_m),
                    surface=background.floor,
                    X_BodyV=make_pose(np.eye(3), [WALL_M + _ROOM_M / 2.0, 0.0, FLOOR_M - 0.05]),
                ),
            ),
        ),
    }
