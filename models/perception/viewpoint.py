"""Cameras near the benchmark's, from which training pictures are taken."""

import numpy as np

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import make_pose, rotation_exp

_SHIFT_M, _TURN_RAD = 0.06, np.deg2rad(6.0)
_FOV_RAD = np.deg2rad((45.0, 75.0))
_VARIED_FOV = 0.6  # share of cameras whose field of view is another than the benchmark's


def varied_camera(rng: np.random.Generator, size: int) -> Camera:
    """The benchmark camera moved by up to 6 cm and 6 degrees along and about each axis, field of view 45 to 75 degrees.

    Its pictures are `size` pixels wide and high.
    """
    benchmark = benchmark_camera()
    shift = make_pose(rotation_exp(rng.uniform(-_TURN_RAD, _TURN_RAD, 3)), rng.uniform(-_SHIFT_M, _SHIFT_M, 3))
    focal = benchmark.fx * size / benchmark.width
    if rng.random() < _VARIED_FOV:
        focal = float(size / 2 / np.tan(rng.uniform(*_FOV_RAD) / 2))
    centre = size / 2
    return Camera(width=size, height=size, fx=focal, fy=focal, cx=centre, cy=centre, X_BC=benchmark.X_BC @ shift)
