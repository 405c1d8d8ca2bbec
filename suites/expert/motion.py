"""Plan a smooth joint path through gripper waypoints: blended minimum-jerk moves, then inverse kinematics.

Each move's displacement follows the minimum-jerk profile of Flash and Hogan (1985, eq. 3: 10 s^3 - 15 s^4 + 6 s^5). A
move that need not stop at its waypoint overlaps with the next, and the displacements are summed (Flash and Henis 1991),
so that the gripper passes such waypoints without stopping.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_angle, rotation_exp, rotation_log
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.continuation import minimum_jerk, plan_continuation, solve_stepwise
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import CONTROL_PERIOD_S
from kinebench_drake.suites.expert.clearance import SceneGeometry
from kinebench_drake.suites.families.task import Scene

SPEED_M_S = 0.2
TURN_RATE_RAD_S = 0.8
FINGER_SPEED_M_S = 0.3
SHORTEST_S = 0.35
"""Mean speeds by which the clip's time is divided among the moves, and the least duration of a move."""
CLEARANCE_STEPS = 4
"""Number of control steps between collision checks."""
OVERLAP = 0.45
"""Overlap of two moves as a fraction of the shorter one, if the waypoint between them is passed without stopping."""
REST_S = 0.3
"""Rest at the end of every path, for the joint servos to catch up (their lag is 0.1 s)."""
DEPTH_M = 0.001
"""Tolerated penetration of objects in the scene."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arc:
    """Rotation about a fixed line, such as a hinge."""

    point: Array
    """(3,) point on the line, in B [m]."""
    axis: Array
    """(3,) unit vector along it, in B."""
    angle_rad: float
    """Rotation angle, right-handed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """Target of one move of the gripper."""

    X_BG: Array
    """Pose (4, 4) of panda_hand_tcp in the robot base frame [m]."""
    finger_width_m: float
    """Commanded gap between the pads at the end of the move [m]; less than the object's width squeezes it."""
    through: bool = False
    """True if the next move begins before this one ends: the waypoint is then passed nearby, not reached."""
    arc: Arc | None = None
    """Path to the pose; None: a straight line. A remaining offset between arc and pose is added linearly."""
    pace: float = 1.0
    """Factor on the duration of the move: 2 for half the speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPlan:
    """Commands at each control step."""

    q: Array
    """(N, 7) joint angles at the end of each control step [rad]."""
    finger_width_m: Array
    """(N,) gap between the finger pads [m]; negative squeezes."""


def _path_lengths(p: Array, waypoints: Sequence[Waypoint]) -> Array:
    """Return the path length (M,) [m] of each move between the positions `p` (M + 1, 3)."""
    lengths: Array = np.linalg.norm(np.diff(p, axis=0), axis=1)
    for i, waypoint in enumerate(waypoints):
        if waypoint.arc is not None:
            radius = np.linalg.norm(np.cross(waypoint.arc.axis, p[i] - waypoint.arc.point))
            lengths[i] = max(lengths[i], radius * abs(waypoint.arc.angle_rad))
    return lengths


def _schedule(X: Array, widths: Array, waypoints: Sequence[Waypoint], duration_s: float) -> tuple[Array, Array]:
    """Return the start and duration [s] of each move, scaled so that the whole takes `duration_s`."""
    through = [w.through for w in waypoints]
    lengths_s = np.array([w.pace for w in waypoints]) * np.maximum.reduce(
        [
            _path_lengths(X[:, :3, 3], waypoints) / SPEED_M_S,
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
    """Return the displacement (N, 3) [m] of a move from `start` towards `end` (3,) at the fractions `done` (N,)."""
    straight = end - start
    if arc is None:
        return np.asarray(done[:, None] * straight)
    lever = start - arc.point
    arced = rotation_exp(np.append(done, 1.0)[:, None] * arc.angle_rad * arc.axis) @ lever - lever
    return np.asarray(arced[:-1] + done[:, None] * (straight - arced[-1]))


def cartesian_path(
    X_BG_start: ArrayLike, finger_width_start_m: float, waypoints: Sequence[Waypoint], steps: int
) -> tuple[Array, Array]:
    """Return TCP poses (steps, 4, 4) in B [m] and finger widths (steps,) [m] at the end of each control step.

    Straight lines or arcs and shortest rotations between waypoints, minimum-jerk in time, at rest at both ends.
    """
    X = np.stack([np.asarray(X_BG_start, dtype=np.float64), *(w.X_BG for w in waypoints)])
    widths = np.array([finger_width_start_m, *(w.finger_width_m for w in waypoints)])
    starts_s, lengths_s = _schedule(X, widths, waypoints, steps * CONTROL_PERIOD_S - REST_S)
    done = minimum_jerk(((CONTROL_PERIOD_S * np.arange(1, steps + 1))[:, None] - starts_s) / lengths_s)
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
) -> MotionPlan:
    """Plan a joint path of `steps` control steps through the waypoints, from rest at `q_start` (7,) [rad] to rest.

    Drake's plant checks joint limits, speed and acceleration limits, and collisions with the arm itself, the table and
    the static objects of the scene.

    Args:
        q_start: (7,) joint angles [rad].
        finger_width_start_m: gap between the finger pads [m].
        scene: scene for the collision check; None for none.

    Raises:
        InputError: the path leaves the workspace, exceeds a speed or acceleration limit, or makes the arm collide with
            itself, the table or an object.
    """
    q_start = np.asarray(q_start, dtype=np.float64)
    X_BG, widths = cartesian_path(plant.forward(q_start), finger_width_start_m, waypoints, steps)
    try:
        q = _stepwise(plant, q_start, X_BG)
        _check_rates(plant, q_start, q)
    except InputError as error:
        t_s = np.asarray(CONTROL_PERIOD_S * np.arange(1, len(X_BG) + 1), dtype=np.float64)
        q = plan_continuation(plant, t_s, X_BG, q_start)
        if not np.isfinite(q).all():
            raise error
        _check_rates(plant, q_start, q)
    _check_clearance(plant, q, widths, scene)
    return MotionPlan(q=q, finger_width_m=widths)


def _stepwise(plant: ArmPlant, q_start: Array, X_BG: Array) -> Array:
    """Solve the inverse kinematics step by step; raise InputError at the first pose that is not reached."""
    q, missed = solve_stepwise(plant, X_BG, q_start)
    if missed is not None:
        i = int(np.argmax(~np.isfinite(q[:, 0])))
        raise InputError(
            f"the expert's path leaves the workspace at control step {i} of {len(X_BG)}: {missed.status.value} "
            f"at {np.round(X_BG[i, :3, 3], 3).tolist()} m in the base frame"
        )
    return q


def _check_rates(plant: ArmPlant, q_start: Array, q: Array) -> None:
    """Raise InputError if a joint exceeds its speed or acceleration limit."""
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
    """Raise InputError if the arm collides with itself, the table or a static object."""
    model = CollisionModel(plant)
    every = slice(None, None, CLEARANCE_STEPS)
    gaps = np.clip(widths[every], 0.0, plant.finger_width_m)
    for hit in () if scene is None else SceneGeometry(plant, scene).penetrations(q[every], gaps):
        if hit.depth_m > DEPTH_M:
            raise InputError(
                f"the expert's path has {hit.link} and {hit.object_name} collide by {1000.0 * hit.depth_m:.1f} mm at "
                f"control step {CLEARANCE_STEPS * hit.step}"
            )
    for clearance in (model.self_distance(q[every], gaps), model.table_distance(q[every], gaps)):
        i = int(np.nanargmin(clearance.distance_m))
        if clearance.distance_m[i] < 0.0:
            raise InputError(
                f"the expert's path has {' and '.join(clearance.pair[i] or ())} collide by "
                f"{-1000.0 * clearance.distance_m[i]:.1f} mm at control step {CLEARANCE_STEPS * i}"
            )
