"""The fixed surroundings of every scene: a table under everything, a wall and a floor behind the robot."""

from kinebench_drake.suites.assets.look import Background, Finish
from kinebench_drake.suites.assets.model import Body, Material, Visual
from kinebench_drake.suites.assets.parts import block, board

TABLE_SIZE_M = (1.5, 2.4, 0.04)
"""Along x, y, z."""
TABLE_CENTER_M = (0.55, 0.0, -0.02)
"""In B; its top is z = 0."""
FLOOR_M = -0.75
"""Height of the floor."""
WALL_M = -2.8
"""x of the wall behind the robot."""
WALL_TOP_M = 1.3
"""Height of the wall's upper edge: out of view, and low enough for light from behind it."""
SKIRTING_M = (0.03, 8.0, 0.09)
"""The board along the foot of the wall."""
_ROOM_M = 8.0


def _board(size: tuple[float, float, float], center: tuple[float, float, float], look: Finish) -> Visual:
    return board(size, center, look.surface, bevel_m=0.0, uv_per_m=look.uv_per_m)


def surroundings(table: Finish, background: Background) -> dict[str, Body]:
    """The bodies by name, in B."""
    wall_height_m, foot_m = WALL_TOP_M - FLOOR_M, FLOOR_M + 0.5 * SKIRTING_M[2]
    skirting = Finish(surface=background.skirting, uv_per_m=1.0)
    return {
        "table": Body(
            name="table",
            visuals=(_board(TABLE_SIZE_M, TABLE_CENTER_M, table),),
            colliders=(block(TABLE_SIZE_M, TABLE_CENTER_M),),
            material=Material(static_friction=0.6, dynamic_friction=0.5, restitution=0.0),
        ),
        "wall": Body(
            name="wall",
            visuals=(
                _board(
                    (0.1, _ROOM_M, wall_height_m), (WALL_M - 0.05, 0.0, FLOOR_M + 0.5 * wall_height_m), background.wall
                ),
                _board(SKIRTING_M, (WALL_M, 0.0, foot_m), skirting),
            ),
        ),
        "floor": Body(
            name="floor",
            visuals=(_board((_ROOM_M, _ROOM_M, 0.1), (WALL_M + 0.5 * _ROOM_M, 0.0, FLOOR_M - 0.05), background.floor),),
        ),
    }
