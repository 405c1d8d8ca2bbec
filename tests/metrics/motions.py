"""Motions whose truth is known."""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.suites.expert.motion import minimum_jerk
from kinebench_drake.track import GripperTrack


def reach_and_place(period_s: float, duration_s: float = 9.6) -> tuple[Array, Array]:
    """Times (T,) and poses (T, 4, 4) of four minimum-jerk moves of 1.2 s, with rests of 1.2 s between them."""
    t_s = period_s * np.arange(round(duration_s / period_s) + 1)
    stops = np.array([[0.4, 0.0, 0.3], [0.55, 0.15, 0.12], [0.5, 0.0, 0.3], [0.6, -0.15, 0.1], [0.5, -0.1, 0.3]])
    turns = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.8], [0.2, 0.0, 0.8], [0.2, -0.3, 0.0], [0.0, 0.0, 0.0]])
    done = minimum_jerk((t_s[:, None] - 0.6 - 2.4 * np.arange(4)) / 1.2)
    p = stops[0] + done @ np.diff(stops, axis=0)
    return t_s, make_pose(rotation_exp(turns[0] + done @ np.diff(turns, axis=0)), p)


def with_noise(X: Array, position_m: ArrayLike, rotation_rad: float, rng: np.random.Generator) -> Array:
    """Poses (T, 4, 4) with white noise of these standard deviations along and about each axis."""
    noise = make_pose(rotation_exp(rotation_rad * rng.normal(size=(len(X), 3))), np.zeros((len(X), 3)))
    noisy = np.asarray(X @ noise)
    noisy[:, :3, 3] += np.asarray(position_m) * rng.normal(size=(len(X), 3))
    return noisy


def gripper(t_s: Array, X_BG: Array) -> GripperTrack:
    """Track of poses (T, 4, 4), tracked where they are finite."""
    n = len(t_s)
    return GripperTrack(
        t_s=t_s,
        X_CH=X_BG,
        X_BG=X_BG,
        tracked=np.isfinite(X_BG[:, 0, 0]),
        confidence=np.ones(n),
        finger_width_m=np.full(n, 0.04),
    )
