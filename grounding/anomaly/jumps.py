"""Detectors of implausible motion: teleports, frozen images, impossible finger motion."""

from collections.abc import Callable
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.anomaly.detection import Detection
from kinebench_drake.io.frames import Frames
from kinebench_drake.segments import UNEVEN, finite_rows, frame_periods, segments
from kinebench_drake.track import MAX_WIDTH_M

# Set on planted faults in home renders of seen assets, and checked on clean ones:
# `python -m benchmarks planted-videos --out faulty`, then `python -m benchmarks evaluate faulty`. Teleports: set on
# half of the clips of `python -m benchmarks painted make --splice --count 40` (a command until revision afe939a2), with
# those without --splice; checked on the others, and on clean ones of other simulators.
_TELEPORT_M = 0.03
"""Least length of a teleport [m].

Within 0.2 s the arm could move farther, but experts of the suites stay within 0.015 m of the motion around."""
_TELEPORT_PERIOD_S = 0.2
"""Frame period up to which this length holds: in longer steps motions bend more [s]."""
_TELEPORT_CONTRAST = 2.5
"""Least ratio of this length to the median jump length of the path around it."""
_TELEPORT_SIGMAS = 8.0
"""Standard deviations of a displacement that explain it: errors in depth have heavy tails."""
_FADED = 0.7
"""Factor of the least length of a jump through a cross-fade, which spreads it over several steps."""
_MIX_PX = 384
"""Width of the images in which mixtures are looked for."""
_MIX_LEVELS = 50.0
"""Change of a pixel's colour that counts as one [grey levels of 255]."""
_MIX_CHANGED = 0.005
"""Least share of changed pixels of an image that may be a mixture."""
_MIX_RADIUS = 0.3
"""Largest distance of a mixed pixel's colour from the mean of those before and after, over their distance.

Either of the two is at 0.5."""
_MIX_SHARE = 0.4
"""Least share of mixed pixels among the changed ones of a mixture; of a motion by 15 mm a frame or more, up to 0.38."""
_FREEZE_FRAMES = 5
"""Fewest still frames of a freeze."""
_FREEZE_SPEED_M_S = 0.035
"""Least speed of the gripper before a freeze [m/s]."""
_FREEZE_JUMP = 2.0
"""Least length of the step that ends a freeze, over the longer of the steps before the freeze and after that step."""
_STILL_LEVELS = 4.0
"""Change of a slightly blurred pixel below which it is still [grey levels of 255].

A frame is still if 99.5 % of its pixels are."""
_STILL_M = 0.004
"""Greatest motion of the track between still frames, due to noise of codec and network [m]."""
_WIDTH_FAULT_M = 0.015
"""Least excess of a width over the largest, or amplitude of alternate opening and closing over four frames [m]."""
_STEPS = 3
"""Steps to each side whose median is the velocity at a jump."""
_AROUND = 8
"""Frames to each side whose median is the usual jump length."""
_SIDE = 3
"""Fewest frames on each side of a jump."""
_MAX_GAP = 4
"""Longest step over a jump, with frames missing [frame periods]."""
_MAX_SIDE_GAP = 2
"""Longest step beside a jump [frame periods]: a pose alone beside doubtful ones is no side."""
_FLUTTER_FRAMES = 4


def jump_lengths(p: Array, covariance: Array, good: NDArray[np.bool_], t_s: Array) -> tuple[Array, Array]:
    """Return the length (T,) of the path's jump just before each frame, and what of it is unexplained (T,) [m].

    The displacement from each of the two frames before to each of the two from it on, less what the median velocity of
    three steps to each side explains: that of least unexplained length of the four, so that no single outlier makes a
    jump; or the displacement less that by the mean velocity of the steps just before and after, since a short burst of
    speed accelerates and decelerates. `_TELEPORT_SIGMAS` standard deviations of both positions along the displacement
    explain a part, in quadrature. The rest is divided by the root of the step in frame periods: over missing frames the
    motion is less certain.

    0 where a side has less than three frames, or gaps. Positions `p` (T, 3) [m], of covariances (T, 3, 3) [m^2], count
    in `good` (T,) frames.
    """
    index = np.flatnonzero(good & finite_rows(p))
    lengths = np.zeros(len(p))
    unexplained = np.zeros(len(p))
    place = frame_periods(t_s)[index]
    q = p[index]
    gaps = np.diff(place)
    velocity = np.diff(q, axis=0) / gaps[:, None]
    for k in range(_SIDE, len(index) - _SIDE + 1):
        if gaps[k - 1] > _MAX_GAP + UNEVEN or max(gaps[k - 2], gaps[k]) > _MAX_SIDE_GAP + UNEVEN:
            continue
        steps = [j for j in range(k - 1 - _STEPS, k + _STEPS) if 0 <= j < len(gaps) and j != k - 1]
        usual = np.median(velocity[steps], axis=0)
        pairs = [(a, b) for a in (k - 2, k - 1) for b in (k, k + 1)]
        moves = [q[b] - q[a] - usual * (place[b] - place[a]) for a, b in pairs]
        pairs.append((k - 1, k))
        moves.append(q[k] - q[k - 1] - 0.5 * (velocity[k - 2] + velocity[k]) * gaps[k - 1])
        squares = [float(move @ move) for move in moves]
        error = covariance[index[pairs]].sum(axis=1)
        variances = np.einsum("ni,nij,nj->n", moves, error, moves) / np.maximum(squares, 1e-12)
        rest = np.maximum(squares - _TELEPORT_SIGMAS**2 * variances, 0.0) / gaps[k - 1]
        least = int(np.argmin(rest))
        lengths[index[k]] = squares[least] ** 0.5
        unexplained[index[k]] = rest[least] ** 0.5
    return lengths, unexplained


def find_teleports(
    p: Array, covariance: Array, good: NDArray[np.bool_], mixed: Callable[[int], bool], t_s: Array
) -> Detection:
    """Detect jumps of the gripper; start and end: the first frame after the jump; severity: its length [m].

    The score is the unexplained length over the larger of its least one, which grows with the frame period, and
    `_TELEPORT_CONTRAST` times the median length around it; if the frame or the one before is `mixed`, by its number,
    less suffices. Positions `p` (T, 3) [m], of covariances (T, 3, 3) [m^2], count in `good` (T,) frames.
    """
    lengths, unexplained = jump_lengths(p, covariance, good, t_s)
    period_s = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    floor_m = _TELEPORT_M * max(1.0, period_s / _TELEPORT_PERIOD_S)
    score = np.zeros(len(lengths))
    for i in np.flatnonzero(unexplained).tolist():
        around = [k for k in range(max(0, i - _AROUND), min(len(lengths), i + _AROUND + 1)) if abs(k - i) > 2]
        usual = [lengths[k] for k in around if lengths[k] > 0]
        least = max(floor_m, _TELEPORT_CONTRAST * float(np.median(usual)) if usual else 0.0)
        score[i] = unexplained[i] / (_FADED * least if mixed(i - 1) or mixed(i) else least)
    return Detection.from_score(AnomalyKind.TELEPORT, _suppress_non_maxima(score, lengths), lengths)


def _suppress_non_maxima(score: Array, lengths: Array) -> Array:
    """Return the scores of the longest jumps, 0 within two frames of a longer one."""
    kept = np.zeros(len(score))
    for i in np.argsort(-lengths, kind="stable"):
        if not kept[max(0, i - 2) : i + 3].any():
            kept[i] = score[i]
    return kept


def still_frames(frames: Frames) -> NDArray[np.bool_]:
    """Return the frames (T,) that show the same image as the one before; the first never does."""
    small = (cv2.GaussianBlur(cv2.cvtColor(f, cv2.COLOR_RGB2GRAY), (0, 0), 1.5).astype(np.float32) for f in frames)
    change = [np.percentile(np.abs(b - a), 99.5) for a, b in pairwise(small)]
    return np.array([False, *(c < _STILL_LEVELS for c in change)])


def is_mixed(frames: Frames, number: int) -> bool:
    """Return whether a frame mixes the images before and after, as those of a cross-fade do.

    Where something moves, a pixel shows it or what it hides, as before or as after: few lie between. Of those that
    differ before and after, many of a mixture do; so do many of a motion that is slower than its edges are wide.
    """
    if not 0 < number < len(frames) - 1:
        return False
    size = (_MIX_PX, round(_MIX_PX * frames.shape[1] / frames.shape[2]))
    near = frames[number - 1 : number + 2]
    small = [cv2.GaussianBlur(cv2.resize(f, size, interpolation=cv2.INTER_AREA), (0, 0), 1.0) for f in near]
    before, image, after = np.array(small, dtype=np.float32)
    change = np.linalg.norm(after - before, axis=-1)
    off = np.linalg.norm(image - 0.5 * (before + after), axis=-1)
    changed = change > _MIX_LEVELS
    is_enough = changed.mean() >= _MIX_CHANGED
    return bool(is_enough and (off < _MIX_RADIUS * change)[changed].mean() >= _MIX_SHARE)


def find_freezes(p: Array, fair: NDArray[np.bool_], still: NDArray[np.bool_], t_s: Array) -> Detection:
    """Detect runs of still frames that begin in motion and end with a jump; severity: their number of frames.

    A dwell slows down before and is no freeze. The score of a run is the least of its length, of the speed before, and
    of the last step over its neighbours', each over its bound. Positions `p` (T, 3) [m] count in `fair` (T,) frames;
    `still` (T,) ones repeat the one before.
    """
    step = np.concatenate([[np.nan], np.linalg.norm(np.diff(p, axis=0), axis=1)])
    score = np.zeros(len(p))
    size = np.zeros(len(p))
    for run in segments(still & ~(step > _STILL_M)):
        start = run.start
        end = run.stop - 1
        if start < 2 or end + 1 >= len(p) or not fair[[start - 2, start - 1, end, end + 1]].all():
            continue
        before = step[start - 1]
        after = step[end + 2] if end + 2 < len(p) and fair[end + 2] else before
        speed = before / (t_s[start - 1] - t_s[start - 2])
        size[run] = run.stop - start
        score[run] = min(
            size[start] / _FREEZE_FRAMES,
            speed / _FREEZE_SPEED_M_S,
            step[end + 1] / (_FREEZE_JUMP * max(before, after, _STILL_M)),
        )
    return Detection.from_score(AnomalyKind.FREEZE, score, size)


def flutter(width_m: Array) -> Array:
    """Return the amplitude (T,) of alternate opening and closing around each frame [m].

    A frame's deviation is its width minus the mean of its neighbours'; four deviations of alternating sign are a
    flutter of the least of their magnitudes. A single outlier makes no more than three.
    """
    deviation = np.zeros(len(width_m))
    deviation[1:-1] = width_m[1:-1] - 0.5 * (width_m[:-2] + width_m[2:])
    amplitude = np.zeros(len(width_m))
    for start in range(len(width_m) - _FLUTTER_FRAMES + 1):
        window = slice(start, start + _FLUTTER_FRAMES)
        if (deviation[window][1:] * deviation[window][:-1] < 0).all():
            amplitude[window] = np.maximum(amplitude[window], np.abs(deviation[window]).min())
    return amplitude


def find_finger_faults(width_m: Array) -> Detection:
    """Detect widths (T,) [m] that flutter or exceed the gripper's range; severity: the largest excess [m].

    A fast change is none: joint sensors of a real Franka Hand record 41 mm in 0.1 s.
    """
    index = np.flatnonzero(np.isfinite(width_m))
    width = width_m[index]
    outside = np.maximum(np.maximum(-width, width - MAX_WIDTH_M), 0.0)
    size = np.zeros(len(width_m))
    size[index] = np.maximum(outside, flutter(width))
    return Detection.from_score(AnomalyKind.FINGERS, size / _WIDTH_FAULT_M, size)
