"""A gripper that is too large or too small for its arm."""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.grounding.anomaly.finding import Finding
from kinebench_drake.grounding.anomaly.series import known_median, runs
from kinebench_drake.products import Anomaly, AnomalyKind

OFF = 0.035
"""Relative error of the size that counts."""
WINDOW = 13
"""Frames whose median counts."""


def find_scale_drift(scale: ArrayLike) -> Finding:
    """Frames in which the gripper has the wrong size; severity: by what part at most.

    Args:
        scale: (T,) apparent size of the hand over the size that it has where the arm puts it; NaN where unknown.
    """
    scale = np.asarray(scale, dtype=np.float64)
    steady = known_median(np.log(scale, where=scale > 0, out=np.full(len(scale), np.nan)), WINDOW)
    size = np.abs(np.nan_to_num(steady, nan=0.0))
    score = size / OFF
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.SCALE, frame_start=a, frame_end=b, severity=float(np.expm1(size[a : b + 1].max())))
        for a, b in runs(score >= 1.0)
    )
    return Finding(kind=AnomalyKind.SCALE, score=score, anomalies=anomalies)
