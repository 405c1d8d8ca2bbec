"""Anomalies of a video: the gripper vanishes, jumps, or the picture freezes while it moves."""

from collections.abc import Iterator
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.view import Frames
from kinebench_drake.products import Anomaly, AnomalyKind

MIN_VANISH_FRAMES = 3
"""Frames without a gripper that count as vanishing; fewer may be a passing occlusion."""
TELEPORT_M = 0.06
"""A step this much longer or shorter than its neighbours [m] is a jump, if nothing around is as uneven."""
TELEPORT_CONTRAST = 4.0
"""... namely this many times the unevenness of the steps around it."""
MIN_FREEZE_FRAMES = 5
"""Still frames that count as frozen ..."""
FREEZE_SPEED_M_S = 0.05
"""... after moving at this speed [m/s] ..."""
FREEZE_JUMP = 2.0
"""... and before a step this many times as long as those before the freeze and after that step."""
_STILL_M = 0.004  # a track of a still picture moves less than this a frame: codec and network noise
_STILL_LEVELS = 4.0  # and its pixels change by less than this, 99.5th percentile of 255, after a slight blur
_SPEED_TOLERANCE = 0.7  # a measured speed may be this much too low
_BORDER_PX = 8.0


def _runs(flags: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    yield from ((int(a), int(b) - 1) for a, b in edges.reshape(-1, 2))


def find_vanishing(p_C: ArrayLike, seen: NDArray[np.bool_], camera: Camera) -> list[Anomaly]:
    """Runs of frames in which the gripper is not seen although it was inside the picture just before.

    Args:
        p_C: (T, 3) centre of the gripper in the camera frame [m]; NaN where unknown.
        seen: (T,) whether the gripper is in the frame.
        camera: for what lies inside the picture.
    """
    p_C = np.asarray(p_C, dtype=np.float64)
    found = []
    for start, end in _runs(~seen):
        if start == 0 or end - start + 1 < MIN_VANISH_FRAMES:
            continue
        expected = p_C[start - 1]
        if start >= 2 and seen[start - 2]:
            expected = expected + (p_C[start - 1] - p_C[start - 2])
        pixel = camera.project(expected)
        if (pixel > _BORDER_PX).all() and (pixel < np.array([camera.width, camera.height]) - _BORDER_PX).all():
            found.append(
                Anomaly(kind=AnomalyKind.VANISH, frame_start=start, frame_end=end, severity=float(end - start + 1))
            )
    return found


def find_teleports(p: ArrayLike, seen: NDArray[np.bool_]) -> list[Anomaly]:
    """Steps that stick out: the first frame after a jump is both start and end, severity the excess length [m].

    Args:
        p: (T, 3) position of the gripper [m].
        seen: (T,) frames whose position counts.
    """
    index = np.flatnonzero(seen)
    positions = np.asarray(p, dtype=np.float64)[index]
    if len(index) < 4:
        return []
    gaps = np.diff(index)
    steps = np.diff(positions, axis=0) / gaps[:, None]
    excess = np.empty(len(steps))
    for i in range(len(steps)):
        around = [steps[k] for k in (i - 1, i + 1) if 0 <= k < len(steps)]
        excess[i] = float(np.linalg.norm(steps[i] - np.mean(around, axis=0)))
    found: list[Anomaly] = []
    for i in np.argsort(-excess).tolist():
        if excess[i] < TELEPORT_M or gaps[i] > 2:
            break
        others = [k for k in range(max(0, i - 5), min(len(steps), i + 6)) if abs(k - i) > 1]
        usual = float(np.median(excess[others])) if others else 0.0
        beside = any(abs(i - (a.frame_start - 1)) <= 1 for a in found)
        if excess[i] > TELEPORT_CONTRAST * usual and not beside:
            frame = int(index[i + 1])
            found.append(
                Anomaly(kind=AnomalyKind.TELEPORT, frame_start=frame, frame_end=frame, severity=float(excess[i]))
            )
    return found


def still_frames(frames: Frames) -> NDArray[np.bool_]:
    """(T,) whether each frame shows the same picture as the one before; the first never does."""
    small = [cv2.GaussianBlur(cv2.cvtColor(f, cv2.COLOR_RGB2GRAY), (0, 0), 1.5).astype(np.float32) for f in frames]
    change = [np.percentile(np.abs(b - a), 99.5) for a, b in pairwise(small)]
    return np.array([False, *(c < _STILL_LEVELS for c in change)])


def find_freezes(p: ArrayLike, seen: NDArray[np.bool_], still: NDArray[np.bool_], t_s: Array) -> list[Anomaly]:
    """Runs of the same picture that begin in motion and end with a jump; a dwell slows down before and is none.

    Args:
        p: (T, 3) position of the gripper [m].
        seen: (T,) frames whose position counts.
        still: (T,) frames that repeat the one before (`still_frames`).
        t_s: (T,) task time [s].
    """
    p = np.asarray(p, dtype=np.float64)
    step = np.concatenate([[np.nan], np.linalg.norm(np.diff(p, axis=0), axis=1)])
    quiet = still & ~(step > _STILL_M)
    found = []
    for start, end in _runs(quiet):
        if end - start + 1 < MIN_FREEZE_FRAMES or start < 2 or end + 1 >= len(p):
            continue
        if not (seen[start - 2] and seen[start - 1] and seen[end] and seen[end + 1]):
            continue
        before, jump = step[start - 1], step[end + 1]
        after = step[end + 2] if end + 2 < len(p) and seen[end + 2] else before
        is_jump = jump >= FREEZE_JUMP * max(before, after)
        if before / (t_s[start - 1] - t_s[start - 2]) >= _SPEED_TOLERANCE * FREEZE_SPEED_M_S and is_jump:
            found.append(
                Anomaly(kind=AnomalyKind.FREEZE, frame_start=start, frame_end=end, severity=float(end - start + 1))
            )
    return found


def find_anomalies(
    *, frames: Frames, t_s: Array, p_C: Array, seen: NDArray[np.bool_], sure: NDArray[np.bool_], camera: Camera
) -> tuple[Anomaly, ...]:
    """All anomalies in the order of their frames; the jump that ends a freeze is part of it, no teleport.

    Args:
        frames: (T, H, W, 3) RGB.
        t_s: (T,) task time [s].
        p_C: (T, 3) centre of the gripper in the camera frame [m]; NaN where unknown.
        seen: (T,) whether the gripper is in the frame.
        sure: (T,) whether its position counts, too.
        camera: the camera.
    """
    freezes = find_freezes(p_C, sure, still_frames(frames), t_s)
    ends = {a.frame_end + 1 for a in freezes}
    teleports = [a for a in find_teleports(p_C, sure) if a.frame_start not in ends]
    found = [*find_vanishing(p_C, seen, camera), *teleports, *freezes]
    return tuple(sorted(found, key=lambda a: (a.frame_start, a.kind.value)))
