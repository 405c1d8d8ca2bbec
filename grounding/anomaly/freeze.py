"""A picture that stands still while the gripper moves."""

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.anomaly.detection import Detection, detection_segments
from kinebench_drake.grounding.view import Frames
from kinebench_drake.types import Anomaly, AnomalyKind

MIN_FRAMES = 5
"""Still frames that count as frozen ..."""
SPEED_M_S = 0.035
"""... after moving at this speed [m/s] ..."""
JUMP = 2.0
"""... and before a step so many times as long as those before the freeze and after that step."""
STILL_LEVELS = 4.0
"""A picture is still when all but 0.5 % of its pixels, blurred a little, change by less than this, of 255."""
_STILL_M = 0.004  # a track of a still picture moves less than this a frame: codec and network noise


def still_frames(frames: Frames) -> NDArray[np.bool_]:
    """(T,) whether each frame shows the same picture as the one before; the first never does."""
    small = [cv2.GaussianBlur(cv2.cvtColor(f, cv2.COLOR_RGB2GRAY), (0, 0), 1.5).astype(np.float32) for f in frames]
    change = [np.percentile(np.abs(b - a), 99.5) for a, b in pairwise(small)]
    return np.array([False, *(c < STILL_LEVELS for c in change)])


def find_freezes(p: ArrayLike, sure: NDArray[np.bool_], still: NDArray[np.bool_], t_s: Array) -> Detection:
    """Runs of the same picture that begin in motion and end with a jump; a dwell slows down before, and is none.

    A run's score is the least of its length over `MIN_FRAMES`, of the speed before over `SPEED_M_S`, and of the last
    step over `JUMP` times its neighbours'.

    Args:
        p: (T, 3) position of the gripper [m].
        sure: (T,) frames whose position counts.
        still: (T,) frames that repeat the one before (`still_frames`).
        t_s: (T,) task time [s].
    """
    p = np.asarray(p, dtype=np.float64)
    step = np.concatenate([[np.nan], np.linalg.norm(np.diff(p, axis=0), axis=1)])
    quiet = still & ~(step > _STILL_M)
    score = np.zeros(len(p))
    anomalies = []
    for start, end in detection_segments(quiet):
        if start < 2 or end + 1 >= len(p) or not sure[[start - 2, start - 1, end, end + 1]].all():
            continue
        before, jump = step[start - 1], step[end + 1]
        after = step[end + 2] if end + 2 < len(p) and sure[end + 2] else before
        speed = before / (t_s[start - 1] - t_s[start - 2])
        frames = end - start + 1
        score[start : end + 1] = min(
            frames / MIN_FRAMES, speed / SPEED_M_S, jump / (JUMP * max(before, after, _STILL_M))
        )
        if score[start] >= 1.0:
            anomalies.append(Anomaly(kind=AnomalyKind.FREEZE, frame_start=start, frame_end=end, severity=float(frames)))
    return Detection(kind=AnomalyKind.FREEZE, score=score, anomalies=tuple(anomalies))
