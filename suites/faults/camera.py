"""A camera that moves although the benchmark's is fixed."""

from dataclasses import replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.products import AnomalyKind
from kinebench_drake.suites.clip import Clip
from kinebench_drake.suites.faults.fault import Form, PlantedFault
from kinebench_drake.suites.faults.take import Take

_SHAKE_FRAMES = 1.5  # standard deviation of the kernel that smooths a hand's shake


def plant_camera_motion(take: Take, size_px: float, form: Form, rng: np.random.Generator) -> tuple[Clip, PlantedFault]:
    """The clip filmed by a camera that shakes (turning) or drifts off (moving sideways); the first frame is as it was.

    Args:
        take: what to alter.
        size_px: how far what is in the middle of the picture moves at most.
        form: shake or drift.
        rng: picks the motion.
    """
    n = len(take)
    path = _shake(n, rng) if form is Form.SHAKE else _drift(n, rng)
    cameras = [_moved(take, size_px * offset, turning=form is Form.SHAKE) for offset in path]
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


def _moved(take: Take, offset_px: Array, *, turning: bool) -> Camera:
    """The camera turned or moved so that the middle of the picture goes by `offset_px` (2,)."""
    camera = take.clip.camera
    u, v = offset_px / [camera.fx, camera.fy]
    if turning:
        X_CD = make_pose(rotation_exp([v, -u, 0.0]), np.zeros(3))
    else:
        depth_m = np.median(take.clip.depth_mm[0][take.clip.depth_mm[0] > 0]) / 1000.0
        X_CD = make_pose(np.eye(3), [-u * depth_m, -v * depth_m, 0.0])
    return replace(camera, X_BC=camera.X_BC @ X_CD)
