"""Task times of the frames of a video whose number of frames says nothing about its duration."""

import math
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array


class ClipTiming(Enum):
    """How the frames of a video lie in task time."""

    UNIFORM = "uniform"
    """Evenly over a known duration, whatever their number."""
    NATIVE = "native"
    """One frame period apart."""


def sample_uniformly(frames: int, duration_s: float, period_s: float) -> tuple[NDArray[np.intp], Array]:
    """Choose frames of a video that lies evenly in a duration, about one frame period apart.

    Each chosen frame keeps its own time, which may differ from a multiple of the period by half a frame of the video: a
    time rounded to the period would add noise to the motion. A video with fewer frames keeps all.

    Args:
        frames: number of frames of the video, 2 or more.
        duration_s: task time from the first to the last one [s].
        period_s: frame period [s].

    Returns:
        Indices (T,) of the frames, and their task times (T,) [s].
    """
    count = max(round(duration_s / period_s), 1) + 1
    if frames == count and math.isclose(duration_s, (count - 1) * period_s):
        return np.arange(frames), np.arange(frames, dtype=np.float64) * period_s
    chosen = np.rint(np.linspace(0, frames - 1, min(count, frames))).astype(np.intp)
    return chosen, chosen.astype(np.float64) * (duration_s / (frames - 1))
