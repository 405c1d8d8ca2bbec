"""Robot commands at each control step from a gripper track, and their execution in the simulator.

A track gives poses, not servo targets. Two effects are compensated: servos lag by about `LEAD_S`, so poses are
commanded earlier; and the gap of fingers that hold an object is its width, so closed fingers get a smaller target.
"""

from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array, interpolate_pose, pose_difference
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.continuation import blend_from_start, plan_continuation, solve_stepwise
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.path import is_sound, search_path
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import TCP_LINK
from kinebench_drake.segments import segments
from kinebench_drake.suites.clock import CONTROL_PERIOD_S, Control
from kinebench_drake.suites.simulator import Simulator, Snapshot, TaskOutcome

LEAD_S = 0.1
"""Lag of the servos of ManiSkill's Panda: damping over stiffness, 100 / 1000."""
SQUEEZE_M = 0.008
"""Reduction of the gap commanded to fingers that hold an object: 4 N per finger at their stiffness."""
GRIP_M = 0.006
RELEASE_M = 0.010
"""Decrease of the gap at which fingers grip, and increase at which they release: hysteresis against noise."""
OWN_DEPTH_M = 0.005
"""Allowed penetration of the arm's convex hulls, which are larger than the links."""
TABLE_DEPTH_M = 0.015
"""Allowed penetration of the table: pressing on it is harmless."""
SLOWED_RAD = 1e-3
"""Reduction of a step by a speed limit from which on it is reported."""


class RejectionReason(Enum):
    """Reason why commands differ from the track."""

    NOT_TRACKED = "not_tracked"
    """No pose; interpolated between the poses before and after."""
    UNREACHABLE = "unreachable"
    """No posture within joint limits reaches the pose; joints are interpolated."""
    SELF_COLLISION = "self_collision"
    """Self-collision; the last allowed posture is held."""
    TABLE_COLLISION = "table_collision"
    """Collision with the table; the last allowed posture is held."""
    SPEED = "velocity"
    """A joint would exceed its speed limit, at which it follows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejection:
    """Frames whose poses were not commanded as tracked."""

    reason: RejectionReason
    frame_start: int
    """First such frame (0-based)."""
    frame_end: int
    """Last one, inclusive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotState:
    """State of the robot at the start of a clip."""

    q: Array
    """(7,) joint angles [rad]."""
    finger_width_m: float
    """Gap between the finger pads [m]."""
    gripping: bool
    """True if the fingers have closed on an object and not opened since."""

    @classmethod
    def of(cls, snapshot: Snapshot, *, gripping: bool = False) -> Self:
        """Return the state of the robot in a snapshot."""
        return cls(q=snapshot.q, finger_width_m=snapshot.finger_width_m, gripping=gripping)


@dataclass(frozen=True, slots=True, kw_only=True)
class Commands:
    """Commands of a clip."""

    q: Array
    """(N, 7) targets of the arm's servos [rad]."""
    X_BG: Array
    """(N, 4, 4) the same as poses of panda_hand_tcp in the base frame [m]."""
    finger_width_m: Array
    """(N,) targets of the gap between the finger pads [m]; negative values press."""
    frame_steps: NDArray[np.intp]
    """(T,) number of control steps before each frame: 0 at the first, N at the last."""
    gripping: bool
    """True if the fingers hold an object at the end."""
    rejections: tuple[Rejection, ...]
    """Frames that were not commanded as tracked, by reason."""


class CommandPlanner:
    """Converts tracks into commands of one robot."""

    def __init__(self, plant: ArmPlant) -> None:
        self.plant = plant
        self._collisions = CollisionModel(plant)

    def plan(
        self, X_BG: Array, finger_width_m: Array, tracked: NDArray[np.bool_], t_s: Array, start: RobotState
    ) -> Commands:
        """Plan commands with which the gripper follows a track.

        Args:
            X_BG: (T, 4, 4) poses of panda_hand_tcp in the base frame [m].
            finger_width_m: (T,) gap between the finger pads [m]; NaN where unknown.
            tracked: (T,) frames with a valid pose; the others are ignored.
            t_s: (T,) task time of each frame [s], increasing.
            start: state of the robot at the first frame, used in place of the track's first pose.

        Raises:
            UnmeasurableError: the track has fewer than two frames, or none tracked after the first.
        """
        frames = len(X_BG)
        if frames < 2 or not tracked[1:].any():
            raise UnmeasurableError(f"{int(tracked.sum())} of {frames} frames are tracked: there is nothing to execute")
        t_s = t_s - t_s[0]
        rejections = [*_rejections(RejectionReason.NOT_TRACKED, ~tracked & (np.arange(frames) > 0))]
        poses = _bridge(np.concatenate([self.plant.forward(start.q)[None], X_BG[1:]]), tracked)
        width, gripping = _plan_fingers(finger_width_m, poses, start)
        q, unreached = self._solve_path(t_s, poses, start.q)
        rejections += _rejections(RejectionReason.UNREACHABLE, unreached)
        q, own, table = self._avoid_collisions(q, width)
        rejections += _rejections(RejectionReason.SELF_COLLISION, own)
        rejections += _rejections(RejectionReason.TABLE_COLLISION, table)
        frame_steps = np.rint(t_s / CONTROL_PERIOD_S).astype(np.intp)
        lead_s = np.minimum(CONTROL_PERIOD_S * np.arange(1, frame_steps[-1] + 1) + LEAD_S, t_s[-1])
        targets, slowed = self._limit_speed(CubicSpline(t_s, q, bc_type="clamped")(lead_s), start.q)
        too_fast = np.zeros(frames, dtype=bool)
        too_fast[np.searchsorted(frame_steps, np.flatnonzero(slowed) + 1)] = True
        return Commands(
            q=targets,
            X_BG=self.plant.forward_path(targets),
            finger_width_m=np.interp(lead_s, t_s, width),
            frame_steps=frame_steps,
            gripping=gripping,
            rejections=(*rejections, *_rejections(RejectionReason.SPEED, too_fast)),
        )

    def _solve_path(self, t_s: Array, X_BG: Array, q_start: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return postures (T, 7) [rad] from the start on, and a mask (T,) of unreachable poses."""
        plant = self.plant
        for q in (solve_stepwise(plant, X_BG, q_start)[0], plan_continuation(plant, t_s, X_BG, q_start)):
            if is_sound(plant, t_s, q):
                return q, np.zeros(len(q), dtype=bool)
        q = search_path(plant, t_s, X_BG, q_start)
        unreached: NDArray[np.bool_] = ~np.isfinite(q[:, 0])
        if not unreached.all():
            q = blend_from_start(plant, t_s, X_BG, _interpolate(t_s, q, ~unreached), q_start)
        q[0] = q_start
        return _interpolate(t_s, q, np.isfinite(q[:, 0])), unreached

    def _avoid_collisions(self, q: Array, finger_width_m: Array) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Hold the path (T, 7) where it collides, but for its first posture, that of the robot.

        Returns:
            The path, and masks (T,) of self-collisions and of collisions with the table.
        """
        gaps = np.clip(finger_width_m, 0.0, self.plant.finger_width_m)
        own = self._collisions.self_distance(q, gaps).distance_m < -OWN_DEPTH_M
        table = self._collisions.table_distance(q, gaps).distance_m < -TABLE_DEPTH_M
        own[0] = table[0] = False
        last = np.maximum.accumulate(np.where(own | table, 0, np.arange(len(q))))
        return q[last], own, table & ~own

    def _limit_speed(self, q: Array, q_start: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return targets (N, 7) within speed and joint limits, and a mask (N,) of steps that a speed limit reduced."""
        most = self.plant.velocity_limits * CONTROL_PERIOD_S
        targets = np.empty_like(q)
        slowed = np.zeros(len(q), dtype=bool)
        now = q_start
        for i, wanted in enumerate(np.clip(q, self.plant.lower, self.plant.upper)):
            step = np.clip(wanted - now, -most, most)
            slowed[i] = np.abs(wanted - now - step).max() > SLOWED_RAD
            targets[i] = now = now + step
        return targets, slowed


def _bridge(X_BG: Array, tracked: NDArray[np.bool_]) -> Array:
    """Interpolate untracked poses of (T, 4, 4); the first one counts as tracked."""
    mask = np.append(True, tracked[1:])
    valid = np.flatnonzero(mask)
    bridged = X_BG.copy()
    for i in np.flatnonzero(~mask):
        k = int(np.searchsorted(valid, i))
        before = valid[k - 1]
        after = valid[min(k, len(valid) - 1)]
        share = (i - before) / (after - before) if after > before else 0.0
        bridged[i] = interpolate_pose(X_BG[before], X_BG[after], float(share))
    return bridged


def _interpolate(t_s: Array, q: Array, valid: NDArray[np.bool_]) -> Array:
    """Interpolate the path (T, 7) between its `valid` (T,) frames; it is constant outside of them."""
    if valid.sum() == 1:
        return np.repeat(q[valid], len(q), axis=0)
    return np.asarray(PchipInterpolator(t_s[valid], q[valid])(np.clip(t_s, t_s[valid][0], t_s[valid][-1])))


def _plan_fingers(finger_width_m: Array, X_BG: Array, start: RobotState) -> tuple[Array, bool]:
    """Return the gap (T,) [m] to command in each frame, and whether the fingers hold an object at the end."""
    width = _interpolate_width(np.concatenate([[start.finger_width_m], finger_width_m[1:]]), X_BG)
    gripping = start.gripping
    extreme = width[0]
    targets = np.empty_like(width)
    for i, gap in enumerate(width):
        extreme = min(extreme, gap) if gripping else max(extreme, gap)
        if abs(gap - extreme) > (RELEASE_M if gripping else GRIP_M):
            gripping = not gripping
            extreme = gap
        targets[i] = gap - SQUEEZE_M if gripping else gap
    return targets, gripping


def _interpolate_width(width: Array, X_BG: Array) -> Array:
    """Interpolate unknown gaps (NaN) of (T,) [m], the first of which is known.

    If the fingers opened or closed in between, they are assumed to do so when the hand moved least.
    """
    valid = np.flatnonzero(np.isfinite(width))
    whole = np.interp(np.arange(len(width)), valid, width[valid])
    distance, angle = pose_difference(X_BG[:-1], X_BG[1:])
    pace = np.convolve(np.pad(distance + ROTATION_ARM_M * angle, 1, mode="edge"), np.full(3, 1.0 / 3.0), mode="valid")
    for before, after in pairwise(valid):
        if after > before + 1 and abs(width[after] - width[before]) > GRIP_M:
            wait = before + int(np.argmin(pace[before:after]))
            whole[before : wait + 1] = width[before]
            whole[wait + 1 : after] = width[after]
    return whole


def _rejections(reason: RejectionReason, frames: NDArray[np.bool_]) -> list[Rejection]:
    """Return the rejections of the stretches of a mask (T,)."""
    return [Rejection(reason=reason, frame_start=run.start, frame_end=run.stop - 1) for run in segments(frames)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Execution:
    """Executed part of a clip."""

    snapshots: tuple[Snapshot, ...]
    """States at the frames, beginning with the one before the first command and ending at success."""
    outcome: TaskOutcome
    """Outcome of the task in the last of them."""
    X_BG: Array
    """(T, 4, 4) panda_hand_tcp in the base frame at each snapshot [m]."""

    @property
    def finger_width_m(self) -> Array:
        """(T,) gap between the finger pads at each snapshot [m]."""
        return np.array([s.finger_width_m for s in self.snapshots])


def execute(simulator: Simulator, commands: Commands, control: Control) -> Execution:
    """Execute commands from the current state on, until the task succeeds or they end, by the simulator's control."""
    snapshots = [simulator.snapshot()]
    X_BG = [simulator.link_pose(TCP_LINK)]
    for start, end in pairwise(commands.frame_steps):
        for i in range(start, end):
            if control is Control.JOINTS:
                simulator.step(commands.q[i], float(commands.finger_width_m[i]))
            else:
                simulator.step_pose(commands.X_BG[i], float(commands.finger_width_m[i]))
        snapshots.append(simulator.snapshot())
        X_BG.append(simulator.link_pose(TCP_LINK))
        if (outcome := simulator.outcome()).success:
            break
    return Execution(snapshots=tuple(snapshots), outcome=outcome, X_BG=np.stack(X_BG))
