"""Control and time of the benchmark: control steps, frames, clips, and clips of other lengths brought to it."""

import math
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array

CONTROL_PERIOD_S = 0.05
"""Time between two control steps (ManiSkill's 20 Hz)."""
STEPS_PER_FRAME = 4
"""Control steps between two frames."""
FRAME_PERIOD_S = STEPS_PER_FRAME * CONTROL_PERIOD_S
"""Task time between two frames."""
MIN_FRAME_PERIOD_S = 0.01
MAX_FRAME_PERIOD_S = 2.0
"""Range of the task time between two frames of an executed video."""
CLIP_FRAMES = 48
"""Frames of a clip after its first one, which is the last of the clip before."""
CLIP_S = CLIP_FRAMES * FRAME_PERIOD_S
"""Task time of a clip."""


class ClipTiming(Enum):
    """How the frames of a video lie in task time."""

    UNIFORM = "uniform"
    """Evenly over a known duration, whatever their number."""
    NATIVE = "native"
    """One frame period apart."""


class Control(Enum):
    """Command of the robot at each control step."""

    JOINTS = "pd_joint_pos"
    """Joint angles."""
    POSE = "pd_ee_pose"
    """Pose of the TCP; ManiSkill's inverse kinematics takes one step towards it from the current posture."""


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
