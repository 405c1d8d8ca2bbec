"""Films as their frames."""

from pathlib import Path

import av
import numpy as np


def decoded(path: Path) -> tuple[list[float], np.ndarray]:
    """Times [s] and pictures (T, H, W, 3) of a film."""
    with av.open(path) as file:
        frames = list(file.decode(video=0))
    return [float(frame.time) for frame in frames], np.stack([frame.to_ndarray(format="rgb24") for frame in frames])
