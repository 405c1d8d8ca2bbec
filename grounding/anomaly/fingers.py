"""Fingers that open and close as no Panda's can."""

import numpy as np
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.anomaly.finding import Finding
from kinebench_drake.grounding.anomaly.jumps import jump_lengths
from kinebench_drake.grounding.anomaly.series import known, runs
from kinebench_drake.products import Anomaly, AnomalyKind

SPEED_M_S = 0.1
"""Fastest change of the gap between the pads [m/s]: each finger travels at up to 50 mm/s (Franka Emika, "Panda
datasheet", Franka Hand: travel speed)."""
MAX_WIDTH_M = 0.08
"""Widest gap."""
EXCESS_M = 0.015
"""A change of so much more than is possible in a frame, or a gap so much wider than the widest, is an anomaly [m]."""
FLUTTER_M = 0.015
"""So is opening and closing by this much in turn, four frames on end [m]."""
_IN_TURN = 4


def impossible_change(width_m: Array, t_s: Array) -> Array:
    """(T,) by how much the gap jumps, just before each frame, beyond what fingers travel in that time [m]."""
    jumps = jump_lengths(width_m[:, None], np.ones(len(width_m), dtype=bool))
    return np.maximum(0.0, jumps - SPEED_M_S * np.diff(t_s, prepend=t_s[0]))


def flutter(width_m: Array) -> Array:
    """(T,) how far the gap goes to and fro around each frame, from one frame to the next [m].

    A frame's bump is its gap over the mean of its neighbours'; four bumps whose signs alternate are a flutter as large
    as the least of them. One wild frame makes no more than three.
    """
    bump = np.zeros(len(width_m))
    bump[1:-1] = width_m[1:-1] - 0.5 * (width_m[:-2] + width_m[2:])
    swing = np.zeros(len(width_m))
    for start in range(len(width_m) - _IN_TURN + 1):
        some = slice(start, start + _IN_TURN)
        if (bump[some][1:] * bump[some][:-1] < 0).all():
            swing[some] = np.maximum(swing[some], np.abs(bump[some]).min())
    return swing


def find_finger_faults(width_m: ArrayLike, t_s: ArrayLike) -> Finding:
    """Gaps that jump, flutter or are wider than the gripper opens; severity: by how much too far [m].

    Args:
        width_m: (T,) gap between the pads [m]; NaN where unknown.
        t_s: (T,) task time [s].
    """
    width_m, t_s = np.asarray(width_m, dtype=np.float64), np.asarray(t_s, dtype=np.float64)
    index = np.flatnonzero(known(width_m))
    width, times = width_m[index], t_s[index]
    outside = np.maximum(np.maximum(-width, width - MAX_WIDTH_M), 0.0)
    size, score = np.zeros(len(width_m)), np.zeros(len(width_m))
    if len(index) >= 4:
        change, swing = impossible_change(width, times), flutter(width)
        size[index] = np.maximum(np.maximum(change, outside), swing)
        score[index] = np.maximum(np.maximum(change, outside) / EXCESS_M, swing / FLUTTER_M)
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.FINGERS, frame_start=a, frame_end=b, severity=float(size[a : b + 1].max()))
        for a, b in runs(score >= 1.0)
    )
    return Finding(kind=AnomalyKind.FINGERS, score=score, anomalies=anomalies)
