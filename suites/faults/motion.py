"""Faults of the motion: the gripper vanishes, jumps, or the picture freezes while it moves."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clip import RolloutVideo, film
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.faults.fault import FaultForm, PlantedFault
from kinebench_drake.suites.faults.recording import LEAST_VISIBLE, Recording
from kinebench_drake.suites.simulator import GRIPPER_LINKS
from kinebench_drake.types import AnomalyKind, IkStatus

FREEZE_SPEED_M_S = 0.05
"""The gripper moves at least this fast, on average, through the frames frozen."""
_MAX_STEP_RAD = 0.6  # of a joint between two frames on a displaced path


def plant_vanish(take: Recording, frames: int, start: int | None = None) -> tuple[RolloutVideo, PlantedFault]:
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


def plant_freeze(take: Recording, frames: int, start: int | None = None) -> tuple[RolloutVideo, PlantedFault]:
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


def _freeze_speed(clip: RolloutVideo, start: int, frames: int) -> float:
    """The lower of the speeds before a freeze and, as the crow flies, through it [m/s]: what makes it show."""
    p = clip.X_BG[:, :3, 3]
    before = float(np.linalg.norm(p[start - 1] - p[start - 2]))
    through = float(np.linalg.norm(p[start + frames] - p[start - 1])) / (frames + 1)
    return min(before, through) / FRAME_PERIOD_S


def plant_teleport(take: Recording, distance_m: float, start: int | None = None) -> tuple[RolloutVideo, PlantedFault]:
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


MAX_WIDTH_M = 0.08
"""Widest gap between the pads."""
FLUTTER_FRAMES = 8
"""Frames of a flutter."""
_MIN_AFTER = 4  # frames that must follow a jump


def plant_fingers(take: Recording, size_m: float, form: FaultForm) -> tuple[RolloutVideo, PlantedFault]:
    """The clip with fingers drawn elsewhere: to and fro with each frame, or off at once to the end of the clip.

    Args:
        take: what to alter.
        size_m: change of the gap between the pads.
        form: flutter or jump.

    Raises:
        InputError: fingers cannot open so far from where they are, or are never in view long enough.
    """
    if size_m > MAX_WIDTH_M:
        raise InputError(f"fingers cannot open by {size_m} m, only by {MAX_WIDTH_M} m")
    if form is FaultForm.FLUTTER:
        start = take.stretches(FLUTTER_FRAMES)[0]
        width = np.clip(take.clip.finger_width_m, size_m / 2, MAX_WIDTH_M - size_m / 2)[start : start + FLUTTER_FRAMES]
        width = width + size_m / 2 * (-1.0) ** np.arange(FLUTTER_FRAMES)
    else:
        start, change = _jump(take, size_m)
        width = np.clip(take.clip.finger_width_m[start:] + change, 0.0, MAX_WIDTH_M)
    snapshots = take.performance.snapshots[start : start + len(width)]
    drawn = [replace(s, fingers_m=np.full(2, w / 2)) for s, w in zip(snapshots, width, strict=True)]
    fault = PlantedFault(
        kind=AnomalyKind.FINGERS, frame_start=start, frame_end=start + len(width) - 1, size=size_m, form=form
    )
    return take.spliced(film(take.stage, drawn, first_frame=start), start), fault


def _jump(take: Recording, size_m: float) -> tuple[int, float]:
    """Frame nearest to the middle of the clip from which the gap can change by so much, and the change [m]."""
    n = len(take)
    for start in sorted(take.stretches(_MIN_AFTER), key=lambda i: (abs(i - n // 2), i)):
        here = take.clip.finger_width_m[start - 2 : start + _MIN_AFTER]
        if np.ptp(here) > 0.002:
            continue
        if here.max() + size_m <= MAX_WIDTH_M + 1e-3:
            return start, size_m
        if here.min() - size_m >= -1e-3:
            return start, -size_m
    raise InputError(f"nowhere in this clip fingers can open or close by {size_m} m; take another seed")


_SHAKE_FRAMES = 1.5  # standard deviation of the kernel that smooths a hand's shake


def plant_camera_motion(
    take: Recording, size_px: float, form: FaultForm, rng: np.random.Generator
) -> tuple[RolloutVideo, PlantedFault]:
    """The clip filmed by a camera that shakes (turning) or drifts off (moving sideways); the first frame is as it was.

    Args:
        take: what to alter.
        size_px: how far what is in the middle of the picture moves at most.
        form: shake or drift.
        rng: picks the motion.
    """
    n = len(take)
    path = _shake(n, rng) if form is FaultForm.SHAKE else _drift(n, rng)
    cameras = [_moved(take, size_px * offset, turning=form is FaultForm.SHAKE) for offset in path]
    part = take.film_again(range(1, n), lambda i: take.stage.aim(cameras[i]))
    fault = PlantedFault(kind=AnomalyKind.CAMERA, frame_start=1, frame_end=n - 1, size=size_px, form=form)
    return take.spliced(part, 1), fault


def _shake(n: int, rng: np.random.Generator) -> Array:
    """(n, 2) smooth noise from 0 at the start, 1 at its largest."""
    lag = np.arange(-6, 7)
    kernel = np.exp(-0.5 * (lag / _SHAKE_FRAMES) ** 2)
    noise = rng.normal(size=(n + len(lag) - 1, 2))
    path = np.stack([np.convolve(noise[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    path -= path[0]
    return np.asarray(path / np.linalg.norm(path, axis=1).max())


def _drift(n: int, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0.0, 2 * np.pi)
    return np.asarray(np.linspace(0.0, 1.0, n)[:, None] * np.array([np.cos(angle), np.sin(angle)]))


def _moved(take: Recording, offset_px: Array, *, turning: bool) -> Camera:
    """The camera turned or moved so that the middle of the picture goes by `offset_px` (2,)."""
    camera = take.clip.camera
    u, v = offset_px / [camera.fx, camera.fy]
    if turning:
        X_CD = make_pose(rotation_exp([v, -u, 0.0]), np.zeros(3))
    else:
        depth_m = np.median(take.clip.depth_mm[0][take.clip.depth_mm[0] > 0]) / 1000.0
        X_CD = make_pose(np.eye(3), [-u * depth_m, -v * depth_m, 0.0])
    return replace(camera, X_BC=camera.X_BC @ X_CD)
