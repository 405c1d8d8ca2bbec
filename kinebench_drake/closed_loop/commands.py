"""From the track of a gripper, as seen or as it truly was, to what the robot is told at each control step.

A video shows where the gripper was, not what its servos were told. Two things are made up for: the servos follow about
`LEAD_S` late, so each moment's pose is commanded that much earlier; and fingers that hold something are seen as far
apart as the thing is wide, so once they have closed they are told to close a little more.
"""

from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array, interpolate_pose, pose_difference
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.continuation import blend_from_start, plan_continuation, solve_stepwise
from kinebench_drake.kinematics.ik import posture_solver
from kinebench_drake.kinematics.path import is_sound, search_path
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.segments import segments
from kinebench_drake.suites.clock import CONTROL_PERIOD_S

LEAD_S = 0.1
"""How far the servos of ManiSkill's Panda lag behind their targets: damping over stiffness, 100 / 1000."""
SQUEEZE_M = 0.008
"""How much narrower than seen the gap of fingers that hold something is commanded: 4 N a finger at their stiffness."""
GRIP_M, RELEASE_M = 0.006, 0.010
"""Fingers hold from where their gap has shrunk by the one until it has grown again by the other: what is held is read
now wider and now narrower, and fingers that do open soon have opened further."""
LEVER_M = 0.1
"""Turning by an angle counts as moving by the angle times this."""
SELF_DEPTH_M = 0.005
"""How deep the arm's hulls may be in each other; hulls fill hollows, so that a little is no contact yet."""
TABLE_DEPTH_M = 0.015
"""How deep below the table's top a link may be told to go: pressing on the table is no danger."""
SPEED_SLACK_RAD = 1e-3
"""Speed limits that cut less than this off a step are not told."""


class RejectionReason(Enum):
    """Why a command is not what the video asks for."""

    NOT_TRACKED = "not_tracked"
    """No pose is known; the gripper is moved from the last known one to the next."""
    UNREACHABLE = "unreachable"
    """No posture within joint limits reaches the pose; the joints are interpolated."""
    SELF_COLLISION = "self_collision"
    """The arm would be in itself; the last allowed posture is held."""
    TABLE_COLLISION = "table_collision"
    """A link would be in the table; the last allowed posture is held."""
    SPEED = "velocity"
    """A joint would be too fast; it follows at its limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rejection:
    """Frames whose poses were not commanded as they are."""

    reason: RejectionReason
    frame_start: int
    """First such frame (0-based)."""
    frame_end: int
    """Last one, inclusive."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotState:
    """How the robot stands when a clip begins, and whether it holds something."""

    q: Array
    """(7,) joint angles [rad]."""
    finger_width_m: float
    """Gap between the finger pads [m]."""
    gripping: bool
    """Whether the fingers have closed and not opened since."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Commands:
    """What the robot is told."""

    q: Array
    """(N, 7) targets of the arm's servos [rad]."""
    X_BG: Array
    """(N, 4, 4) the same as poses of panda_hand_tcp in the base frame [m]."""
    finger_width_m: Array
    """(N,) targets of the gap between the finger pads [m]; negative presses."""
    frame_steps: NDArray[np.intp]
    """(T,) control steps that are done at each frame: 0 at the first, N at the last."""
    gripping: bool
    """Whether the fingers hold something at the end."""
    refused: tuple[Rejection, ...]
    """What was not commanded as asked, by kind and frame."""


class CommandPlanner:
    """Turns tracks into commands for one robot."""

    def __init__(self, plant: ArmPlant) -> None:
        """Prepare for a robot."""
        self.plant = plant
        """The robot."""
        self._collisions = CollisionModel(plant)

    def commands(
        self,
        X_BG: Array,
        finger_width_m: Array,
        tracked: NDArray[np.bool_],
        t_s: Array,
        start: RobotState,
    ) -> Commands:
        """What to tell the robot so that its gripper does what a track shows.

        Args:
            X_BG: (T, 4, 4) poses of panda_hand_tcp in the base frame [m].
            finger_width_m: (T,) gap between the finger pads [m]; NaN where unknown.
            tracked: (T,) which poses can be relied upon; the others are not looked at.
            t_s: (T,) task time of each frame [s], increasing.
            start: how the robot stands at the first frame; where it is goes before what is seen of it.

        Raises:
            UnmeasurableError: the track has less than two frames, or none tracked after the first.
        """
        frames = len(X_BG)
        if frames < 2 or not tracked[1:].any():
            raise UnmeasurableError(f"{int(tracked.sum())} of {frames} frames are tracked: there is nothing to execute")
        t_s = t_s - t_s[0]
        refused = [*_told(RejectionReason.NOT_TRACKED, ~tracked & (np.arange(frames) > 0))]
        poses = _bridged(np.concatenate([self.plant.forward(start.q)[None], X_BG[1:]]), tracked)
        width, gripping = _finger_targets(finger_width_m, poses, start)
        q, unreached = self._path(t_s, poses, start.q)
        refused += _told(RejectionReason.UNREACHABLE, unreached)
        q, own, table = self._allowed(q, width)
        refused += [*_told(RejectionReason.SELF_COLLISION, own), *_told(RejectionReason.TABLE_COLLISION, table)]
        frame_steps = np.rint(t_s / CONTROL_PERIOD_S).astype(np.intp)
        asked_s = np.minimum(CONTROL_PERIOD_S * np.arange(1, frame_steps[-1] + 1) + LEAD_S, t_s[-1])
        targets, slowed = self._within_speed(CubicSpline(t_s, q, bc_type="clamped")(asked_s), start.q)
        too_fast = np.zeros(frames, dtype=bool)
        too_fast[np.searchsorted(frame_steps, np.flatnonzero(slowed) + 1)] = True
        return Commands(
            q=targets,
            X_BG=np.stack([self.plant.forward(row) for row in targets]),
            finger_width_m=np.interp(asked_s, t_s, width),
            frame_steps=frame_steps,
            gripping=gripping,
            refused=(*refused, *_told(RejectionReason.SPEED, too_fast)),
        )

    def _path(self, t_s: Array, X_BG: Array, q_start: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Postures (T, 7) [rad] from the start on, and frames (T,) whose pose no posture reaches."""
        plant = self.plant
        for q in (solve_stepwise(plant, X_BG, q_start)[0], plan_continuation(plant, t_s, X_BG, q_start)):
            if is_sound(plant, t_s, q):
                return q, np.zeros(len(q), dtype=bool)
        q = search_path(plant, posture_solver(plant), t_s, X_BG, q_start)
        unreached: NDArray[np.bool_] = ~np.isfinite(q[:, 0])
        if not unreached.all():
            q = blend_from_start(plant, t_s, X_BG, _filled(t_s, q, ~unreached), q_start)
        q[0] = q_start
        return _filled(t_s, q, np.isfinite(q[:, 0])), unreached

    def _allowed(self, q: Array, finger_width_m: Array) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """The path (T, 7) that holds still where it would collide, and where it would with itself and the table (T,).

        The first posture is where the robot is, whatever it touches.
        """
        gaps = np.clip(finger_width_m, 0.0, self.plant.finger_width_m)
        own = self._collisions.self_distance(q, gaps).distance_m < -SELF_DEPTH_M
        table = self._collisions.table_distance(q, gaps).distance_m < -TABLE_DEPTH_M
        own[0] = table[0] = False
        last = np.maximum.accumulate(np.where(own | table, 0, np.arange(len(q))))
        return q[last], own, table & ~own

    def _within_speed(self, q: Array, q_start: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Targets (N, 7) that no joint is too slow for, and the steps (N,) at which one would have been."""
        most = self.plant.velocity_limits * CONTROL_PERIOD_S
        targets, slowed, now = np.empty_like(q), np.zeros(len(q), dtype=bool), q_start
        for i, wanted in enumerate(np.clip(q, self.plant.lower, self.plant.upper)):
            step = np.clip(wanted - now, -most, most)
            slowed[i] = np.abs(wanted - now - step).max() > SPEED_SLACK_RAD
            targets[i] = now = now + step
        return targets, slowed


def _bridged(X_BG: Array, tracked: NDArray[np.bool_]) -> Array:
    """The poses (T, 4, 4) with those that are not known put between those that are; the first one is known."""
    known = np.flatnonzero(np.append(True, tracked[1:]))
    bridged = X_BG.copy()
    for i in np.flatnonzero(~np.append(True, tracked[1:])):
        k = int(np.searchsorted(known, i))
        before, after = known[k - 1], known[min(k, len(known) - 1)]
        share = (i - before) / (after - before) if after > before else 0.0
        bridged[i] = interpolate_pose(X_BG[before], X_BG[after], float(share))
    return bridged


def _filled(t_s: Array, q: Array, known: NDArray[np.bool_]) -> Array:
    """The path (T, 7) with all but the frames `known` (T,) put between these, or held where they end."""
    if known.sum() == 1:
        return np.repeat(q[known], len(q), axis=0)
    within = np.clip(t_s, t_s[known][0], t_s[known][-1])
    return np.asarray(PchipInterpolator(t_s[known], q[known])(within))


def _finger_targets(finger_width_m: Array, X_BG: Array, start: RobotState) -> tuple[Array, bool]:
    """Gap (T,) [m] to command in each frame, and whether the fingers hold something at the end."""
    width = _whole_width(np.concatenate([[start.finger_width_m], finger_width_m[1:]]), X_BG)
    gripping, extreme = start.gripping, width[0]
    targets = np.empty_like(width)
    for i, gap in enumerate(width):
        extreme = min(extreme, gap) if gripping else max(extreme, gap)
        if abs(gap - extreme) > (RELEASE_M if gripping else GRIP_M):
            gripping, extreme = not gripping, gap
        targets[i] = gap - SQUEEZE_M if gripping else gap
    return targets, gripping


def _whole_width(width: Array, X_BG: Array) -> Array:
    """Gaps (T,) [m], the first of which is known, with those that are not (NaN) put between those that are.

    Where the fingers have opened or closed meanwhile, they did when the hand moved least: it waits for them.
    """
    known = np.flatnonzero(np.isfinite(width))
    whole = np.interp(np.arange(len(width)), known, width[known])
    distance, angle = pose_difference(X_BG[:-1], X_BG[1:])
    pace = np.convolve(np.pad(distance + LEVER_M * angle, 1, mode="edge"), np.full(3, 1.0 / 3.0), mode="valid")
    for before, after in pairwise(known):
        if after > before + 1 and abs(width[after] - width[before]) > GRIP_M:
            wait = before + int(np.argmin(pace[before:after]))
            whole[before : wait + 1], whole[wait + 1 : after] = width[before], width[after]
    return whole


def _told(reason: RejectionReason, frames: NDArray[np.bool_]) -> list[Rejection]:
    """Stretches of consecutive frames (T,)."""
    return [Rejection(reason=reason, frame_start=run.start, frame_end=run.stop - 1) for run in segments(frames)]
