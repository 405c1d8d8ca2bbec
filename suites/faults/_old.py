"""Clips with one planted fault of the kinds that world models make, and the truth as drawn.

The faults are rendered, not painted: the same scene is filmed again with links hidden or joints elsewhere. Objects stay
where the simulation had them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.products import AnomalyKind, IkStatus
from kinebench_drake.suites.rollout import FRAME_PERIOD_S, GRIPPER_LINKS, Clip, Performance, Stage, film

VANISH_FRAMES = 10
"""Frames without a gripper."""
FREEZE_FRAMES = 8
"""Frames that show the one before them."""
FREEZE_SPEED_M_S = 0.05
"""The gripper moves at least this fast, on average, through the frames frozen."""
TELEPORT_M = 0.15
"""How far the gripper jumps."""
LEAST_VISIBLE = 0.01
"""Part of the image that the gripper must cover for a fault to be seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedFault:
    """What was done to a clip."""

    kind: AnomalyKind
    """Kind of the fault."""
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    size: float
    """Frames without gripper (vanish), metres jumped (teleport), frames frozen (freeze)."""


def _splice(clip: Clip, part: Clip, start: int) -> Clip:
    """The clip with the frames from `start` on replaced by those of `part`."""
    end = start + len(part.t_s)
    merged = {}
    for field in fields(Clip):
        value = getattr(clip, field.name)
        if field.name not in ("camera", "t_s"):
            value = value.copy()
            value[start:end] = getattr(part, field.name)
        merged[field.name] = value
    return Clip(**merged)


def _moving(clip: Clip, frames: int) -> list[int]:
    """Frames that begin a stretch of `frames` frames with the gripper in view, fastest stretch first.

    Stretches end two frames before the clip does, so that the clip recovers, and begin three in.
    """
    visible = clip.mask.mean(axis=(1, 2)) >= LEAST_VISIBLE
    p = clip.X_BG[:, :3, 3]
    starts = [i for i in range(3, len(p) - frames - 1) if visible[i - 1 : i + frames + 1].all()]
    if not starts:
        raise InputError(
            f"in no {frames} frames in a row the gripper covers {LEAST_VISIBLE:.0%} of the image; take another seed"
        )
    way = {i: float(np.linalg.norm(np.diff(p[i - 1 : i + frames + 1], axis=0), axis=1).sum()) for i in starts}
    return sorted(starts, key=lambda i: (-way[i], i))


def plant_vanish(
    stage: Stage, performance: Performance, clip: Clip, start: int | None = None
) -> tuple[Clip, PlantedFault]:
    """The clip with hand and fingers not drawn for `VANISH_FRAMES` frames; poses and joints are NaN there.

    Args:
        stage: the scene of the performance, after its `reset`.
        performance: what the clip shows.
        clip: the clip without a fault.
        start: first frame; where the gripper moves most, if not given.

    Raises:
        InputError: the gripper is never in view long enough.
    """
    start = _moving(clip, VANISH_FRAMES)[0] if start is None else start
    end = start + VANISH_FRAMES
    stage.draw(GRIPPER_LINKS, visible=False)
    try:
        part = film(stage, performance.snapshots[start:end], first_frame=start)
    finally:
        stage.draw(GRIPPER_LINKS, visible=True)
    gone = {name: np.full_like(getattr(part, name), np.nan) for name in ("q", "finger_width_m", "X_CH", "X_BG")}
    fault = PlantedFault(kind=AnomalyKind.VANISH, frame_start=start, frame_end=end - 1, size=float(VANISH_FRAMES))
    return _splice(clip, replace(part, **gone), start), fault


def plant_freeze(clip: Clip, start: int | None = None) -> tuple[Clip, PlantedFault]:
    """The clip with `FREEZE_FRAMES` frames that repeat the one before, then the jump to where the gripper truly is.

    Args:
        clip: the clip without a fault.
        start: first frozen frame; where the gripper comes in fastest and goes on, if not given.

    Raises:
        InputError: the gripper does not come in at `FREEZE_SPEED_M_S` and go on as fast on average.
    """
    start = _fastest_entry(clip) if start is None else start
    end = start + FREEZE_FRAMES
    speed = _freeze_speed(clip, start)
    if speed < FREEZE_SPEED_M_S:
        raise InputError(
            f"the gripper moves at {speed:.3f} m/s into or on from frames {start} to {end - 1}, a freeze there would "
            f"not show; at least {FREEZE_SPEED_M_S} m/s is needed, take another seed"
        )
    frozen = {
        field.name: np.repeat(getattr(clip, field.name)[start - 1 : start], FREEZE_FRAMES, axis=0)
        for field in fields(Clip)
        if field.name not in ("camera", "t_s")
    }
    part = Clip(camera=clip.camera, t_s=clip.t_s[start:end], **frozen)
    fault = PlantedFault(kind=AnomalyKind.FREEZE, frame_start=start, frame_end=end - 1, size=float(FREEZE_FRAMES))
    return _splice(clip, part, start), fault


def _freeze_speed(clip: Clip, start: int) -> float:
    """The lower of the speeds before a freeze and, as the crow flies, through it [m/s]: what makes it show."""
    p = clip.X_BG[:, :3, 3]
    before = float(np.linalg.norm(p[start - 1] - p[start - 2]))
    through = float(np.linalg.norm(p[start + FREEZE_FRAMES] - p[start - 1])) / (FREEZE_FRAMES + 1)
    return min(before, through) / FRAME_PERIOD_S


def _fastest_entry(clip: Clip) -> int:
    """The start at which a freeze shows best; the earliest of equals."""
    return max(_moving(clip, FREEZE_FRAMES), key=lambda start: (_freeze_speed(clip, start), -start))


def plant_teleport(
    stage: Stage, performance: Performance, clip: Clip, start: int | None = None
) -> tuple[Clip, PlantedFault]:
    """The clip with the gripper `TELEPORT_M` off from one frame to the end: the arm is drawn on the displaced path.

    The way it jumps is the first of inwards, outwards (along y, seen from the middle of the table), up, back that the
    arm can follow to the end, beginning with the gripper in view.

    Args:
        stage: the scene of the performance, after its `reset`.
        performance: what the clip shows.
        clip: the clip without a fault.
        start: first displaced frame; the middle of the clip, if not given.

    Raises:
        InputError: no direction will do.
    """
    start = len(clip.t_s) // 2 if start is None else start
    inwards = -1.0 if clip.X_BG[start, 1, 3] > 0.0 else 1.0
    for direction in ((0.0, inwards, 0.0), (0.0, -inwards, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)):
        q = _displaced(performance, clip.X_BG[start:], start, TELEPORT_M * np.array(direction))
        if q is None:
            continue
        shifted = [replace(s, q=angles) for s, angles in zip(performance.snapshots[start:], q, strict=True)]
        part = film(stage, shifted, first_frame=start)
        if part.mask[0].mean() >= LEAST_VISIBLE:
            fault = PlantedFault(
                kind=AnomalyKind.TELEPORT, frame_start=start, frame_end=len(clip.t_s) - 1, size=TELEPORT_M
            )
            return _splice(clip, part, start), fault
    raise InputError(f"the arm cannot follow its path displaced by {TELEPORT_M} m from frame {start} on; take another")


def _displaced(performance: Performance, X_BG: Array, start: int, offset_m: ArrayLike) -> Sequence[Array] | None:
    """Joint angles of the path moved by `offset_m` (3,), or None where the arm cannot follow it smoothly."""
    plant = ArmPlant()
    path: list[Array] = []
    seed = performance.snapshots[start].q
    for X in X_BG:
        target = X.copy()
        target[:3, 3] += offset_m
        solution = solve_pose(plant, target, seed)
        if solution.status is not IkStatus.OK or (path and np.abs(solution.q - seed).max() > 0.6):
            return None
        path.append(solution.q)
        seed = solution.q
    return path
