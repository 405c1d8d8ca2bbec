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
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.products import IkStatus

CONTROL_PERIOD_S = 0.05
"""Time between two control steps (ManiSkill's 20 Hz)."""
SETTLE_S = 0.3
"""Rest at the end of every motion, for the joint servos to catch up (their lag is 0.1 s)."""
SPEED_M_S, TURN_RATE_RAD_S, FINGER_SPEED_M_S, SHORTEST_S = 0.2, 0.8, 0.3, 0.35
"""Mean speeds that share the clip's time out among the moves, and the least time of one."""
OVERLAP = 0.45
"""Part of the shorter of two moves during which both run, when the first flows through its waypoint."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """Where the gripper shall be after one move."""

    X_BG: Array
    """Pose (4, 4) of panda_hand_tcp in the robot base frame [m]."""
    finger_width_m: float
    """Gap between the pads asked for at the end of the move [m]; less than the object's width squeezes it."""
    through: bool = False
    """Whether the next move begins before this one ends: the waypoint is then passed by, not reached."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """What to command at each control step."""

    q: Array
    """(N, 7) joint angles at the end of each control step [rad]."""
    finger_width_m: Array
    """(N,) gap between the finger pads [m]; negative squeezes."""
    X_BG: Array
    """(N, 4, 4) the same path as poses of panda_hand_tcp in the base frame [m]."""


def minimum_jerk(s: ArrayLike) -> Array:
    """Fraction of the way (...) at fraction `s` (...) of the time, 0 before and 1 after."""
    s = np.clip(np.asarray(s, dtype=np.float64), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _schedule(X: Array, widths: Array, through: Sequence[bool], duration_s: float) -> tuple[Array, Array]:
    """Start and length [s] of each move, so that all of them together last `duration_s`."""
    lengths_s = np.maximum.reduce(
        [
            np.linalg.norm(np.diff(X[:, :3, 3], axis=0), axis=1) / SPEED_M_S,
            rotation_angle(np.swapaxes(X[:-1, :3, :3], 1, 2) @ X[1:, :3, :3]) / TURN_RATE_RAD_S,
            np.abs(np.diff(widths)) / FINGER_SPEED_M_S,
            np.full(len(X) - 1, SHORTEST_S),
        ]
    )
    overlaps_s = OVERLAP * np.minimum(lengths_s[:-1], lengths_s[1:]) * np.asarray(through[:-1], dtype=np.float64)
    starts_s = np.concatenate([[0.0], np.cumsum(lengths_s[:-1] - overlaps_s)])
    scale = duration_s / (starts_s[-1] + lengths_s[-1])
    return scale * starts_s, scale * lengths_s


def cartesian_path(
    X_BG_start: ArrayLike, finger_width_start_m: float, waypoints: Sequence[Waypoint], steps: int
) -> tuple[Array, Array]:
    """Poses (steps, 4, 4) of the TCP in B [m] and finger widths (steps,) [m] at the end of each control step.

    Straight lines and shortest rotations between waypoints, minimum-jerk in time, at rest at both ends.
    """
    X = np.stack([np.asarray(X_BG_start, dtype=np.float64), *(w.X_BG for w in waypoints)])
    widths = np.array([finger_width_start_m, *(w.finger_width_m for w in waypoints)])
    duration_s = steps * CONTROL_PERIOD_S - SETTLE_S
    starts_s, lengths_s = _schedule(X, widths, [w.through for w in waypoints], duration_s)
    t_s = CONTROL_PERIOD_S * np.arange(1, steps + 1)
    done = minimum_jerk((t_s[:, None] - starts_s) / lengths_s)
    p = X[0, :3, 3] + done @ np.diff(X[:, :3, 3], axis=0)
    R = np.broadcast_to(X[0, :3, :3], (steps, 3, 3))
    turns = rotation_log(np.swapaxes(X[:-1, :3, :3], 1, 2) @ X[1:, :3, :3])
    for i, turn in enumerate(turns):
        R = R @ rotation_exp(done[:, i, None] * turn)
    return make_pose(R, p), widths[0] + done @ np.diff(widths)


def plan(
    plant: ArmPlant, q_start: ArrayLike, finger_width_start_m: float, waypoints: Sequence[Waypoint], steps: int
) -> Motion:
    """Joint path of `steps` control steps through the waypoints, from rest at `q_start` (7,) [rad] to rest.

    Raises:
        InputError: a pose has no joint solution near its predecessor's, or a joint would exceed its speed limit.
    """
    q_start = np.asarray(q_start, dtype=np.float64)
    X_BG, widths = cartesian_path(plant.forward(q_start), finger_width_start_m, waypoints, steps)
    q = np.empty((steps, 7))
    seed = q_start
    for i, X in enumerate(X_BG):
        solution = solve_pose(plant, X, seed)
        if solution.status is not IkStatus.OK:
            raise InputError(
                f"the expert's path leaves the workspace at control step {i} of {steps}: {solution.status.value} at "
                f"{np.round(X[:3, 3], 3).tolist()} m in the base frame"
            )
        q[i] = seed = solution.q
    speed = np.abs(np.diff(q, axis=0, prepend=q_start[None])) / CONTROL_PERIOD_S
    if (speed > plant.velocity_limits).any():
        step, joint = np.unravel_index(np.argmax(speed / plant.velocity_limits), speed.shape)
        raise InputError(
            f"the expert's path needs {speed[step, joint]:.2f} rad/s of joint {joint + 1} at control step {step}, "
            f"limit {plant.velocity_limits[joint]:.2f}; give it more frames"
        )
    return Motion(q=q, finger_width_m=widths, X_BG=X_BG)
