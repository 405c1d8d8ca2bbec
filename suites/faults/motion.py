"""Faults of the motion: vanishing, freeze, teleport, fingers, camera motion."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.faults.fault import FaultForm, PlantedFault
from kinebench_drake.suites.faults.recording import LEAST_VISIBLE, Recording
from kinebench_drake.suites.rollout import RolloutVideo, render_video
from kinebench_drake.suites.simulator import GRIPPER_LINKS
from kinebench_drake.track import IkStatus

FREEZE_SPEED_M_S = 0.05
"""Least mean speed of the gripper through frozen frames."""
_MAX_STEP_RAD = 0.6  # largest step of a joint between two frames on a displaced path


def plant_vanish(recording: Recording, frames: int) -> tuple[RolloutVideo, PlantedFault]:
    """Hide hand and fingers where the gripper moves most; poses and joints are NaN there.

    Args:
        recording: recording to alter.
        frames: number of frames.

    Raises:
        InputError: the gripper is not in view long enough.
    """
    start = recording.visible_starts(frames)[0]
    part = recording.render_again(
        range(start, start + frames), lambda _: recording.simulator.set_visible(GRIPPER_LINKS, visible=False)
    )
    gone = {name: np.full_like(getattr(part, name), np.nan) for name in ("q", "finger_width_m", "X_CH", "X_BG")}
    return recording.plant(replace(part, **gone), start, AnomalyKind.VANISH, float(frames))


def plant_freeze(recording: Recording, frames: int) -> tuple[RolloutVideo, PlantedFault]:
    """Repeat a frame for some frames, after which the gripper jumps to its true pose.

    The freeze begins where the gripper moves fastest before and through it.

    Args:
        recording: recording to alter.
        frames: number of frames.

    Raises:
        InputError: the gripper is slower than `FREEZE_SPEED_M_S` before or through the freeze.
    """
    start = max(recording.visible_starts(frames), key=lambda s: (_freeze_speed(recording.video, s, frames), -s))
    speed = _freeze_speed(recording.video, start, frames)
    if speed < FREEZE_SPEED_M_S:
        raise InputError(
            f"the gripper moves at {speed:.3f} m/s into or on from frames {start} to {start + frames - 1}, a freeze "
            f"there would not show; at least {FREEZE_SPEED_M_S} m/s is needed, take another seed"
        )
    return recording.plant(recording.repeat(start - 1, frames), start, AnomalyKind.FREEZE, float(frames))


def _freeze_speed(clip: RolloutVideo, start: int, frames: int) -> float:
    """Return the lower of the speeds before and, in a straight line, through a freeze [m/s]."""
    p = clip.X_BG[:, :3, 3]
    before = float(np.linalg.norm(p[start - 1] - p[start - 2]))
    through = float(np.linalg.norm(p[start + frames] - p[start - 1])) / (frames + 1)
    return min(before, through) / FRAME_PERIOD_S


def plant_teleport(recording: Recording, distance_m: float) -> tuple[RolloutVideo, PlantedFault]:
    """Displace the gripper from the middle of the clip to the end; the arm is rendered on the displaced path.

    The direction is the first of inwards, outwards (along y, relative to the middle of the table), up and back that
    the arm can follow to the end, beginning with the gripper in view.

    Args:
        recording: recording to alter.
        distance_m: length of the jump [m].

    Raises:
        InputError: no direction is feasible.
    """
    clip, snapshots = recording.video, recording.rollout.snapshots
    start = len(recording) // 2
    inwards = -1.0 if clip.X_BG[start, 1, 3] > 0.0 else 1.0
    for direction in ((0.0, inwards, 0.0), (0.0, -inwards, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)):
        q = _solve_displaced(snapshots[start].q, clip.X_BG[start:], distance_m * np.array(direction))
        if q is None:
            continue
        shifted = [replace(s, q=angles) for s, angles in zip(snapshots[start:], q, strict=True)]
        part = render_video(recording.simulator, shifted, first_frame=start)
        if part.mask[0].mean() >= LEAST_VISIBLE:
            return recording.plant(part, start, AnomalyKind.TELEPORT, distance_m)
    raise InputError(f"the arm cannot follow its path displaced by {distance_m} m from frame {start} on; take another")


def _solve_displaced(seed: Array, X_BG: Array, offset_m: ArrayLike) -> Sequence[Array] | None:
    """Return joint angles of the path displaced by `offset_m` (3,); None if the arm cannot follow it smoothly."""
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
"""Largest gap between the pads."""
FLUTTER_FRAMES = 8
"""Frames with fluttering fingers."""
_MIN_AFTER = 4  # least number of frames after a jump


def plant_fingers(recording: Recording, size_m: float, form: FaultForm) -> tuple[RolloutVideo, PlantedFault]:
    """Render fingers with a wrong gap: alternating with each frame, or with a step until the end of the clip.

    Args:
        recording: recording to alter.
        size_m: change of the gap between the pads [m].
        form: flutter or jump.

    Raises:
        InputError: the gap cannot change by so much, or the fingers are not in view long enough.
    """
    if size_m > MAX_WIDTH_M:
        raise InputError(f"fingers cannot open by {size_m} m, only by {MAX_WIDTH_M} m")
    if form is FaultForm.FLUTTER:
        start = recording.visible_starts(FLUTTER_FRAMES)[0]
        width = np.clip(recording.video.finger_width_m, size_m / 2, MAX_WIDTH_M - size_m / 2)[
            start : start + FLUTTER_FRAMES
        ]
        width = width + size_m / 2 * (-1.0) ** np.arange(FLUTTER_FRAMES)
    else:
        start, change = _jump(recording, size_m)
        width = np.clip(recording.video.finger_width_m[start:] + change, 0.0, MAX_WIDTH_M)
    snapshots = recording.rollout.snapshots[start : start + len(width)]
    altered = [replace(s, fingers_m=np.full(2, w / 2)) for s, w in zip(snapshots, width, strict=True)]
    part = render_video(recording.simulator, altered, first_frame=start)
    return recording.plant(part, start, AnomalyKind.FINGERS, size_m, form)


def _jump(recording: Recording, size_m: float) -> tuple[int, float]:
    """Return the frame nearest to the clip's middle from which the gap can change by `size_m`, and the change [m]."""
    n = len(recording)
    for start in sorted(recording.visible_starts(_MIN_AFTER), key=lambda i: (abs(i - n // 2), i)):
        here = recording.video.finger_width_m[start - 2 : start + _MIN_AFTER]
        if np.ptp(here) > 0.002:
            continue
        if here.max() + size_m <= MAX_WIDTH_M + 1e-3:
            return start, size_m
        if here.min() - size_m >= -1e-3:
            return start, -size_m
    raise InputError(f"nowhere in this clip fingers can open or close by {size_m} m; take another seed")


_SHAKE_FRAMES = 1.5  # standard deviation of the smoothing kernel of a shake


def plant_camera_motion(
    recording: Recording, size_px: float, form: FaultForm, rng: np.random.Generator
) -> tuple[RolloutVideo, PlantedFault]:
    """Render with a camera that shakes (rotation) or drifts (translation); the first frame is unchanged.

    Args:
        recording: recording to alter.
        size_px: largest displacement of the image centre [px].
        form: shake or drift.
        rng: draws the motion.
    """
    n = len(recording)
    if form is FaultForm.SHAKE:
        path = _shake(n, rng)
    else:
        angle = rng.uniform(0.0, 2 * np.pi)
        path = np.linspace(0.0, 1.0, n)[:, None] * np.array([np.cos(angle), np.sin(angle)])
    cameras = [_shift_camera(recording, size_px * offset, turning=form is FaultForm.SHAKE) for offset in path]
    part = recording.render_again(range(1, n), lambda i: recording.simulator.set_camera_pose(cameras[i]))
    return recording.plant(part, 1, AnomalyKind.CAMERA, size_px, form)


def _shake(n: int, rng: np.random.Generator) -> Array:
    """Draw smooth noise (n, 2) with 0 at the start and a maximum norm of 1."""
    lag = np.arange(-6, 7)
    kernel = np.exp(-0.5 * (lag / _SHAKE_FRAMES) ** 2)
    noise = rng.normal(size=(n + len(lag) - 1, 2))
    path = np.stack([np.convolve(noise[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    path -= path[0]
    return np.asarray(path / np.linalg.norm(path, axis=1).max())


def _shift_camera(recording: Recording, offset_px: Array, *, turning: bool) -> Camera:
    """Return the camera rotated or moved so that the image centre shifts by `offset_px` (2,)."""
    camera = recording.video.camera
    u, v = offset_px / [camera.fx, camera.fy]
    if turning:
        X_CD = make_pose(rotation_exp([v, -u, 0.0]), np.zeros(3))
    else:
        depth_m = np.median(recording.video.depth_mm[0][recording.video.depth_mm[0] > 0]) / 1000.0
        X_CD = make_pose(np.eye(3), [-u * depth_m, -v * depth_m, 0.0])
    return replace(camera, X_BC=camera.X_BC @ X_CD)
