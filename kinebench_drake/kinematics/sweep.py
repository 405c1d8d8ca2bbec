"""Contacts of the arm with obstacles along a joint path, also between its postures.

Between two postures every joint moves in proportion. The signed distance of two convex bodies changes by at most the
way of their points. So a stretch of the path is free if, at its middle, the distance exceeds the way of the link up to
either end; else it is halved, until that way is below `RESOLUTION_M` (conservative advancement: X. Zhang et al.,
"Continuous collision detection for articulated models using Taylor models and temporal culling", 2007).
"""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array, cross, transform_points
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.segments import finite_rows

RESOLUTION_M = 5e-4
"""Contacts deeper than the tolerance by this are never missed [m]."""
DEPTH_FACTOR = 1.1
"""Depths are known to a tenth, where that is more than `RESOLUTION_M`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """Contact of a link with an obstacle along a path of T postures."""

    link: str
    obstacle: str
    """Link of the obstacle."""
    distance_m: Array
    """(2 T - 1,) least signed distance at each posture and, between, on the way to the next [m]; inf if none."""


def sweep(plant: ArmPlant, model: CollisionModel, q: Array, finger_width_m: Array, tolerance_m: float) -> list[Contact]:
    """Find the contacts with obstacles that are deeper than `tolerance_m` [m].

    Args:
        q: (T, J) joint angles [rad]; NaN where unknown: the ways from and to there are left out.
        finger_width_m: (T,) gap between the finger pads [m]; NaN for the plant's default.
        tolerance_m: depth up to which a contact is none [m].
    """
    if not model.obstacles:
        return []
    slots = np.arange(2 * len(q) - 1)
    finite = finite_rows(q)
    slots = slots[finite[slots // 2] & finite[(slots + 1) // 2]]
    width = np.where(np.isfinite(finger_width_m), finger_width_m, plant.finger_width_m)
    low, high = np.swapaxes([block.box() for block in model.obstacles], 0, 1)
    least = np.full((2 * len(q) - 1, len(model.movable), len(model.obstacles)), np.inf)
    # stretches of the path, in postures
    start = slots // 2 + 0.0
    end = (slots + 1) // 2 + 0.0
    while len(slots):
        middle = 0.5 * (start + end)
        first = slots // 2
        share = (middle - first)[:, None]
        rows = (1.0 - share) * q[first] + share * q[first + slots % 2]
        gaps = np.interp(middle, np.arange(len(q)), width)
        turn = 0.5 * (end - start)[:, None] * np.abs(q[first + slots % 2] - q[first])
        slide = 0.25 * (end - start) * np.abs(width[first + slots % 2] - width[first])
        M = plant.chain.motions(rows, gaps)
        center, way = _ways(plant, model, M, turn, slide)
        beyond = np.maximum(low - center[:, :, None], center[:, :, None] - high)  # of the boxes around the obstacles
        apart = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) - model.radii[:, None]
        depth_m = np.where(np.isfinite(least[slots]), least[slots], 0.0)
        of_interest = np.minimum(-tolerance_m, np.minimum(depth_m - RESOLUTION_M, DEPTH_FACTOR * depth_m))
        near = apart - way[..., None] < of_interest
        halved = np.zeros(len(slots), dtype=bool)
        for i in np.flatnonzero(near.any(axis=(1, 2))):
            reach = float(way[i][near[i].any(axis=-1)].max())
            for a, b, distance, bound in model.near_obstacles(rows[i], float(gaps[i]), M[i], reach, near[i]):
                if distance < -tolerance_m:
                    least[slots[i], a, b] = min(least[slots[i], a, b], distance)
                halved[i] |= way[i, a] > RESOLUTION_M and bound - way[i, a] < of_interest[i, a, b]
        slots = np.repeat(slots[halved], 2)
        start = start[halved]
        end = end[halved]
        middle = middle[halved]
        start = np.stack([start, middle], axis=1).ravel()
        end = np.stack([middle, end], axis=1).ravel()
    contacts: dict[tuple[str, str], Array] = {}
    for a, b in np.argwhere(np.isfinite(least).any(axis=0)):
        pair = model.movable[a].link, model.obstacles[b].link
        contacts[pair] = np.minimum(contacts.get(pair, np.inf), least[:, a, b])
    return [Contact(link=link, obstacle=block, distance_m=d) for (link, block), d in contacts.items()]


def _ways(plant: ArmPlant, model: CollisionModel, M: Array, turn: Array, slide: Array) -> tuple[Array, Array]:
    """Return centres (N, S, 3) of the balls around the moving solids and the greatest way (N, S) of their points [m].

    Joints are turned by `turn` (N, J) [rad] one after the other, the last first: each moves a point by its distance
    from the axis, plus the way it has gone already, times the turn. Fingers slide by `slide` (N,) [m].
    """
    stages = [solid.stage for solid in model.movable]
    center = transform_points(M[:, stages], model.centers[:, None])[:, :, 0]
    axis, point = plant.chain.axes(M)
    arm = np.linalg.norm(cross(axis[:, None], center[:, :, None] - point[:, None]), axis=-1) + model.radii[:, None]
    carries = np.array([plant.chain.carries(solid.link) for solid in model.movable])
    way = np.repeat(slide[:, None], len(stages), axis=1)
    for j in reversed(range(turn.shape[1])):
        way = way + carries[:, j] * turn[:, j, None] * (arm[..., j] + way if plant.chain.turns[j] else 1.0)
    return center, way
