"""Videos decoded once: frames at the network's size, mapped into memory."""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import UsageError
from kinebench_drake.grounding.baseline.demonstration import Demonstration
from kinebench_drake.grounding.video import read_video
from kinebench_drake.grounding.view import Frames
from kinebench_drake.storage import whole

_REPORT_EVERY = 100


def resized(frames: Frames, size: int) -> NDArray[np.uint8]:
    """Frames (T, size, size, 3) of any (T, H, W, 3), each pixel the mean of what it covers."""
    if frames.shape[1:3] == (size, size):
        return frames
    smaller = frames.shape[1] >= size and frames.shape[2] >= size
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.stack([np.asarray(cv2.resize(f, (size, size), interpolation=how), dtype=np.uint8) for f in frames])


def decode(
    clips: Sequence[Demonstration], folder: Path, size: int, report: Callable[[str], None]
) -> list[NDArray[np.uint8]]:
    """Frames (T, size, size, 3) of each clip, mapped from `folder`; what is missing there is decoded first.

    A video newer than its frames is decoded again.

    Raises:
        UsageError: a video has another number of frames than its truth.
        InputError: a video cannot be read.
        SetupError: writing failed.
    """
    arrays = []
    for number, clip in enumerate(clips, 1):
        path = folder / f"{clip.id}_{size}.npy"
        if not path.is_file() or path.stat().st_mtime < clip.path.stat().st_mtime:
            frames = read_video(clip.path).frames
            if len(frames) != len(clip.t_s):
                raise UsageError(f"{clip.path.name}: has {len(frames)} frames, its truth has {len(clip.t_s)}")
            with whole(path) as part:
                np.save(part, resized(frames, size))
            if number % _REPORT_EVERY == 0:
                report(f"decoded {number} of {len(clips)} videos")
        arrays.append(np.load(path, mmap_mode="r"))
    return arrays
