"""A gripper that is gone although it was inside the picture just before."""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.anomaly.detection import Detection, detection_segments, is_known, sustained
from kinebench_drake.types import Anomaly, AnomalyKind

MIN_FRAMES = 3
"""Frames without a gripper that count as vanishing; fewer may be a passing occlusion."""
ABSENT_CONFIDENCE = 0.01
"""Below this confidence no gripper was found ..."""
ABSENT_CELLS = 50.0
"""... nor where fewer cells than this are explained by it: a gripper of which a third is seen explains a hundred."""
_BORDER_PX = 8.0


def find_vanishing(
    p_C: Array, confidence: Array, explained: Array, sure: NDArray[np.bool_], camera: Camera
) -> Detection:
    """Frames without a gripper where its motion had not taken it out of the picture.

    Absence is c0 / (c0 + confidence), one half at the threshold c0, or the same of the cells explained, whichever is
    larger; the score is twice the absence that `MIN_FRAMES` frames in a row reach.

    Args:
        p_C: (T, 3) centre of the gripper in the camera frame [m]; NaN where unknown.
        confidence: (T,) 0..1, 0 where nothing was found.
        explained: (T,) cells of the close view that the posed gripper explains, 0 likewise.
        sure: (T,) frames whose position counts.
        camera: for what lies inside the picture.
    """
    absence = np.maximum(
        ABSENT_CONFIDENCE / (ABSENT_CONFIDENCE + confidence), ABSENT_CELLS / (ABSENT_CELLS + explained)
    )
    score = 2.0 * sustained(absence * _expected(p_C, sure & is_known(p_C), camera), MIN_FRAMES)
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.VANISH, frame_start=start, frame_end=end, severity=float(end - start + 1))
        for start, end in detection_segments(score > 1.0)
    )
    return Detection(kind=AnomalyKind.VANISH, score=score, anomalies=anomalies)


def _expected(p_C: Array, sure: NDArray[np.bool_], camera: Camera) -> Array:
    """(T,) 1 where the gripper, going on as it last went, would be inside the picture; 0 before it is first seen."""
    expected = np.zeros(len(p_C))
    last = None
    for i in range(len(p_C)):
        if sure[i]:
            last, expected[i] = i, 1.0
            continue
        if last is None:
            continue
        ahead = p_C[last] + (p_C[last] - p_C[last - 1] if last > 0 and sure[last - 1] else 0.0)
        pixel = camera.project(ahead)
        size = np.array([camera.width, camera.height])
        expected[i] = float(ahead[2] > 0 and (pixel > _BORDER_PX).all() and (pixel < size - _BORDER_PX).all())
    return expected
