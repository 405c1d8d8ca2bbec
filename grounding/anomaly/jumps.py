"""Jumps of a path that noise and motion do not explain."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.anomaly.detection import Detection, detection_segments, is_known
from kinebench_drake.types import Anomaly, AnomalyKind

TELEPORT_M = 0.04
"""A jump is longer than this [m] ..."""
CONTRAST = 4.0
"""... and than so many times what the path around it is uneven by."""
_STEPS = 3  # steps to each side that tell how fast the gripper moves
_AROUND = 8  # frames to each side that tell how uneven the path is
_MAX_GAP = 2  # frames that may be missing at a jump


def jump_lengths(p: ArrayLike, sure: NDArray[np.bool_]) -> Array:
    """(T,) how far the path jumps just before each frame [m].

    The way from each of the two frames before to each of the two from it on, less what the median velocity of three
    steps to each side accounts for: the least of the four lengths, so that no single wild frame makes a jump; and no
    more than what the mean velocity of the steps just before and after leaves of the way, for a short burst of speed
    gathers pace and loses it. A way over a missing frame counts half. 0 where there are less than two frames on a side.

    Args:
        p: (T, n) positions.
        sure: (T,) frames whose position counts.
    """
    p = np.asarray(p, dtype=np.float64)
    index = np.flatnonzero(sure & np.isfinite(p).all(axis=1))
    lengths = np.zeros(len(p))
    if len(index) < 4:
        return lengths
    q, gaps = p[index], np.diff(index)
    velocity = np.diff(q, axis=0) / gaps[:, None]
    for k in range(2, len(index) - 1):
        if gaps[k - 1] > _MAX_GAP:
            continue
        steps = [j for j in range(k - 1 - _STEPS, k + _STEPS) if 0 <= j < len(gaps) and j != k - 1]
        usual = np.median(velocity[steps], axis=0)
        ways = [q[b] - q[a] - usual * (index[b] - index[a]) for a in (k - 2, k - 1) for b in (k, k + 1)]
        ways.append(q[k] - q[k - 1] - 0.5 * (velocity[k - 2] + velocity[k]) * gaps[k - 1])
        lengths[index[k]] = min(float(np.linalg.norm(way)) for way in ways) / gaps[k - 1]
    return lengths


def find_teleports(p: ArrayLike, fair: NDArray[np.bool_], good: NDArray[np.bool_]) -> Detection:
    """Jumps of the gripper: the first frame after one is both start and end, its length [m] the severity.

    The score is the length over the larger of `TELEPORT_M` and `CONTRAST` times the median length around it. A jump
    to or from a frame that may well be wrong is none.

    Args:
        p: (T, 3) position of the gripper [m].
        fair: (T,) frames whose position counts.
        good: (T,) those of them that a jump may lead from or to.
    """
    lengths = jump_lengths(p, fair)
    known = np.flatnonzero(fair & np.isfinite(np.asarray(p, dtype=np.float64)).all(axis=1))
    doubtful = ~(good[known[1:]] & good[known[:-1]])
    lengths[known[1:][doubtful]] = 0.0
    score = np.zeros(len(lengths))
    for i in np.flatnonzero(lengths).tolist():
        around = [k for k in range(max(0, i - _AROUND), min(len(lengths), i + _AROUND + 1)) if abs(k - i) > 2]
        usual = [lengths[k] for k in around if lengths[k] > 0]
        score[i] = lengths[i] / max(TELEPORT_M, CONTRAST * float(np.median(usual)) if usual else 0.0)
    score = _peaks(score, lengths)
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.TELEPORT, frame_start=int(i), frame_end=int(i), severity=float(lengths[i]))
        for i in np.flatnonzero(score >= 1.0)
    )
    return Detection(kind=AnomalyKind.TELEPORT, score=score, anomalies=anomalies)


def _peaks(score: Array, lengths: Array) -> Array:
    """The scores of the longest jumps; those beside a longer one are its shadow, and 0."""
    kept = np.zeros(len(score))
    for i in np.argsort(-lengths, kind="stable"):
        if not kept[max(0, i - 2) : i + 3].any():
            kept[i] = score[i]
    return kept


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


def find_finger_faults(width_m: ArrayLike, t_s: ArrayLike) -> Detection:
    """Gaps that jump, flutter or are wider than the gripper opens; severity: by how much too far [m].

    Args:
        width_m: (T,) gap between the pads [m]; NaN where unknown.
        t_s: (T,) task time [s].
    """
    width_m, t_s = np.asarray(width_m, dtype=np.float64), np.asarray(t_s, dtype=np.float64)
    index = np.flatnonzero(is_known(width_m))
    width, times = width_m[index], t_s[index]
    outside = np.maximum(np.maximum(-width, width - MAX_WIDTH_M), 0.0)
    size, score = np.zeros(len(width_m)), np.zeros(len(width_m))
    if len(index) >= 4:
        change, swing = impossible_change(width, times), flutter(width)
        size[index] = np.maximum(np.maximum(change, outside), swing)
        score[index] = np.maximum(np.maximum(change, outside) / EXCESS_M, swing / FLUTTER_M)
    anomalies = tuple(
        Anomaly(kind=AnomalyKind.FINGERS, frame_start=a, frame_end=b, severity=float(size[a : b + 1].max()))
        for a, b in detection_segments(score >= 1.0)
    )
    return Detection(kind=AnomalyKind.FINGERS, score=score, anomalies=anomalies)
