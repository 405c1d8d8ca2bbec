"""Times of the frames of a trajectory: checks, even times in place of rounded or jittering stamps, lost samples.

Samples that a recording lost are steps twice as long as their neighbours, where the path is smooth at twice the time. A
step that breaks a limit of the robot changes the direction or the speed of the motion; a lost sample changes neither.
Around each step a cubic polynomial is fitted to six samples, with the times as they are and with one more period in the
step.
"""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.formats.samples import MAX_PERIOD_S, MIN_PERIOD_S
from kinebench_drake.formats.trajectories.trajectory import (
    SLOW_STEP_S,
    first_index,
    others_text,
    require_numbers,
)
from kinebench_drake.geometry import Array

JITTER_STEPS = 0.4
"""Greatest deviation that is taken for jitter: where a frame is missing it is half a step [steps]."""
JITTER_S = 0.01
"""The same in seconds: operating systems delay by milliseconds."""


def check_times(array: NDArray[np.generic] | None, n: int, rate_hz: float | None, warnings: list[str]) -> Array:
    """Check the times (T,) of `n` frames [s], or make them from `rate_hz` [Hz]; free even ones of rounding.

    Raises:
        InputError: there are none, or they are not finite, do not increase or are too close or too far apart.
    """
    if rate_hz is not None:
        return np.arange(n, dtype=np.float64) / rate_hz
    if array is None:
        raise InputError("holds no times t_s; add them, or give $rate_hz HZ")
    t_s = require_numbers("t_s", array)
    if t_s.shape != (n,):
        raise InputError(f"t_s has shape {t_s.shape}, but there are {n} frames")
    if (k := first_index(~np.isfinite(t_s))) is not None:
        raise InputError(f"the time of frame {k} is {t_s[k]}, expected finite seconds")
    with np.errstate(over="ignore"):
        steps = np.diff(t_s)
    for bad, relation in ((steps < 0.0, "is before"), (steps == 0.0, "is the same as")):
        if (k := first_index(bad)) is not None:
            raise InputError(
                f"the time of frame {k + 1} ({t_s[k + 1]:.6g} s) {relation} that of frame {k} ({t_s[k]:.6g} s)"
                f"{others_text(bad)}: times must increase; sort the frames, or give $rate_hz HZ"
            )
    bad = (steps < MIN_PERIOD_S * (1.0 - 1e-6)) | (steps > MAX_PERIOD_S)
    if (k := first_index(bad)) is not None:
        raise InputError(
            f"frames {k} and {k + 1} are {steps[k]:.3g} s apart, expected {MIN_PERIOD_S:g} to {MAX_PERIOD_S:g} s"
            f"{others_text(bad)}: are the times in seconds? $rate_hz HZ overrides them"
        )
    if len(steps) and np.median(steps) > SLOW_STEP_S:
        warnings.append(
            f"frames are {np.median(steps):.4g} s apart (median): are the times in milliseconds? They are interpreted "
            "as seconds; $rate_hz HZ overrides them"
        )
    if abs(t_s[0]) > 1e6:  # later times, such as seconds since 1970, would lose precision
        warnings.append(f"times begin at {t_s[0]:.0f} s; they were shifted to begin at 0")
        t_s = t_s - t_s[0]
    return _undo_rounding(t_s)


def _undo_rounding(t_s: Array) -> Array:
    """Return uniform times if single precision or decimals rounded them: the steps would look like changes of speed.

    A unit of more than a quarter of a step could hide a frame that is missing.
    """
    even = np.linspace(t_s[0], t_s[-1], len(t_s))
    units = [10.0**-d for d in range(3, 7) if np.abs(t_s - t_s.round(d)).max() < 0.05 * 10.0**-d]
    if (t_s == t_s.astype(np.float32)).all():
        units.append(float(np.spacing(np.float32(np.abs(t_s).max()))))
    step = (t_s[-1] - t_s[0]) / max(len(t_s) - 1, 1)
    rounding = max((unit for unit in units if unit <= 0.25 * step), default=0.0)
    return even if 1e-9 * step < np.abs(t_s - even).max() <= rounding else t_s


def undo_jitter(t_s: Array, path: Array, warnings: list[str]) -> Array:
    """Return uniform times if the motion is smoother over them than over jittering time stamps of an even recording.

    Each sample of the path is predicted from two before and two after it by a cubic polynomial. Where the samples were
    taken at the times stated, even times make the errors larger; where a recorder stamped even samples too early or
    too late, the stamps do.

    Args:
        t_s: (T,) times, increasing [s].
        path: (T, N) positions [m] or joint angles [rad]; NaN where unknown.
        warnings: is extended.
    """
    frames = np.arange(len(t_s), dtype=np.float64)
    if len(t_s) < 20:  # least number of frames for a comparison of errors
        return t_s
    step, start = np.polyfit(frames, t_s, 1)
    even = start + step * frames
    deviation = float(np.abs(t_s - even).max())
    if (
        not 1e-6 * step < deviation <= min(JITTER_STEPS * step, JITTER_S)
    ):  # deviation from even times that counts as none [steps]
        return t_s
    rough = prediction_error(t_s, path)
    smooth = prediction_error(even, path)
    if not smooth < 0.8 * rough:  # ratio of errors from which the motion counts as smoother; noise alone gives 1
        return t_s
    warnings.append(
        f"times deviate from even ones by up to {1000.0 * deviation:.2g} ms, and the motion is smoother over even "
        f"ones: {step:.6g} s between frames is used"
    )
    return np.asarray(even - even[0] + t_s[0])


def prediction_error(t_s: Array, path: Array) -> float:
    """Return the median distance of `path` (T, N) from cubics through two samples before and two after each at `t_s`.

    NaN if no five consecutive samples are known.
    """
    near = np.stack([np.arange(k, len(t_s) - 4 + k) for k in (0, 1, 3, 4)], axis=1)
    times = t_s[near]
    middle = t_s[2:-2]
    predicted = np.zeros((len(near), path.shape[1]))
    for k in range(4):
        others = [i for i in range(4) if i != k]
        weight = np.prod((middle[:, None] - times[:, others]) / (times[:, [k]] - times[:, others]), axis=1)
        predicted += weight[:, None] * path[near[:, k]]
    errors = np.linalg.norm(path[2:-2] - predicted, axis=1)
    errors = errors[np.isfinite(errors)]
    return float(np.median(errors)) if len(errors) else float("nan")


DOUBLED = (1.4, 2.8)
"""Range of the ratio of the step to the mean of its neighbours: accelerations change it."""
LONGEST_PERIOD_S = 0.1
"""Longest period at which lost samples are looked for: between slower ones robots start and stop [s]."""
LACKING = 0.4
"""Greatest ratio of the residuals with and without the additional period."""
UNUSUAL = 5.0
"""Least ratio of the residual as the times are to the median residual."""

_LEVER_M = 0.2  # at which a rotation counts as a motion
# samples and degree of a fit
_SIZE = 6
_DEGREE = 3
_NEAR = 0.25  # deviation of a stamped step from one or two periods [periods]


def fill_gaps(t_s: Array, X_BG: Array | None, q: Array | None) -> tuple[Array, tuple[int, ...]]:
    """Return times (T,) [s] in which steps over a lost sample last two periods, and the frames after such samples.

    Args:
        t_s: (T,) times, increasing [s].
        X_BG: (T, 4, 4) poses [m], or
        q: (T, N) joint angles [rad].
    """
    if len(t_s) < 2 * _SIZE:
        return t_s, ()
    steps = np.diff(t_s)
    period = float(np.median(np.diff(t_s)))
    if (np.abs(steps / period - 1.0) < _NEAR).mean() < 0.8:  # least share of the steps that are one period
        return t_s, ()
    stamped = np.flatnonzero(np.abs(steps / period - 2.0) < _NEAR)
    path = _point_paths(X_BG) if q is None else q
    if period > LONGEST_PERIOD_S or not np.isfinite(path).all():
        return t_s, tuple((stamped + 1).tolist())
    t_s = t_s.copy()
    lost = set(stamped.tolist())
    for _ in range(10):  # lost samples that lie close together are found one after the other
        fresh = _find_lost(t_s, path, period)
        if not fresh:
            break
        for step in fresh:
            t_s[step + 1 :] += period
        lost.update(fresh)
    return t_s, tuple(sorted(step + 1 for step in lost))


def _point_paths(X_BG: Array | None) -> Array:
    """Return the path (T, 9) [m] of three points that move with the poses (T, 4, 4)."""
    X = np.empty((0, 4, 4)) if X_BG is None else X_BG
    p = X[:, :3, 3]
    return np.concatenate([p, p + _LEVER_M * X[:, :3, 0], p + _LEVER_M * X[:, :3, 1]], axis=1)


def _find_lost(t_s: Array, path: Array, period: float) -> list[int]:
    """Return the steps that lack a sample, of close ones the clearest."""
    n = len(t_s)
    step = np.arange(1, len(t_s) - 2)
    around = np.clip(step - 2, 0, n - _SIZE)[:, None] + np.arange(_SIZE)
    times = t_s[around]
    points = path[around]
    as_is, filled = (_residuals(t, points) for t in (times, times + period * (around > step[:, None])))
    speed = np.linalg.norm(np.diff(path, axis=0), axis=-1) / np.diff(t_s)
    ratio = 2.0 * speed[step] / np.maximum(speed[step - 1] + speed[step + 1], 1e-12)
    lacks = (filled < LACKING * as_is) & (
        as_is > UNUSUAL * max(float(np.median(as_is)), 1e-5)
    )  # least residual [m or rad]
    lacks &= (ratio > DOUBLED[0]) & (ratio < DOUBLED[1]) & (np.diff(t_s)[step] < (1.0 + _NEAR) * period)
    clear = np.where(lacks, as_is, 0.0)
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(clear, 3), 7).max(axis=-1)
    return [int(k) for k in step[lacks & (clear >= nearby)]]


def _residuals(times: Array, points: Array) -> Array:
    """Return the residuals (N,) of cubics through points (N, n, axes) at times (N, n)."""
    x = times - times.mean(axis=-1, keepdims=True)
    x /= np.abs(x).max(axis=-1, keepdims=True)
    Q = np.linalg.qr(x[:, :, None] ** np.arange(_DEGREE + 1))[0]
    return np.asarray(np.linalg.norm(points - Q @ (np.swapaxes(Q, -1, -2) @ points), axis=(-2, -1)))
