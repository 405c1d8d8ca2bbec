"""Films as their frames, and short ones."""

from pathlib import Path

import av
import numpy as np
import pytest

from kinebench_drake.suites.closed_loop import loop
from kinebench_drake.suites.runs import episodes


def shorten_clips(patch: pytest.MonkeyPatch) -> None:
    """Let clips of the closed loop have 13 frames: pictures take long without a GPU."""
    for module in (loop, episodes):
        patch.setattr(module, "FRAMES", 13)


def decoded(path: Path) -> tuple[list[float], np.ndarray]:
    """Times [s] and pictures (T, H, W, 3) of a film."""
    with av.open(path) as file:
        frames = list(file.decode(video=0))
    return [float(frame.time) for frame in frames], np.stack([frame.to_ndarray(format="rgb24") for frame in frames])
