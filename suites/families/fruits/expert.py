"""Experts for the tasks with fruits."""

import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.suites.expert.grasp import DOWN, OPEN_M, grasp_rotation, lift, nearest_axis, pick_and_place
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.fruits.containers import compartment_center
from kinebench_drake.suites.families.fruits.task import ORDER
from kinebench_drake.suites.families.task import Scene

ABOVE_M = 0.10
"""Height above a fruit from which the gripper approaches and to which it retreats."""
DROP_M = 0.014
"""Height above the floor of a container from which a fruit is released."""
OVER_M = 0.028
"""Gap below a fruit that is carried over an obstacle."""
EXCESS_M = 0.022
"""Finger width in excess of the fruit's thickness before the grasp."""
LOWEST_M = 0.022
"""Least height of the TCP at which palm and fingertips are clear of the table."""
RIM_M = 0.012
"""Height of the TCP above a rim that the fingertips must clear."""
CRATE_DROP_M = 0.004
"""Height above the floor of a crate from which a fruit is released; its rim usually determines the height."""


def _grasp(scene: Scene, name: str) -> tuple[Array, float]:
    """Return the TCP pose (4, 4) that grasps a fruit and the finger width before it closes [m]."""
    X = scene.poses[name]
    axis_y = scene.X_BG[:3, 1]
    closing = np.array([0.0, np.sign(axis_y[1]) or 1.0, 0.0])
    if scene.size(name, "oblong") > 0.5:
        across = X[:3, 1] * [1.0, 1.0, 0.0]
        closing = nearest_axis([across, -across], axis_y)
    p = np.array([*X[:2, 3], max(X[2, 3], LOWEST_M)])
    return make_pose(grasp_rotation(DOWN, closing), p), min(OPEN_M, scene.size(name, "grip_m") + EXCESS_M)


def _carry(
    scene: Scene,
    name: str,
    target: Array,
    across: Array,
    *,
    drop_m: float,
    rim_m: float = 0.0,
    over: Array | None = None,
) -> list[Waypoint]:
    """Grasp a fruit, carry it, release it and retreat upwards.

    Args:
        scene: the scene.
        name: the fruit.
        target: (3,) final position of the middle of its underside [m].
        across: (3,) closing direction of the fingers there.
        drop_m: height from which to release.
        rim_m: height that the fingertips must clear there.
        over: (3,) top of an obstacle on the way.
    """
    grasp, open_m = _grasp(scene, name)
    below = grasp[2, 3] - scene.poses[name][2, 3] + scene.size(name, "rest_m")  # from the fruit's underside to the TCP
    landing = grasp_rotation(DOWN, nearest_axis([across, -across], grasp[:3, 1]))
    place = make_pose(landing, [target[0], target[1], max(target[2] + below + drop_m, rim_m + RIM_M)])
    above = lift(grasp, ABOVE_M)
    passage = []
    if over is not None:
        passage = [lift(make_pose(landing, over), below + OVER_M)]
        above[2, 3] = passage[0][2, 3]
    via = [above, *passage, lift(place, 0.7 * ABOVE_M)]
    return pick_and_place(above, grasp, via, place, lift(place, 1.1 * ABOVE_M), open_m=open_m, release_m=open_m)


def pick_fruits(scene: Scene) -> list[Waypoint]:
    """Put the target into the container, passing above an obstacle if there is one."""
    over = None
    if "obstacle" in scene.poses:
        over = scene.poses["obstacle"][:3, 3] + [0.0, 0.0, scene.size("obstacle", "height_m")]
    target = scene.poses["container"][:3, 3] + [0.0, 0.0, scene.size("container", "floor_m")]
    return _carry(scene, "target", target, np.array([0.0, 1.0, 0.0]), drop_m=DROP_M, over=over)


def store_fruits(scene: Scene) -> list[Waypoint]:
    """Put the next fruit that is not in its compartment there; return nothing if all are."""
    crate = scene.poses["crate"]
    for number, name in enumerate(ORDER):
        center = compartment_center(lambda measure: scene.size("crate", measure), number)
        p = crate[:3, :3].T @ (scene.poses[name][:3, 3] - crate[:3, 3])
        low = p[2] < scene.size("crate", "rim_m") + scene.size(name, "rest_m")
        in_y = abs(p[1] - center[1]) < 0.5 * scene.size("crate", "pitch_m")
        if low and in_y and abs(p[0]) < 0.5 * scene.size("crate", "inner_x_m"):
            continue
        target = crate[:3, :3] @ center + crate[:3, 3]
        return _carry(scene, name, target, crate[:3, 1], drop_m=CRATE_DROP_M, rim_m=scene.size("crate", "rim_m"))
    return []


EXPERTS = {"PickFruits-v1": pick_fruits, "StoreFruitsBox-v1": store_fruits}
"""Experts of this family by task id."""
