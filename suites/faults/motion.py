"""Faults of the motion: the gripper vanishes, jumps, or the picture freezes while it moves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.products import AnomalyKind, IkStatus
from kinebench_drake.suites.clip import Clip, film
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.faults.fault import PlantedFault
from kinebench_drake.suites.faults.take import LEAST_VISIBLE, Take
from kinebench_drake.suites.stage import GRIPPER_LINKS

FREEZE_SPEED_M_S = 0.05
"""The gripper moves at least this fast, on average, through the frames frozen."""
_MAX_STEP_RAD = 0.6  # of a joint between two frames on a displaced path


def plant_vanish(take: Take, frames: int, start: int | None = None) -> tuple[Clip, PlantedFault]:
    """The clip with hand and fingers not drawn for some frames; poses and joints are NaN there.

    Args:
        take: what to alter.
        frames: how many.
        start: first frame; where the gripper moves most, if not given.

    Raises:
        InputError: the gripper is never in view long enough.
    """
    start = take.stretches(frames)[0] if start is None else start
    part = take.film_again(range(start, start + frames), lambda _: take.stage.draw(GRIPPER_LINKS, visible=False))
    gone = {name: np.full_like(getattr(part, name), np.nan) for name in ("q", "finger_width_m", "X_CH", "X_BG")}
    fault = PlantedFault(kind=AnomalyKind.VANISH, frame_start=start, frame_end=start + frames - 1, size=float(frames))
    return take.spliced(replace(part, **gone), start), fault


def plant_freeze(take: Take, frames: int, start: int | None = None) -> tuple[Clip, PlantedFault]:
    """The clip with some frames that repeat the one before, then the jump to where the gripper truly is.

    Args:
        take: what to alter.
        frames: how many.
        start: first frozen frame; where the gripper comes in fastest and goes on, if not given.

    Raises:
        InputError: the gripper does not come in at `FREEZE_SPEED_M_S` and go on as fast on average.
    """
    if start is None:
        start = max(take.stretches(frames), key=lambda s: (_freeze_speed(take.clip, s, frames), -s))
    speed = _freeze_speed(take.clip, start, frames)
    if speed < FREEZE_SPEED_M_S:
        raise InputError(
            f"the gripper moves at {speed:.3f} m/s into or on from frames {start} to {start + frames - 1}, a freeze "
            f"there would not show; at least {FREEZE_SPEED_M_S} m/s is needed, take another seed"
        )
    fault = PlantedFault(kind=AnomalyKind.FREEZE, frame_start=start, frame_end=start + frames - 1, size=float(frames))
    return take.spliced(take.held(start - 1, frames), start), fault


def _freeze_speed(clip: Clip, start: int, frames: int) -> float:
    """The lower of the speeds before a freeze and, as the crow flies, through it [m/s]: what makes it show."""
    p = clip.X_BG[:, :3, 3]
    before = float(np.linalg.norm(p[start - 1] - p[start - 2]))
    through = float(np.linalg.norm(p[start + frames] - p[start - 1])) / (frames + 1)
    return min(before, through) / FRAME_PERIOD_S


def plant_teleport(take: Take, distance_m: float, start: int | None = None) -> tuple[Clip, PlantedFault]:
    """The clip with the gripper some way off from one frame to the end: the arm is drawn on the displaced path.

    The way it jumps is the first of inwards, outwards (along y, seen from the middle of the table), up, back that the
    arm can follow to the end, beginning with the gripper in view.

    Args:
        take: what to alter.
        distance_m: how far it jumps.
        start: first displaced frame; the middle of the clip, if not given.

    Raises:
        InputError: no direction will do.
    """
    clip, snapshots = take.clip, take.performance.snapshots
    start = len(take) // 2 if start is None else start
    inwards = -1.0 if clip.X_BG[start, 1, 3] > 0.0 else 1.0
    for direction in ((0.0, inwards, 0.0), (0.0, -inwards, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)):
        q = _displaced(snapshots[start].q, clip.X_BG[start:], distance_m * np.array(direction))
        if q is None:
            continue
        shifted = [replace(s, q=angles) for s, angles in zip(snapshots[start:], q, strict=True)]
        part = film(take.stage, shifted, first_frame=start)
        if part.mask[0].mean() >= LEAST_VISIBLE:
            fault = PlantedFault(kind=AnomalyKind.TELEPORT, frame_start=start, frame_end=len(take) - 1, size=distance_m)
            return take.spliced(part, start), fault
    raise InputError(f"the arm cannot follow its path displaced by {distance_m} m from frame {start} on; take another")


def _displaced(seed: Array, X_BG: Array, offset_m: ArrayLike) -> Sequence[Array] | None:
    """Joint angles of the path moved by `offset_m` (3,), or None where the arm cannot follow it smoothly."""
    plant = ArmPlant()
    path: list[Array] = []
    for X in X_BG:
        target = X.copy()
        target[:3, 3] += offset_m
        solution = solve_pose(plant, target, seed)
        if solution.status is not IkStatus.OK or (path and np.abs(solution.q - seed).max() > _MAX_STEP_RAD):
            return None
        path.append(solution.q)
        seed = solution.q
    return path
