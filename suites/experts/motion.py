"""From a few gripper poses to a smooth joint path: minimum-jerk moves that blend, then inverse kinematics.

Each move's displacement follows the minimum-jerk profile of Flash and Hogan (1985, eq. 3: 10 s^3 - 15 s^4 + 6 s^5); a
move that need not stop at its waypoint overlaps with the next, and the displacements are summed (Flash and Henis 1991).
So the gripper swings past such points instead of resting there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_angle, rotation_exp, rotation_log
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.continuation import foreseeing, minimum_jerk, stepwise
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import CONTROL_PERIOD_S
from kinebench_drake.suites.experts.clearance import SceneGeometry
from kinebench_drake.suites.tasks.task import Scene

SETTLE_S = 0.3
"""Rest at the end of every motion, for the joint servos to catch up (their lag is 0.1 s)."""
SPEED_M_S, TURN_RATE_RAD_S, FINGER_SPEED_M_S, SHORTEST_S = 0.2, 0.8, 0.3, 0.35
"""Mean speeds that share the clip's time out among the moves, and the least time of one."""
TOUCH_M = 0.001
"""Overlap with things in the scene that is let pass."""
CLEARANCE_STEPS = 4
"""Collisions are looked for at one in so many control steps."""
OVERLAP = 0.45
"""Part of the shorter of two moves during which both run, when the first flows through its waypoint."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arc:
    """A turn about a fixed line, such as a hinge."""

    point: Array
    """(3,) a point of the line, in B [m]."""
    axis: Array
    """(3,) unit vector along it, in B."""
    angle_rad: float
    """How far the turn goes, right-handed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """Where the gripper shall be after one move."""

    X_BG: Array
    """Pose (4, 4) of panda_hand_tcp in the robot base frame [m]."""
    finger_width_m: float
    """Gap between the pads asked for at the end of the move [m]; less than the object's width squeezes it."""
    through: bool = False
    """Whether the next move begins before this one ends: the waypoint is then passed by, not reached."""
    arc: Arc | None = None
    """The way there; a straight line if None. What the arc leaves to the pose is made up for in a straight line."""
    pace: float = 1.0
    """How much longer than others of its length the move takes: 2 for half the speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """What to command at each control step."""

    q: Array
    """(N, 7) joint angles at the end of each control step [rad]."""
    finger_width_m: Array
    """(N,) gap between the finger pads [m]; negative squeezes."""
    X_BG: Array
    """(N, 4, 4) the same path as poses of panda_hand_tcp in the base frame [m]."""


def _ways(p: Array, waypoints: Sequence[Waypoint]) -> Array:
    """Length (M,) [m] of the way of each move between the positions `p` (M + 1, 3)."""
    ways: Array = np.linalg.norm(np.diff(p, axis=0), axis=1)
    for i, waypoint in enumerate(waypoints):
        if waypoint.arc is not None:
            radius = np.linalg.norm(np.cross(waypoint.arc.axis, p[i] - waypoint.arc.point))
            ways[i] = max(ways[i], radius * abs(waypoint.arc.angle_rad))
    return ways


def _schedule(X: Array, widths: Array, waypoints: Sequence[Waypoint], duration_s: float) -> tuple[Array, Array]:
    """Start and length [s] of each move, so that all of them together last `duration_s`."""
    through = [w.through for w in waypoints]
    lengths_s = np.array([w.pace for w in waypoints]) * np.maximum.reduce(
        [
            _ways(X[:, :3, 3], waypoints) / SPEED_M_S,
            rotation_angle(np.swapaxes(X[:-1, :3, :3], 1, 2) @ X[1:, :3, :3]) / TURN_RATE_RAD_S,
            np.abs(np.diff(widths)) / FINGER_SPEED_M_S,
            np.full(len(X) - 1, SHORTEST_S),
        ]
    )
    overlaps_s = OVERLAP * np.minimum(lengths_s[:-1], lengths_s[1:]) * np.asarray(through[:-1], dtype=np.float64)
    starts_s = np.concatenate([[0.0], np.cumsum(lengths_s[:-1] - overlaps_s)])
    scale = duration_s / (starts_s[-1] + lengths_s[-1])
    return scale * starts_s, scale * lengths_s


def _displacement(start: Array, end: Array, arc: Arc | None, done: Array) -> Array:
    """How far (N, 3) [m] a move has come from `start` towards `end` (3,) at the fractions `done` (N,) of its way."""
    straight = end - start
    if arc is None:
        return np.asarray(done[:, None] * straight)
    lever = start - arc.point
    turned = rotation_exp(np.append(done, 1.0)[:, None] * arc.angle_rad * arc.axis) @ lever - lever
    return np.asarray(turned[:-1] + done[:, None] * (straight - turned[-1]))


def cartesian_path(
    X_BG_start: ArrayLike, finger_width_start_m: float, waypoints: Sequence[Waypoint], steps: int
) -> tuple[Array, Array]:
    """Poses (steps, 4, 4) of the TCP in B [m] and finger widths (steps,) [m] at the end of each control step.

    Straight lines or arcs and shortest rotations between waypoints, minimum-jerk in time, at rest at both ends.
    """
    X = np.stack([np.asarray(X_BG_start, dtype=np.float64), *(w.X_BG for w in waypoints)])
    widths = np.array([finger_width_start_m, *(w.finger_width_m for w in waypoints)])
    duration_s = steps * CONTROL_PERIOD_S - SETTLE_S
    starts_s, lengths_s = _schedule(X, widths, waypoints, duration_s)
    t_s = CONTROL_PERIOD_S * np.arange(1, steps + 1)
    done = minimum_jerk((t_s[:, None] - starts_s) / lengths_s)
    p = X[0, :3, 3] + sum(
        _displacement(X[i, :3, 3], X[i + 1, :3, 3], waypoint.arc, done[:, i]) for i, waypoint in enumerate(waypoints)
    )
    R = np.broadcast_to(X[0, :3, :3], (steps, 3, 3))
    turns = rotation_log(np.swapaxes(X[:-1, :3, :3], 1, 2) @ X[1:, :3, :3])
    for i, turn in enumerate(turns):
        R = R @ rotation_exp(done[:, i, None] * turn)
    return make_pose(R, p), widths[0] + done @ np.diff(widths)


def plan(
    plant: ArmPlant,
    q_start: ArrayLike,
    finger_width_start_m: float,
    waypoints: Sequence[Waypoint],
    steps: int,
    scene: Scene | None = None,
) -> Motion:
    """Joint path of `steps` control steps through the waypoints, from rest at `q_start` (7,) [rad] to rest.

    Drake's plant says which postures reach the poses within joint limits, which of them collide with the arm itself,
    the table or what stands in the scene, and how fast and how hard the joints may move.

    Args:
        plant: the robot.
        q_start: (7,) joint angles [rad].
        finger_width_start_m: gap between the finger pads [m].
        waypoints: where to go.
        steps: control steps.
        scene: what stands around; nothing if None.

    Raises:
        InputError: the path leaves the workspace, a speed or acceleration limit is broken, or the arm would hit itself,
            the table or something in the scene.
    """
    q_start = np.asarray(q_start, dtype=np.float64)
    X_BG, widths = cartesian_path(plant.forward(q_start), finger_width_start_m, waypoints, steps)
    try:
        q = _stepwise(plant, q_start, X_BG)
        _check_rates(plant, q_start, q)
    except InputError as error:
        t_s = np.asarray(CONTROL_PERIOD_S * np.arange(1, len(X_BG) + 1), dtype=np.float64)
        q = foreseeing(plant, t_s, X_BG, q_start)
        if not np.isfinite(q).all():
            raise error
        _check_rates(plant, q_start, q)
    _check_clearance(plant, q, widths, scene)
    return Motion(q=q, finger_width_m=widths, X_BG=X_BG)


def _stepwise(plant: ArmPlant, q_start: Array, X_BG: Array) -> Array:
    q, missed = stepwise(plant, X_BG, q_start)
    if missed is not None:
        i = int(np.argmax(~np.isfinite(q[:, 0])))
        raise InputError(
            f"the expert's path leaves the workspace at control step {i} of {len(X_BG)}: {missed.status.value} "
            f"at {np.round(X_BG[i, :3, 3], 3).tolist()} m in the base frame"
        )
    return q


def _check_rates(plant: ArmPlant, q_start: Array, q: Array) -> None:
    rates = np.diff(np.concatenate([q_start[None], q]), axis=0) / CONTROL_PERIOD_S
    changes = np.diff(rates, axis=0, prepend=0.0 * rates[:1]) / CONTROL_PERIOD_S
    for name, unit, values, limits in (
        ("speed", "rad/s", rates, plant.velocity_limits),
        ("acceleration", "rad/s^2", changes, plant.acceleration_limits),
    ):
        if limits is not None and (np.abs(values) > limits).any():
            step, joint = np.unravel_index(np.argmax(np.abs(values) / limits), values.shape)
            raise InputError(
                f"the expert's path needs {name} {abs(values[step, joint]):.2f} {unit} of joint {joint + 1} at control "
                f"step {step}, limit {limits[joint]:.2f}; give it more time"
            )


def _check_clearance(plant: ArmPlant, q: Array, widths: Array, scene: Scene | None) -> None:
    model, every = CollisionModel(plant), slice(None, None, CLEARANCE_STEPS)
    gaps = np.clip(widths[every], 0.0, plant.finger_width_m)
    for touch in () if scene is None else SceneGeometry(plant, scene).touches(q[every], gaps):
        if touch.depth_m > TOUCH_M:
            raise InputError(
                f"the expert's path has {touch.link} and {touch.thing} collide by {1000.0 * touch.depth_m:.1f} mm at "
                f"control step {CLEARANCE_STEPS * touch.step}"
            )
    for clearance in (model.self_distance(q[every], gaps), model.table_distance(q[every], gaps)):
        i = int(np.nanargmin(clearance.distance_m))
        if clearance.distance_m[i] < 0.0:
            raise InputError(
                f"the expert's path has {' and '.join(clearance.pair[i] or ())} collide by "
                f"{-1000.0 * clearance.distance_m[i]:.1f} mm at control step {CLEARANCE_STEPS * i}"
            )
