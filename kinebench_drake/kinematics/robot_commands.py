"""Robot commands: a feasible trajectory as joint angles at a fixed rate, from rest to rest, within every limit.

The geometry is that of the spline that proves the tube (`trajopt`). Its time runs from 0 to 1 and back to 0 in smooth
ramps at both ends, and slower throughout by the least factor that finite differences of the commands ask for.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.joint_trajectory import JointTrajectory
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.sweep import sweep
from kinebench_drake.kinematics.trajopt import optimize_in_tube
from kinebench_drake.track import GripperTrack
from kinebench_drake.violation import COLLISIONS, ViolationKind

STRETCHES = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Factors by which a track is slowed down until a trajectory in its tube keeps the limits."""
LONGEST_S = 600.0
"""Longest motion that is exported [s]."""

_RAMP_S = 0.5  # on the clock of the spline, at either end
_INSIDE = 1.0 - 1e-4  # greatest ratio to a limit
_ROUNDS = 60
# Exponents of the ratio to a limit in the factor by which the motion is slowed down; torques have a part at rest.
_ORDERS = {"velocity": 1.0, "acceleration": 0.5, "jerk": 1.0 / 3.0, "torque": 0.25, "torque rate": 0.4}
_SWEPT_S = 0.02  # time between the postures between which obstacles are looked for
_FIXED = (*COLLISIONS, ViolationKind.OBSTACLE_COLLISION, ViolationKind.UNREACHABLE, ViolationKind.JOINT_LIMIT)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotCommands:
    """Commands of a motion from rest to rest."""

    q: Array
    """(N, J) joint angles at times k / rate [rad]."""
    finger_width_m: Array
    """(N,) gap between the finger pads [m]; NaN where unknown."""
    frame_t_s: Array
    """(T,) times at which the frames of the track are reached [s]."""
    slower: float
    """Factor by which the motion is slower than the track, apart from its ramps."""
    tube_radius_m: float
    """Radius of the tube about the track in which the motion is [m]."""


def plan_commands(
    plant: ArmPlant, collision: CollisionModel, track: GripperTrack, q: Array, *, rate_hz: float, tube_limit_m: float
) -> RobotCommands:
    """Plan commands in the tube about a track, from its joint path `q` (T, J) [rad].

    Raises:
        InputError: there are no such commands, with the reason.
    """
    t_s = track.t_s - track.t_s[0]
    finite = np.isfinite(track.finger_width_m)
    X_BG = np.where(track.tracked[:, None, None], track.X_BG, np.nan)
    widths = np.where(finite, track.finger_width_m, plant.finger_width_m)
    for stretch in STRETCHES:
        tube = optimize_in_tube(
            plant, collision, stretch * t_s, X_BG, q, tube_limit_m=tube_limit_m, finger_width_m=widths
        )
        if tube.feasible or (tube.violation is not None and tube.violation.kind in _FIXED):
            break
    trajectory = tube.certificate
    if not tube.feasible or trajectory is None:
        raise InputError(f"no commands keep within {1000.0 * tube_limit_m:.3g} mm of the track: {tube.reason}")
    factor = 1.0
    for _ in range(_ROUNDS):
        s = _clock(trajectory, factor, rate_hz)
        if len(s) > LONGEST_S * rate_hz:
            break
        commands = trajectory.basis.evaluate(trajectory.control, s)
        used = {name: float(ratio.max()) / _INSIDE for name, ratio in limit_ratios(plant, commands, rate_hz)}
        needed = max(used[name] ** order for name, order in _ORDERS.items() if name in used)
        if needed <= 1.0:
            times = stretch * t_s - trajectory.problem.origin_s
            gap = np.interp(s, times, widths) if finite.any() else np.full(len(s), np.nan)
            every = max(int(_SWEPT_S * rate_hz), 1)
            if contacts := sweep(plant, collision, commands[::every], gap[::every], 0.0):
                raise InputError(f"the motion between frames meets {contacts[0].obstacle} with {contacts[0].link}")
            reached = np.interp(times, s[: np.argmax(s) + 1], np.arange(np.argmax(s) + 1)) / rate_hz
            radius_m = tube.radius_m or 0.0
            return RobotCommands(
                q=commands, finger_width_m=gap, frame_t_s=reached, slower=stretch * factor, tube_radius_m=radius_m
            )
        factor *= 1.001 * needed
    raise InputError(f"no commands shorter than {LONGEST_S:g} s keep the limits: the arm's weight nearly exceeds one")


def _clock(trajectory: JointTrajectory, factor: float, rate_hz: float) -> Array:
    """Return the times (N,) on the clock of the spline [s] at times k / rate.

    The clock's speed rises by a quintic from 0 to 1 / factor in a ramp, and falls likewise; a motion shorter than a
    ramp is all ramp.
    """
    last = float(trajectory.basis.breaks_s[-1])
    ramp = min(_RAMP_S, last)
    t = np.arange(np.ceil((last + ramp) * factor * rate_hz) + 1) / rate_hz / factor
    return np.clip(_risen(t, ramp) - _risen(t - last, ramp), 0.0, last)


def _risen(t: Array, ramp: float) -> Array:
    """Return the integral of a smooth step from 0 to 1 in `ramp` [s] (its fifth-order polynomial) up to times (N,)."""
    x = np.clip(t / ramp, 0.0, 1.0)
    return np.asarray(ramp * (x**6 - 3.0 * x**5 + 2.5 * x**4) + np.maximum(t - ramp, 0.0))


def limit_ratios(plant: ArmPlant, q: Array, rate_hz: float) -> Iterator[tuple[str, Array]]:
    """Yield what each limit of the robot is used by commands (N, J) [rad], by finite differences: (J,) value / limit.

    The robot rests before and after. Torques are those of inverse dynamics at central differences. Position: the
    distance from the middle of the range over half of it. Limits that the robot does not state are left out.
    """
    dt = 1.0 / rate_hz
    limits = plant.robot.limits
    q = np.concatenate([np.repeat(q[:1], 3, axis=0), q, np.repeat(q[-1:], 3, axis=0)])
    middle = 0.5 * (plant.upper + plant.lower)
    yield "position", (np.abs(q - middle) / (0.5 * (plant.upper - plant.lower))).max(axis=0)
    v = np.diff(q, axis=0) / dt
    yield "velocity", (np.abs(v) / np.minimum(limits.speeds(q[:-1], v), limits.speeds(q[1:], v))).max(axis=0)
    for name, order, limit in (("acceleration", 2, plant.acceleration_limits), ("jerk", 3, plant.jerk_limits)):
        if limit is not None:
            yield name, (np.abs(np.diff(q, order, axis=0)) / dt**order / limit).max(axis=0)
    torque = plant.chain.torques(q[1:-1], 0.5 * (v[1:] + v[:-1]), np.diff(v, axis=0) / dt)
    if np.isfinite(plant.effort_limits).any():
        yield "torque", (np.abs(torque) / plant.effort_limits).max(axis=0)
    if limits.torque_rate is not None:
        yield "torque rate", (np.abs(np.diff(torque, axis=0)) / dt / limits.torque_rate).max(axis=0)
