"""Random motions like those of experts, and random joint paths.

Straight moves between gripper poses (minimum jerk or a trapezoidal speed profile with smooth flanks), some blended,
with rests while the fingers move; followed by inverse kinematics and fitted by a spline in joint space. `motion.prove`
decides whether the arm can execute them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from benchmarks.motion import Arm, Motion
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_angle, rotation_exp, rotation_log
from kinebench_drake.kinematics.continuation import minimum_jerk
from kinebench_drake.kinematics.newton import REACHED_M, solve_newton
from kinebench_drake.suites.clock import CONTROL_PERIOD_S
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.expert.grasp import DOWN, grasp_rotation
from kinebench_drake.suites.expert.motion import plan
from kinebench_drake.suites.families.registry import EXPERTS

KNOT_S = 0.04
"""Time between the knots of a spline [s]."""
TABLE_X_M = (0.3, 0.75)
TABLE_Y_M = (-0.35, 0.35)
CEILING_M = 0.5
"""Workspace of the gripper."""
TOUCH_M = 1e-4
"""Height of fingertips that touch the table, against rounding [m]."""
SHORTEST_S = 0.5
"""Least duration of a move [s]."""
JOINT_SPEED_SHARE = 0.9
JOINT_ACCELERATION_SHARE = 0.8
"""Greatest shares of the limits that random joint paths use."""
SHIPPED_TASKS = (
    *("CloseBox-v1", "OpenBoxEasy-v1", "OpenBoxEasy-v2", "OpenBoxHard-v1", "OpenBoxHard-v2", "PullCube-v1"),
    *("StackCube-v1", "OpenDrawer-v1", "CloseDrawer-v1", "StoreCube-v1", "StoreCube-v2", "CloseFaucet-v1"),
    *("OpenFaucet-v1", "PickFruits-v1", "StoreFruitsBox-v1", "CloseLaptopEasy-v1", "CloseLaptopHard-v1"),
    *("OpenLaptopEasy-v1", "OpenLaptopHard-v1", "LiftPegUpright-v1"),
)
"""Tasks of the shipped experts, in an order that does not change: the sets of earlier revisions depend on it."""


class Family(Enum):
    """Way of drawing a motion."""

    CARTESIAN = "cartesian"
    """Pick, place, push, pull, turn, open: straight or curved moves of the gripper."""
    SHIPPED = "shipped"
    """Plans of the shipped experts in random scenes."""
    JOINT = "joint"
    """Smooth random joint paths up to high speeds and accelerations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """One move of the gripper."""

    X_BG: Array
    """(4, 4) pose of the TCP at the end [m]."""
    finger_width_m: float
    """Gap between the pads at the end [m]."""
    blends: bool = False
    """True if the next move begins before this one ends."""


def trapezoid(s: Array, flank: float) -> Array:
    """Return the share of the path at share `s` of the time: constant speed, cubic flanks of `flank` at both ends."""
    s = np.clip(s, 0.0, 1.0)

    def risen(u: Array) -> Array:  # integral of 3 u^2 - 2 u^3, beyond of 1
        c = np.clip(u, 0.0, 1.0)
        return np.asarray(c**3 - 0.5 * c**4 + np.maximum(u - 1.0, 0.0))

    return np.asarray(flank * (risen(s / flank) - risen((s - 1.0 + flank) / flank)) / (1.0 - flank))


def cartesian(rng: np.random.Generator, arm: Arm, at_least_s: float) -> Motion | None:
    """Draw an expert-like motion of at least `at_least_s` [s]; None if the arm cannot follow it."""
    plant = arm.plant
    q = np.clip(
        plant.robot.rest_q + rng.normal(0.0, [0.15, 0.05, 0.15, 0.05, 0.1, 0.05, 0.15]), plant.lower, plant.upper
    )
    speed_m_s = rng.uniform(0.06, 0.35)
    turn_rad_s = rng.uniform(0.3, 0.9)
    start = Move(X_BG=plant.forward(q), finger_width_m=float(rng.choice([0.0, 0.04, 0.08])))
    moves = [start]
    lengths = list[float]()
    starts = [0.0]
    end_s = 0.0
    profile = float(rng.uniform(0.2, 0.45)) if rng.random() < 0.4 else None
    while end_s < at_least_s:
        for move in _task(rng, arm):
            last = moves[-1]
            length = max(
                float(np.linalg.norm(move.X_BG[:3, 3] - last.X_BG[:3, 3])) / speed_m_s,
                float(rotation_angle(last.X_BG[:3, :3].T @ move.X_BG[:3, :3])) / turn_rad_s,
                abs(move.finger_width_m - last.finger_width_m) / 0.15,
                SHORTEST_S,
            ) * rng.uniform(0.9, 1.3)
            if last.blends and lengths:
                starts[-1] -= 0.45 * min(lengths[-1], length)
            lengths.append(length)
            moves.append(move)
            end_s = starts[-1] + length
            rest = 0.0 if move.blends else float(rng.choice([0.0, rng.uniform(0.1, 0.6)]))
            starts.append(end_s + rest)
        end_s = starts[-1]
    duration = max(end_s + 0.2, at_least_s)
    t_s = np.linspace(0.0, duration, round(duration / KNOT_S) + 1)
    s = (t_s[:, None] - np.array(starts[: len(lengths)])) / np.array(lengths)
    done = minimum_jerk(s) if profile is None else trapezoid(s, profile)
    X = np.array([m.X_BG for m in moves])
    widths = np.array([m.finger_width_m for m in moves])
    turns = rotation_log(np.swapaxes(X[:-1, :3, :3], 1, 2) @ X[1:, :3, :3])
    R = np.broadcast_to(X[0, :3, :3], (len(t_s), 3, 3))
    for i, turn in enumerate(turns):
        R = R @ rotation_exp(done[:, i, None] * turn)
    poses = make_pose(R, X[0, :3, 3] + done @ np.diff(X[:, :3, 3], axis=0))
    path = follow(arm, poses, q)
    return None if path is None else Motion.through(t_s, path, widths[0] + done @ np.diff(widths))


def follow(arm: Arm, poses: Array, q: Array) -> Array | None:
    """Return postures (N, 7) [rad] of poses (N, 4, 4) that lie close together, from `q` (7,); None if one fails."""
    path = np.empty((len(poses), 7))
    for i, X_BG in enumerate(poses):
        q, error = solve_newton(arm.plant, X_BG, q, iterations=20)
        if error > REACHED_M:
            return None
        path[i] = q
    return path


def _task(rng: np.random.Generator, arm: Arm) -> Sequence[Move]:
    return _TASKS[rng.integers(len(_TASKS))](rng, arm)


def _tilted(rng: np.random.Generator) -> Array:
    """Draw a rotation (3, 3) of a downward gripper with random yaw, in half of the cases tilted up to 40 degrees."""
    yaw = rng.uniform(-0.6, 0.6) + (np.pi / 2 if rng.random() < 0.25 else 0.0)
    R = grasp_rotation(DOWN, (np.sin(yaw), -np.cos(yaw), 0.0))
    if rng.random() < 0.5:
        direction = rng.uniform(-np.pi, np.pi)
        tilt = np.deg2rad(rng.uniform(0.0, 40.0))
        R = rotation_exp(tilt * np.array([np.cos(direction), np.sin(direction), 0.0])) @ R
    return np.asarray(R)


def _place(rng: np.random.Generator, arm: Arm, R: Array, width: float, height_m: float) -> Array:
    """Draw a gripper pose whose lowest point is `height_m` above the table."""
    X = make_pose(R, [rng.uniform(*TABLE_X_M), rng.uniform(*TABLE_Y_M), 0.0])
    X[2, 3] = height_m - float(arm.body.lowest_of_gripper(X[None], np.array([width]))[0])
    return X


def _height(rng: np.random.Generator) -> float:
    """Draw a height on the table or slightly above [m]."""
    return TOUCH_M if rng.random() < 0.4 else float(rng.uniform(0.001, 0.08))


def _up(X: Array, height_m: float) -> Array:
    X = X.copy()
    X[2, 3] = min(X[2, 3] + height_m, CEILING_M)
    return X


def _pick_and_place(rng: np.random.Generator, arm: Arm) -> list[Move]:
    width = float(rng.uniform(0.02, 0.06))
    grasp = _place(rng, arm, _tilted(rng), 0.08, _height(rng))
    goal = _place(rng, arm, _tilted(rng) if rng.random() < 0.5 else grasp[:3, :3], 0.08, _height(rng))
    over = rng.uniform(0.06, 0.2, size=3)
    blends = bool(rng.random() < 0.6)
    return [
        Move(X_BG=_up(grasp, over[0]), finger_width_m=0.08, blends=blends and grasp[2, 3] + over[0] < CEILING_M),
        Move(X_BG=grasp, finger_width_m=0.08),
        Move(X_BG=grasp, finger_width_m=width),
        Move(X_BG=_up(grasp, over[1]), finger_width_m=width),
        Move(X_BG=_up(goal, over[2]), finger_width_m=width),
        Move(X_BG=goal, finger_width_m=width),
        Move(X_BG=goal, finger_width_m=0.08),
        Move(X_BG=_up(goal, over[1]), finger_width_m=0.08),
    ]


def _push(rng: np.random.Generator, arm: Arm) -> list[Move]:
    """Push along a straight line with closed fingers."""
    start = _place(rng, arm, _tilted(rng), 0.0, _height(rng))
    end = start.copy()
    heading = rng.uniform(-np.pi, np.pi)
    way = rng.uniform(0.05, 0.3)
    end[:2, 3] = np.clip(
        end[:2, 3] + way * np.array([np.cos(heading), np.sin(heading)]),
        [TABLE_X_M[0], TABLE_Y_M[0]],
        [TABLE_X_M[1], TABLE_Y_M[1]],
    )
    over = rng.uniform(0.05, 0.15)
    return [
        Move(X_BG=_up(start, over), finger_width_m=0.0),
        Move(X_BG=start, finger_width_m=0.0),
        Move(X_BG=end, finger_width_m=0.0),
        Move(X_BG=_up(end, over), finger_width_m=0.0),
    ]


def _drawer(rng: np.random.Generator, arm: Arm) -> list[Move]:
    """Pull or push a handle with the gripper pointing forwards or obliquely downwards."""
    slope = np.deg2rad(rng.uniform(0.0, 50.0))
    yaw = rng.uniform(-0.5, 0.5)
    approach = np.array([np.cos(yaw) * np.cos(slope), np.sin(yaw) * np.cos(slope), -np.sin(slope)])
    closing = np.array([-np.sin(yaw), np.cos(yaw), 0.0]) * rng.choice([-1.0, 1.0])
    if rng.random() < 0.3:
        closing = np.cross(approach, closing)
    R = grasp_rotation(approach, closing)
    handle = make_pose(R, [rng.uniform(0.45, 0.7), rng.uniform(-0.25, 0.25), rng.uniform(0.12, 0.4)])
    before = handle.copy()
    pulled = handle.copy()
    before[:3, 3] -= rng.uniform(0.04, 0.1) * approach
    pulled[:3, 3] -= rng.uniform(0.05, 0.18) * np.array([np.cos(yaw), np.sin(yaw), 0.0])
    width = float(rng.choice([0.0, 0.02]))
    return [
        Move(X_BG=before, finger_width_m=0.08),
        Move(X_BG=handle, finger_width_m=0.08),
        Move(X_BG=handle, finger_width_m=width),
        Move(X_BG=pulled, finger_width_m=width),
        Move(X_BG=pulled, finger_width_m=0.08),
    ]


def _lid(rng: np.random.Generator, arm: Arm) -> list[Move]:
    """Move the edge of a lid or a handle along an arc, in short blended chords."""
    X = _place(rng, arm, _tilted(rng), 0.02, float(rng.uniform(0.05, 0.2)))
    vertical = rng.random() < 0.5
    axis = np.array([0.0, 0.0, 1.0]) if vertical else np.array([0.0, 1.0, 0.0])
    lever = rng.uniform(0.06, 0.15) * np.array([1.0, 0.0, 0.0])
    angle = rng.uniform(0.4, 1.1) * rng.choice([-1.0, 1.0])
    turned = bool(rng.random() < 0.7)
    moves = [Move(X_BG=_up(X, 0.06), finger_width_m=0.04), Move(X_BG=X, finger_width_m=0.02)]
    for part in np.linspace(0.0, 1.0, 6)[1:]:
        R = rotation_exp(part * angle * axis)
        arc = make_pose(R @ X[:3, :3] if turned else X[:3, :3], X[:3, 3] + lever - R @ lever)
        moves.append(Move(X_BG=arc, finger_width_m=0.02, blends=part < 1.0))
    return [*moves, Move(X_BG=_up(moves[-1].X_BG, 0.08), finger_width_m=0.04)]


_TASKS = (_pick_and_place, _push, _drawer, _lid)

_STEPS = 192
"""Control steps of a benchmark episode."""
_JOINT_KNOTS = 40


def shipped(rng: np.random.Generator, arm: Arm, at_least_s: float) -> Motion | None:
    """Plan one of the shipped experts' motions in a random scene of its task; None if it fails."""
    task = SHIPPED_TASKS[rng.integers(len(SHIPPED_TASKS))]
    plant = arm.plant
    q = plant.robot.rest_q + rng.normal(0.0, 0.02, size=7)
    steps = max(_STEPS, int(np.ceil(at_least_s / CONTROL_PERIOD_S)))
    scene = compose(task, int(rng.integers(2**31))).layout().scene(plant.forward(q))
    try:
        motion = plan(plant, q, scene.finger_width_m, EXPERTS[task](scene), steps)
    except InputError:
        return None
    t_s = np.asarray(CONTROL_PERIOD_S * np.arange(steps + 1), dtype=np.float64)
    widths = np.concatenate([[scene.finger_width_m], np.maximum(motion.finger_width_m, 0.0)])
    return Motion.through(t_s, np.vstack([q, motion.q]), widths)


def joint_space(rng: np.random.Generator, arm: Arm, at_least_s: float) -> Motion | None:
    """Draw a smooth joint path with up to 90 % of the speed and 80 % of the acceleration limits."""
    plant = arm.plant
    share = rng.uniform(0.3, 1.0)
    middle = rng.uniform(0.8 * plant.lower + 0.2 * plant.upper, 0.2 * plant.lower + 0.8 * plant.upper)
    spread = rng.uniform(0.05, 0.5) * 0.5 * (plant.upper - plant.lower)
    knots = np.clip(middle + rng.uniform(-1.0, 1.0, (_JOINT_KNOTS, 7)) * spread, plant.lower, plant.upper)
    widths = np.full(_JOINT_KNOTS, float(rng.uniform(0.0, 0.08)))
    unit = Motion.through(np.arange(_JOINT_KNOTS, dtype=np.float64), knots, widths)
    fine = np.linspace(0.0, unit.duration_s, 50 * _JOINT_KNOTS)
    speed = np.abs(unit.q(fine, 1)) / plant.velocity_limits
    bend = np.abs(unit.q(fine, 2)) / arm.acceleration_limits
    spacing = max(
        float(speed.max()) / (JOINT_SPEED_SHARE * share),
        float(np.sqrt(bend.max() / (JOINT_ACCELERATION_SHARE * share))),
    )
    motion = Motion.through(spacing * unit.t_width_s, knots, widths)
    return motion if motion.duration_s >= at_least_s else None
