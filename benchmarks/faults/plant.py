"""Planting of a fault of any kind: of the gripper's motion, its appearance, or the camera."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.faults.fault import FaultForm, FaultGrade, PlantedFault
from benchmarks.faults.fault_simulator import RenderFault, Warp
from benchmarks.faults.recording import LEAST_VISIBLE, Recording, move_camera
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, invert, make_pose, rotation_exp, transform_points
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.rollout import RolloutVideo, render_video
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import GRIPPER_LINKS
from kinebench_drake.track import MAX_WIDTH_M, IkStatus
from training.viewpoint import place_camera

DUPLICATE_FRAMES = 10
DEFORMED_FRAMES = 12
FLUTTER_FRAMES = 8
"""Frames with a second gripper, with a deformed one, and with fluttering fingers."""
FREEZE_SPEED_M_S = 0.05
"""Least mean speed of the gripper through frozen frames."""
_MAX_STEP_RAD = 0.6
"""Largest step of a joint between two frames on a displaced path [rad]."""
_SHAKE_FRAMES = 1.5
"""Standard deviation of the smoothing kernel of a shake [frames]."""
_LEVER_M = 0.1
"""Half the gripper's length [m]: a bend of strength s moves points at this distance from the hand by s/2 of it."""
_MIDDLE_H = np.array([[0.0, 0.0, 0.05]])
_LEAST_SHOWN = 0.6
"""Least visible area of the second gripper, relative to that of the first."""

Planted = tuple[RolloutVideo, PlantedFault]
"""Video with a fault, and the fault."""


def plant(recording: Recording, grade: FaultGrade) -> Planted:
    """Return the video with a fault and the fault, deterministic in episode and kind.

    Raises:
        InputError: the clip has no place for the fault.
    """
    rng = generator("fault", recording.rollout.episode.id, grade.kind.value)
    return _PLANTERS[grade.kind](recording, grade, rng)


def _frames(grade: FaultGrade) -> int:
    if grade.size < 1 or grade.size != int(grade.size):
        raise InputError(f"{grade.kind.value} of size {grade.size}: expected a whole number of frames")
    return int(grade.size)


def _vanish(recording: Recording, grade: FaultGrade, rng: np.random.Generator) -> Planted:
    """Hide hand and fingers where the gripper moves most; poses and joints are NaN there."""
    frames = _frames(grade)
    start = recording.visible_starts(frames)[0]
    part = recording.render_again(
        range(start, start + frames), lambda _: recording.simulator.set_visible(GRIPPER_LINKS, visible=False)
    )
    gone = {name: np.full_like(getattr(part, name), np.nan) for name in ("q", "finger_width_m", "X_CH", "X_BG")}
    return recording.plant(replace(part, **gone), start, grade.kind, float(frames))


def _freeze(recording: Recording, grade: FaultGrade, rng: np.random.Generator) -> Planted:
    """Repeat a frame where the gripper moves fastest, after which it jumps to its true pose."""
    frames = _frames(grade)
    start = max(recording.visible_starts(frames), key=lambda s: (_freeze_speed(recording.video, s, frames), -s))
    speed = _freeze_speed(recording.video, start, frames)
    if speed < FREEZE_SPEED_M_S:
        raise InputError(
            f"the gripper moves at {speed:.3f} m/s into or on from frames {start} to {start + frames - 1}, a freeze "
            f"there would not show; at least {FREEZE_SPEED_M_S} m/s is needed, take another seed"
        )
    frozen = recording.video.select([start - 1] * frames)
    part = replace(frozen, t_s=recording.video.t_s[start : start + frames])
    return recording.plant(part, start, grade.kind, float(frames))


def _freeze_speed(clip: RolloutVideo, start: int, frames: int) -> float:
    """Return the lower of the speeds before and, in a straight line, through a freeze [m/s]."""
    p = clip.X_BG[:, :3, 3]
    before = float(np.linalg.norm(p[start - 1] - p[start - 2]))
    through = float(np.linalg.norm(p[start + frames] - p[start - 1])) / (frames + 1)
    return min(before, through) / FRAME_PERIOD_S


def _teleport(recording: Recording, grade: FaultGrade, rng: np.random.Generator) -> Planted:
    """Displace the gripper from the middle of the clip to the end; the arm is rendered on the displaced path.

    The direction is the first of inwards, outwards (along y, relative to the middle of the table), up and back that
    the arm can follow to the end, beginning with the gripper in view.
    """
    clip = recording.video
    snapshots = recording.rollout.snapshots
    start = len(recording) // 2
    inwards = -1.0 if clip.X_BG[start, 1, 3] > 0.0 else 1.0
    for direction in ((0.0, inwards, 0.0), (0.0, -inwards, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)):
        q = _solve_displaced(snapshots[start].q, clip.X_BG[start:], grade.size * np.array(direction))
        if q is None:
            continue
        shifted = [replace(s, q=angles) for s, angles in zip(snapshots[start:], q, strict=True)]
        part = render_video(recording.simulator, shifted, first_frame=start)
        if part.mask[0].mean() >= LEAST_VISIBLE:
            return recording.plant(part, start, grade.kind, grade.size)
    raise InputError(f"the arm cannot follow its path displaced by {grade.size} m from frame {start} on; take another")


def _solve_displaced(seed: Array, X_BG: Array, offset_m: ArrayLike) -> Sequence[Array] | None:
    """Return joint angles of the path displaced by `offset_m` (3,); None if the arm cannot follow it smoothly."""
    arm = ArmPlant()
    path: list[Array] = []
    for X in X_BG:
        target = X.copy()
        target[:3, 3] += offset_m
        solution = solve_pose(arm, target, seed)
        if solution.status is not IkStatus.OK or (path and np.abs(solution.q - seed).max() > _MAX_STEP_RAD):
            return None
        path.append(solution.q)
        seed = solution.q
    return path


def _fingers(recording: Recording, grade: FaultGrade, rng: np.random.Generator) -> Planted:
    """Render fingers whose gap alternates with each frame by the size of the fault."""
    if grade.size > MAX_WIDTH_M:
        raise InputError(f"fingers cannot open by {grade.size} m, only by {MAX_WIDTH_M} m")
    start = recording.visible_starts(FLUTTER_FRAMES)[0]
    middle = np.clip(recording.video.finger_width_m, grade.size / 2, MAX_WIDTH_M - grade.size / 2)
    width = middle[start : start + FLUTTER_FRAMES] + grade.size / 2 * (-1.0) ** np.arange(FLUTTER_FRAMES)
    snapshots = recording.rollout.snapshots[start : start + FLUTTER_FRAMES]
    altered = [replace(s, fingers_m=np.full(2, w / 2)) for s, w in zip(snapshots, width, strict=True)]
    part = render_video(recording.simulator, altered, first_frame=start)
    return recording.plant(part, start, grade.kind, grade.size)


def _camera_motion(recording: Recording, grade: FaultGrade, rng: np.random.Generator) -> Planted:
    """Render with a camera that shakes (rotation) or drifts (translation); the first frame is unchanged.

    The size is the largest displacement of the image centre [px].
    """
    n = len(recording)
    form = grade.form or FaultForm.SHAKE
    camera = recording.video.camera
    if form is FaultForm.SHAKE:
        path = _shake(n, rng)
    else:
        angle = rng.uniform(0.0, 2 * np.pi)
        path = np.linspace(0.0, 1.0, n)[:, None] * np.array([np.cos(angle), np.sin(angle)])
    depth_m = np.median(recording.video.depth_mm[0][recording.video.depth_mm[0] > 0]) / 1000.0

    def displace(i: int) -> None:
        u, v = grade.size * path[i] / [camera.fx, camera.fy]
        if form is FaultForm.SHAKE:
            moved = move_camera(camera, rotation=[v, -u, 0.0])
        else:
            moved = move_camera(camera, translation=[-u * depth_m, -v * depth_m, 0.0])
        place_camera(recording.simulator, moved)

    return recording.plant(recording.render_again(range(1, n), displace), 1, grade.kind, grade.size, form)


def _shake(n: int, rng: np.random.Generator) -> Array:
    """Draw smooth noise (n, 2) with 0 at the start and a maximum norm of 1."""
    lag = np.arange(-6, 7)
    kernel = np.exp(-0.5 * (lag / _SHAKE_FRAMES) ** 2)
    noise = rng.normal(size=(n + len(lag) - 1, 2))
    path = np.stack([np.convolve(noise[:, axis], kernel, mode="valid") for axis in (0, 1)], axis=1)
    path -= path[0]
    return np.asarray(path / np.linalg.norm(path, axis=1).max())


def _duplicate(recording: Recording, grade: FaultGrade, rng: np.random.Generator) -> Planted:
    """Render a second gripper beside the robot's for some frames, moving in parallel."""
    start = recording.visible_starts(DUPLICATE_FRAMES)[0]
    frames = range(start, start + DUPLICATE_FRAMES)
    sides = [np.array(d) for d in ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))]
    for side in (sides[i] for i in rng.permutation(len(sides))):
        if not all(_inside(recording, i, grade.size * side) for i in frames):
            continue

        def add_gripper(i: int, offset: Array = grade.size * side) -> None:
            X_BH = recording.video.camera.X_BC @ recording.video.X_CH[i]
            X_HP = make_pose(np.eye(3), X_BH[:3, :3].T @ offset)
            recording.simulator.set_fault(RenderFault(warp=lambda p: p, X_HP=X_HP, replaces=False))

        part = recording.render_again(frames, add_gripper)
        own = recording.video.mask[frames.start : frames.stop]
        changed = (np.abs(part.rgb.astype(np.int16) - recording.video.rgb[frames.start : frames.stop]) > 8).any(axis=-1)
        if part.mask.mean() >= LEAST_VISIBLE / 2 and (changed & ~own).sum() >= _LEAST_SHOWN * own.sum():
            return recording.plant(part, start, grade.kind, grade.size)
    raise InputError(f"there is no room for a second gripper {grade.size} m from the first; take another seed")


def _inside(recording: Recording, frame: int, offset_B: Array) -> bool:
    """Return whether the centre of a gripper with an offset to the robot's is in the image."""
    camera = recording.video.camera
    X_BH = camera.X_BC @ recording.video.X_CH[frame]
    X_BH[:3, 3] += offset_B
    pixel = camera.project(transform_points(invert(camera.X_BC) @ X_BH, _MIDDLE_H)[0])
    margin = 0.08 * camera.width
    return bool((pixel > margin).all() and (pixel < [camera.width - margin, camera.height - margin]).all())


def _deformation(recording: Recording, grade: FaultGrade, rng: np.random.Generator) -> Planted:
    """Render the gripper stretched, squeezed and bent for some frames."""
    start = recording.visible_starts(DEFORMED_FRAMES)[0]
    fault = RenderFault(warp=deformation(grade.size, rng), X_HP=np.eye(4), replaces=True)
    part = recording.render_again(range(start, start + DEFORMED_FRAMES), lambda _: recording.simulator.set_fault(fault))
    return recording.plant(part, start, grade.kind, grade.size)


def deformation(strength: float, rng: np.random.Generator) -> Warp:
    """Return a volume-preserving change of shape: stretches of zero sum along random axes, and a bend.

    `strength` is the relative stretch of the most stretched axis, and the slope of the bend at the fingertips.
    """
    R = rotation_exp(rng.normal(size=3))
    stretch = rng.normal(size=3)
    stretch -= stretch.mean()
    stretch /= np.abs(stretch).max()
    A = R @ np.diag(1.0 + strength * stretch) @ R.T
    angle = rng.uniform(0.0, 2 * np.pi)
    bend = strength * np.array([np.cos(angle), np.sin(angle), 0.0]) / (2 * _LEVER_M)

    def warp(p_H: Array) -> Array:
        return np.asarray(p_H @ A.T + bend * p_H[:, 2:] ** 2)

    return warp


_PLANTERS: Mapping[AnomalyKind, Callable[[Recording, FaultGrade, np.random.Generator], Planted]] = {
    AnomalyKind.VANISH: _vanish,
    AnomalyKind.DUPLICATE: _duplicate,
    AnomalyKind.TELEPORT: _teleport,
    AnomalyKind.FREEZE: _freeze,
    AnomalyKind.DEFORMATION: _deformation,
    AnomalyKind.CAMERA: _camera_motion,
    AnomalyKind.FINGERS: _fingers,
}
"""Functions that plant each kind; they raise InputError if the clip has no place for the fault."""
