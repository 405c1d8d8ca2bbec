"""Infeasible trajectories: one fault planted into a feasible one, with the proof that no joint path executes it.

Each planter draws place and size, changes the frames smoothly (or at once, for a teleport), and returns None where the
proof does not hold; the caller then draws again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from benchmarks.feasible import FeasibleMotion
from benchmarks.motion import Arm, self_distance
from benchmarks.sweep import REACH_M, least_bend, least_excess, least_step, reachable, wrist_distance
from benchmarks.trajectory import Trajectory, TrajectoryKind
from kinebench_drake.geometry import Array, pose_difference, rotation_exp
from kinebench_drake.io.jsonl import Json
from kinebench_drake.kinematics.continuation import minimum_jerk

REACH_EXCESS_M = (0.005, 0.3)
"""Distance of the wrist beyond the sphere that it can reach [m]."""
SPEED_RATIO = (1.15, 5.0)
"""Least joint speed of any joint path / its limit, in the worst step."""
DEPTH_M = (0.005, 0.06)
"""Depth of the gripper's lowest point in the table [m]."""
JUMP_M = (0.1, 0.4)
JUMP_DEG = (30.0, 120.0)
"""Jump of a teleport in position, rotation or both."""
JUMP_STEP = 1.1
JUMP_BEND = 1.3
"""Least joint speed or acceleration of any joint path / its limit across a jump, by the sweeps."""
LIMIT_EXCESS_RAD = (0.01, 0.3)
"""Excess of a joint angle over its limit [rad]."""
POSE_EXCESS_RAD = 0.02
"""Least excess of the worst joint, over all postures of a pose that is reachable without limits [rad]."""
OVERLAP_M = 0.005
"""Least penetration depth of two links [m]."""
_ONE_SPEED_M_S = 0.2
_ONE_TURN_RAD_S = 0.8
_ONE_JOINT_SHARE = 0.5
"""Mean speeds of an excursion, if there is time: of the gripper, of its rotation, of a joint over its limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedTrajectory:
    """A trajectory with its fault."""

    trajectory: Trajectory
    parameters: Mapping[str, Json]
    """Size and place of the fault, figures of the proof."""


def _size(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a size, uniform on a logarithmic scale."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _excursion(rng: np.random.Generator, frames: int, centre: int, rise_s: float, period_s: float) -> Array:
    """Return weights (T,) 0..1 of an excursion, 1 at `centre`, in half of the cases constant there for some frames."""
    rise = float(np.clip(np.ceil(rise_s / period_s), 3, max(3, frames // 2)))
    rest = float(rng.choice([0, int(rng.integers(1, 6))]))
    return minimum_jerk(1.0 - np.maximum(np.abs(np.arange(frames) - centre) - rest, 0.0) / rise)


def _moved(X_BG: Array, weight: Array, shift: Array, turn: Array) -> Array:
    """Return poses (T, 4, 4) moved by `weight` (T,) times `shift` (3,) [m] in B and `turn` (3,) [rad] in G."""
    X = X_BG.copy()
    X[:, :3, 3] += weight[:, None] * shift
    X[:, :3, :3] = X[:, :3, :3] @ rotation_exp(weight[:, None] * turn)
    return X


def plant_reach(rng: np.random.Generator, arm: Arm, base: FeasibleMotion) -> PlantedTrajectory | None:
    """Move the gripper out of reach and back: farther from the shoulder than the stretched arm reaches."""
    good = base.trajectory(arm)
    centre = int(rng.integers(len(good.t_s)))
    wanted = _size(rng, *REACH_EXCESS_M)
    X = good.X_BG[centre]
    away = X[:3, 3] - [0.0, 0.0, 0.333]
    direction = away / np.linalg.norm(away) + rng.normal(0.0, 0.3, size=3)
    direction[2] = abs(direction[2])
    direction /= np.linalg.norm(direction)
    low = 0.0
    high = 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        far = wrist_distance(_moved(X[None], np.ones(1), middle * direction, np.zeros(3)))[0] >= REACH_M + wanted
        low, high = (low, middle) if far else (middle, high)
    weight = _excursion(rng, base.frames, centre, high / _ONE_SPEED_M_S, base.period_s)
    moved = _moved(good.X_BG, weight, high * direction, np.zeros(3))
    beyond = wrist_distance(moved) - REACH_M
    if not beyond.max() >= 0.99 * REACH_EXCESS_M[0]:
        return None
    frames = np.flatnonzero(beyond > 0.0)
    return PlantedTrajectory(
        trajectory=replace(good, X_BG=moved, q=None),
        parameters={"excess_m": float(beyond.max()), **_range(frames)},
    )


def plant_fast(rng: np.random.Generator, arm: Arm, base: FeasibleMotion) -> PlantedTrajectory | None:
    """Speed up the whole, or a part with rests elsewhere so that the duration is unchanged."""
    wanted = _size(rng, *SPEED_RATIO)
    when = base.start_s + base.t_s
    burst = bool(rng.random() < 0.5)
    ratio = np.abs(base.motion.q(when, 1) / arm.plant.velocity_limits).max(axis=-1)
    if burst:
        moving = np.flatnonzero(ratio[1:-1] > 0.3 * ratio.max()) + 1
        if not len(moving):
            return None
        centre = int(rng.choice(moving))
        factor = wanted / float(ratio[centre])
        steps = int(rng.integers(1, 5))  # of the warped frames that fall into the burst
        warped = _burst(base, when, centre, factor, steps)
        t_s = base.t_s
    else:
        factor = wanted / float(ratio.max())
        warped = when
        t_s = base.t_s / factor
    if warped is None or factor <= 1.0:
        return None
    trajectory = base.trajectory(arm, warped, t_s)
    q = trajectory.q
    if q is None:
        return None
    period = float(t_s[1] - t_s[0])
    steps_ratio = (np.abs(np.diff(q, axis=0)) / (arm.plant.velocity_limits * period)).max(axis=-1)
    proof = 0.0
    at = 0
    for i in np.argsort(-steps_ratio)[:3]:
        if steps_ratio[i] > proof:
            ratio_i = least_step(arm, trajectory.X_BG[i], trajectory.X_BG[i + 1], period)
            proof, at = (ratio_i, int(i)) if ratio_i > proof else (proof, at)
    if proof < SPEED_RATIO[0]:
        return None
    fast = np.flatnonzero(steps_ratio > 1.0)
    return PlantedTrajectory(
        trajectory=replace(trajectory, q=None),
        parameters={
            "how": "burst" if burst else "compressed",
            "factor": factor,
            "ratio": min(proof, 1e3),
            "step": at,
            "fast_steps": len(fast),
            "period_s": period,
        },
    )


def _burst(base: FeasibleMotion, when: Array, centre: int, factor: float, steps: int) -> Array | None:
    """Return times (T,) of the motion [s]: `steps` steps around a frame `factor` times faster, later frames at rest."""
    rate = np.ones(len(when) - 1)
    first = max(0, centre - steps // 2)
    last = min(len(rate), first + steps)
    extra = (factor - 1.0) * (last - first)  # frames of motion that the burst anticipates
    rate[first:last] = factor
    rest = np.concatenate([np.arange(last, len(rate)), np.arange(0, first)[::-1]])
    for i in rest:  # compensated by rests after the burst, then before
        rate[i] = max(0.0, 1.0 - extra)
        extra = max(0.0, extra - 1.0)
    if extra > 0.0:
        return None
    return np.asarray(when[0] + base.period_s * np.concatenate([[0.0], np.cumsum(rate)]))


def plant_table(rng: np.random.Generator, arm: Arm, base: FeasibleMotion) -> PlantedTrajectory | None:
    """Move the gripper into the table and back."""
    good = base.trajectory(arm)
    low = arm.body.lowest_of_gripper(good.X_BG, good.finger_width_m)
    near = np.flatnonzero(low < 0.2)
    if not len(near):
        return None
    centre = int(rng.choice(near))
    depth = _size(rng, *DEPTH_M)
    down = float(low[centre]) + depth
    weight = _excursion(rng, base.frames, centre, down / _ONE_SPEED_M_S, base.period_s)
    moved = _moved(good.X_BG, weight, np.array([0.0, 0.0, -down]), np.zeros(3))
    height = arm.body.lowest_of_gripper(moved, good.finger_width_m)
    inside = np.flatnonzero(height < 0.0)
    if not 0.99 * DEPTH_M[0] <= -height.min() <= 1.01 * DEPTH_M[1] or not reachable(arm, moved[inside]):
        return None
    return PlantedTrajectory(
        trajectory=replace(good, X_BG=moved, q=None),
        parameters={"depth_m": -float(height.min()), **_range(inside)},
    )


def plant_teleport(rng: np.random.Generator, arm: Arm, base: FeasibleMotion) -> PlantedTrajectory | None:
    """Let the gripper jump between two frames: for good, for some frames, or to another time of its motion."""
    good = base.trajectory(arm)
    n = len(good.t_s)
    how = str(rng.choice(["shift", "blink", "skip"]))
    first = int(rng.integers(3, n - 4))
    if how == "skip":
        start = base.start_s + base.t_s
        to = base.motion.duration_s * rng.random()
        when = np.where(np.arange(n) < first, start, np.clip(start - start[first] + to, 0.0, base.motion.duration_s))
        trajectory = base.trajectory(arm, when)
        last = n - 1
    else:
        what = rng.integers(3)
        shift = rng.normal(size=3)
        turn = rng.normal(size=3)
        shift *= (what != 1) * rng.uniform(*JUMP_M) / np.linalg.norm(shift)
        turn *= (what != 0) * np.deg2rad(rng.uniform(*JUMP_DEG)) / np.linalg.norm(turn)
        last = n - 1 if how == "shift" else min(n - 1, first + int(rng.integers(0, 6)))
        weight = np.zeros(n)
        weight[first : last + 1] = 1.0
        trajectory = replace(good, X_BG=_moved(good.X_BG, weight, shift, turn))
    X = trajectory.X_BG
    jump_m, jump_rad = (float(d) for d in pose_difference(X[first - 1], X[first]))
    small = jump_m < JUMP_M[0] and np.rad2deg(jump_rad) < JUMP_DEG[0]
    large = jump_m > 1.2 * JUMP_M[1] or np.rad2deg(jump_rad) > 1.2 * JUMP_DEG[1]
    if small or large or arm.body.lowest_of_gripper(X, good.finger_width_m).min() < 0.0:
        return None
    step = least_step(arm, X[first - 1], X[first], base.period_s)
    bend = None
    if step < JUMP_STEP:
        bend = max(
            least_bend(arm, X[first - 2 : first + 1], base.period_s),
            least_bend(arm, X[first - 1 : first + 2], base.period_s),
        )
        if bend < JUMP_BEND:
            return None
    if not reachable(arm, X, samples=128):
        return None
    return PlantedTrajectory(
        trajectory=replace(trajectory, q=None),
        parameters={
            "how": how,
            "jump_m": jump_m,
            "jump_rad": jump_rad,
            "step_ratio": min(step, 1e3),
            "bend_ratio": None if bend is None else min(bend, 1e3),
            "frame_start": first,
            "frame_end": last,
        },
    )


def plant_limit_q(rng: np.random.Generator, arm: Arm, base: FeasibleMotion) -> PlantedTrajectory | None:
    """Move one joint angle past its limit and back."""
    good = base.trajectory(arm)
    if good.q is None:
        return None
    plant = arm.plant
    centre = int(rng.integers(base.frames))
    wanted = _size(rng, *LIMIT_EXCESS_RAD)
    to = np.concatenate([plant.upper + wanted - good.q[centre], plant.lower - wanted - good.q[centre]])
    near = np.flatnonzero(np.abs(to) < 1.5)
    if not len(near):
        return None
    which = int(rng.choice(near))
    change = np.zeros(7)
    change[which % 7] = to[which]
    q = _swung(rng, arm, base, good.q, centre, change)
    beyond = np.maximum(plant.lower - q, q - plant.upper).max(axis=-1)
    if beyond.max() < 0.99 * LIMIT_EXCESS_RAD[0]:
        return None
    return PlantedTrajectory(
        trajectory=replace(good, q=q),
        parameters={
            "joint": plant.robot.joints[which % 7],
            "excess_rad": float(beyond.max()),
            **_range(np.flatnonzero(beyond > 0.0)),
        },
    )


def plant_self_q(rng: np.random.Generator, arm: Arm, base: FeasibleMotion) -> PlantedTrajectory | None:
    """Move the joint angles to a self collision and back, within limits and above the table."""
    good = base.trajectory(arm)
    if good.q is None:
        return None
    centre = int(rng.integers(base.frames))
    width = good.finger_width_m[centre]
    drawn = rng.uniform(arm.plant.lower, arm.plant.upper, size=(400, 7))
    drawn = drawn[np.argsort(np.abs(drawn - good.q[centre]).max(axis=-1))]
    for posture in drawn:
        if not arm.plant.query(posture, width).HasCollisions():
            continue
        if arm.body.lowest(posture[None], np.array([width]))[0] < 0.01:
            continue
        q = _swung(rng, arm, base, good.q, centre, posture - good.q[centre])
        distance = self_distance(arm, q, good.finger_width_m)
        if distance.min() <= -OVERLAP_M:
            return PlantedTrajectory(
                trajectory=replace(good, q=q),
                parameters={"depth_m": -float(distance.min()), **_range(np.flatnonzero(distance < 0.0))},
            )
    return None


def _swung(rng: np.random.Generator, arm: Arm, base: FeasibleMotion, q: Array, centre: int, change: Array) -> Array:
    """Return postures (T, 7) that go to `q[centre] + change` and back, slowly if there is time."""
    speed = np.abs(change) / (_ONE_JOINT_SHARE * arm.plant.velocity_limits)
    bend = np.sqrt(6.0 * np.abs(change) / (_ONE_JOINT_SHARE * arm.acceleration_limits))
    weight = _excursion(rng, base.frames, centre, float(max(speed.max() * 1.9, bend.max())), base.period_s)
    target = q[centre] + change
    return np.asarray(q + weight[:, None] * (target - q))


def plant_limit_pose(rng: np.random.Generator, arm: Arm, base: FeasibleMotion) -> PlantedTrajectory | None:
    """Move the gripper to a pose that only the joint limits make unreachable, and back."""
    good = base.trajectory(arm)
    centre = int(rng.integers(base.frames))
    X = good.X_BG[centre]
    for _ in range(40):
        turn = rng.normal(size=3)
        shift = rng.uniform(-0.25, 0.25, size=3)
        turn *= np.deg2rad(rng.uniform(30.0, 150.0)) / np.linalg.norm(turn)
        target = _moved(X[None], np.ones(1), shift, turn)
        if arm.body.lowest_of_gripper(target, good.finger_width_m[centre : centre + 1])[0] < 0.01:
            continue
        coarse = least_excess(arm, target[0], 128)
        if coarse is None or coarse < POSE_EXCESS_RAD:
            continue
        excess = least_excess(arm, target[0])
        if excess is None or excess < POSE_EXCESS_RAD:
            continue
        rise_s = max(float(np.linalg.norm(shift)) / _ONE_SPEED_M_S, float(np.linalg.norm(turn)) / _ONE_TURN_RAD_S)
        weight = _excursion(rng, base.frames, centre, rise_s, base.period_s)
        moved = _moved(good.X_BG, weight, shift, turn)
        moved[centre] = target[0]
        return PlantedTrajectory(
            trajectory=replace(good, X_BG=moved, q=None), parameters={"excess_rad": excess, "frame": centre}
        )
    return None


def _range(frames: NDArray[np.intp]) -> dict[str, Json]:
    return {"frame_start": int(frames[0]), "frame_end": int(frames[-1])}


Planter = Callable[[np.random.Generator, Arm, FeasibleMotion], PlantedTrajectory | None]

PLANTERS: Mapping[TrajectoryKind, Planter] = MappingProxyType(
    {
        TrajectoryKind.REACH: plant_reach,
        TrajectoryKind.FAST: plant_fast,
        TrajectoryKind.TABLE: plant_table,
        TrajectoryKind.TELEPORT: plant_teleport,
        TrajectoryKind.LIMIT_Q: plant_limit_q,
        TrajectoryKind.SELF_Q: plant_self_q,
        TrajectoryKind.LIMIT_POSE: plant_limit_pose,
    }
)
"""Planter of each kind of fault."""
