"""Jumps that no continuous motion explains: the gripper is here in one frame and elsewhere in the next.

At video rates a jump can lie within every speed limit (at 0.2 s a frame the Panda may move 34 cm in one), so this is a
statistical finding, not a physical one: one step that neither side of it announces. Each step is predicted from the two
steps before it and the two after, once as if the velocity there were constant and once as if it changed linearly; a
smooth motion lies between the two predictions or near. A step farther from both than the stated floor, than noise could
put it, than a share of the steps beside it and than is usual around it is a jump. Near the ends of a run of tracked
frames, where less than two steps announce it on either side, a quick start or stop looks the same, and more is asked.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from kinebench_drake.geometry import Array
from kinebench_drake.metrics.noise import (
    FREEDOM_PER_FRAME,
    JOINT_FREEDOM_PER_FRAME,
    TrackNoise,
    estimate_joint_noise,
    rotation_steps,
)
from kinebench_drake.segments import finite_rows, segments
from kinebench_drake.types import Violation, ViolationKind

JUMP_M = 0.06
"""Least jump of the TCP's position [m] ..."""
JUMP_RAD = 0.35
"""... of its orientation, or of a joint [rad], for steps of JUMP_PERIOD_S."""
JUMP_PERIOD_S = 0.2
"""Over longer steps the floors grow with the square of the time, as the effect of an acceleration does."""
ACCELERATION_M_S2, ACCELERATION_RAD_S2, JOINT_ACCELERATION_RAD_S2 = 13.0, 25.0, 20.0
"""Over shorter steps the floors are at most what these limits of the Panda allow: Cartesian, and of its quickest joint.

Source: libfranka, `rate_limiting.h` (limits of the Franka Emika Robot, also in its control interface's documentation).
"""
CONTRAST = 3.0
"""A jump deviates this many times as much as the median of the steps before it, or of those after it ..."""
SHARE = 0.6
"""... and by this share of the longer step beside it: what moves fast may turn fast."""
NEAR_END, AT_END = 2.0, 4.0
"""Factors of the floor where one side has only one step, and where it has none."""
FALSE_ALARM = 0.001
"""Chance, at most, that white noise alone makes a jump out of a still track, for each of position, rotation, joints."""

_AROUND = 5  # steps on either side that tell what is usual


@dataclass(frozen=True, slots=True, kw_only=True)
class _Jump:
    start: int
    end: int
    size: float
    threshold: float


def find_discontinuities(
    t_s: Array,
    X_BG: Array,
    tracked: NDArray[np.bool_],
    noise: TrackNoise,
    q: Array | None = None,
    joints: tuple[str, ...] = (),
) -> tuple[Violation, ...]:
    """Jumps of the TCP within runs of tracked frames, and of given joint angles.

    A violation's frames are the last good one before the jump and the first after it; a jump away and straight back is
    one violation. `value` is how far the step lies from its predictions and `limit` the threshold: in metres for a jump
    of the TCP's position, in radians for one of its orientation alone (`joint` is None for both) or of a joint.

    Args:
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in B [m].
        tracked: (T,) frames whose pose counts.
        noise: of the poses (`noise.track_noise`); where unknown (NaN), nothing is called a jump.
        q: (T, 7) joint angles [rad] if they were given, NaN where unknown; not those of inverse kinematics, whose jumps
            from one branch to another are the solver's.
        joints: names of the columns of `q`.
    """
    pieces = [run for run in segments(tracked) if run.stop - run.start > 2]
    found: list[Violation] = []
    moved: set[int] = set()
    for run in pieces:
        n = run.stop - run.start
        t, step = t_s[run], np.diff(X_BG[run, :3, 3], axis=0)
        noise_norm = _noise_norm(noise.position_m, 3, n, FREEDOM_PER_FRAME)
        for jump in _jumps(t, step, _floor(t, JUMP_M, ACCELERATION_M_S2), noise_norm):
            moved.update(range(run.start + jump.start, run.start + jump.end))
            found.append(_violation(jump, run, None))
    for run in pieces:
        n = run.stop - run.start
        t, step = t_s[run], rotation_steps(X_BG[run, :3, :3])
        noise_norm = _noise_norm(noise.rotation_rad, 3, n, FREEDOM_PER_FRAME)
        for jump in _jumps(t, step, _floor(t, JUMP_RAD, ACCELERATION_RAD_S2), noise_norm):
            if moved.isdisjoint(range(run.start + jump.start, run.start + jump.end)):
                found.append(_violation(jump, run, None))
    if q is not None:
        found += _joint_jumps(t_s, q, joints)
    return tuple(sorted(found, key=lambda v: (v.frame_start, v.frame_end, v.joint or "")))


def _joint_jumps(t_s: Array, q: Array, joints: tuple[str, ...]) -> list[Violation]:
    sigma = estimate_joint_noise(t_s, q)
    found = []
    for run in segments(finite_rows(q)):
        t, n = t_s[run], run.stop - run.start
        floor = _floor(t, JUMP_RAD, JOINT_ACCELERATION_RAD_S2)
        for j, name in enumerate(joints):
            step = np.diff(q[run, j : j + 1], axis=0)
            noise_norm = _noise_norm(sigma[j], 1, n, JOINT_FREEDOM_PER_FRAME, groups=q.shape[1])
            found += [_violation(jump, run, name) for jump in _jumps(t, step, floor, noise_norm)]
    return found


def _violation(jump: _Jump, run: slice, joint: str | None) -> Violation:
    return Violation(
        kind=ViolationKind.DISCONTINUITY,
        frame_start=run.start + jump.start,
        frame_end=run.start + jump.end,
        joint=joint,
        value=jump.size,
        limit=jump.threshold,
    )


def _floor(t_s: Array, floor: float, acceleration: float) -> Array:
    """Least jump (n - 1,) that counts, for steps between the times `t_s` (n,) [s]."""
    dt2 = np.diff(t_s) ** 2
    return np.minimum(floor * np.maximum(dt2 / JUMP_PERIOD_S**2, 1.0), acceleration * dt2)


def _noise_norm(sigma: float, axes: int, frames: int, freedom: float, groups: int = 1) -> float:
    """Deviation of a step that noise `sigma` an axis exceeds anywhere with probability FALSE_ALARM, at even times.

    A step less one beside it has sqrt(6) sigma an axis (less the mean of both sides: sqrt(5)); its squared norm over
    measured variance, a mean over axes, follows Fisher's distribution; `freedom` is the variance's, a frame.
    """
    chance = 1.0 - FALSE_ALARM / (frames * groups)
    return float(np.sqrt(6.0 * axes * fdtri(axes, max(freedom * frames, 1.0), chance)) * sigma)


def _jumps(t_s: Array, steps: Array, floor: Array, noise_norm: float) -> list[_Jump]:
    """Jumps among `steps` (n - 1, axes) between the times `t_s` (n,) [s], in order of frames."""
    dt = np.diff(t_s)
    velocity, middle = steps / dt[:, None], 0.5 * (t_s[:-1] + t_s[1:])
    sizes, thresholds = _excursions(middle, velocity, dt, floor, noise_norm)
    while True:
        known = sizes == 0.0
        speed, beside, factor = _deviation(middle, velocity, known)
        deviation = speed * dt
        threshold = np.maximum(np.maximum(factor * floor, SHARE * beside * dt), noise_norm)  # NaN: noise unknown
        called = np.flatnonzero(~known)  # the steps beside them are what they would be called by
        threshold[called[called > 0] - 1] = threshold[called[called < len(dt) - 1] + 1] = np.inf
        for i in np.argsort(-np.nan_to_num(deviation / threshold)).tolist():
            if not deviation[i] > threshold[i]:
                return _merged(velocity, dt, sizes, thresholds)
            if deviation[i] > CONTRAST * _usual(deviation, i):
                sizes[i], thresholds[i] = deviation[i], threshold[i]
                break
        else:
            return _merged(velocity, dt, sizes, thresholds)


def _usual(deviation: Array, i: int) -> float:
    """Median deviation of the steps before the i-th or after it, whichever is less: another jump may be near."""
    sides = (deviation[max(0, i - _AROUND) : i], deviation[i + 1 : i + 1 + _AROUND])
    return min((float(np.median(side)) for side in (s[np.isfinite(s)] for s in sides) if len(side)), default=0.0)


def _merged(velocity: Array, dt: Array, sizes: Array, thresholds: Array) -> list[_Jump]:
    """Neighbouring jumps as one. A single frame that is out deviates on both sides: its own distance is what counts."""
    found = []
    for run in segments(sizes > 0.0):
        worst = run.start + int(np.argmax(sizes[run]))
        first, last, size = run.start, run.stop - 1, float(sizes[worst])
        pairs = [(i, i + 1) for i in range(max(last - 1, 0), min(first + 1, len(dt) - 1)) if last - first <= 1]
        for pair in pairs:  # of which the second way may have stayed below the threshold
            beside = [k for k in (pair[0] - 1, pair[1] + 1) if 0 <= k < len(dt)]
            left = (velocity[list(pair)] - velocity[beside].mean(axis=0)) * dt[list(pair), None]
            if float(np.linalg.norm(left.sum(axis=0))) < 0.5 * size:
                (first, last), size = pair, 0.5 * float(np.linalg.norm(left[0] - left[1]))
                break
        if size > thresholds[worst]:
            found.append(_Jump(start=first, end=last + 1, size=size, threshold=float(thresholds[worst])))
    return found


def _excursions(t_s: Array, velocity: Array, dt: Array, floor: Array, noise_norm: float) -> tuple[Array, Array]:
    """Sizes and thresholds (n,) of steps that make two frames an excursion: out, nearly still, and back; else 0.

    Each such step would announce the other. So the way out is held against the two steps before it alone, the way back
    against the two after it.
    """
    n = len(dt)
    sizes, thresholds = np.zeros((2, n))
    out = np.arange(2, n - 4)  # of five steps on, the first of the three
    back = out + 2
    if len(out) == 0:
        return sizes, thresholds
    away, home = np.zeros((2, len(out), velocity.shape[1]))
    for steps, here, side in ((away, out, -1), (home, back, 1)):
        near, far = here + side, here + 2 * side
        slope = (velocity[near] - velocity[far]) / (t_s[near] - t_s[far])[:, None]
        steps[:] = _beyond(velocity[here], velocity[near], velocity[near] + slope * (t_s[here] - t_s[near])[:, None])
    away, home = away * dt[out, None], home * dt[back, None]
    quiet = 0.5 * (velocity[out - 1] + velocity[back + 1])
    still = (velocity[out + 1] - quiet) * dt[out + 1, None]
    size = np.minimum(np.linalg.norm(away, axis=-1), np.linalg.norm(home, axis=-1))
    beside = np.maximum(np.linalg.norm(velocity[out - 1], axis=-1), np.linalg.norm(velocity[back + 1], axis=-1))
    # More than beside it: else a rest between two jumps would pass for an excursion of the gripper's.
    threshold = np.maximum(np.maximum(floor[out], 1.2 * beside * dt[out]), noise_norm)
    returns = np.linalg.norm(away + home, axis=-1) < 0.5 * size
    for i in np.flatnonzero((size > threshold) & returns & (np.linalg.norm(still, axis=-1) < 0.5 * size)):
        sizes[out[i] : back[i] + 1], thresholds[out[i] : back[i] + 1] = size[i], threshold[i]
    return sizes, thresholds


def _beyond(velocity: Array, constant: Array, linear: Array) -> Array:
    """What is left (n, axes) of velocities beyond the nearest points of the segments from `constant` to `linear`."""
    way = linear - constant
    length2 = np.sum(way**2, axis=-1)
    along = np.sum((velocity - constant) * way, axis=-1)
    share = np.clip(np.divide(along, length2, out=np.zeros_like(along), where=length2 > 0.0), 0.0, 1.0)
    return np.asarray(velocity - constant - share[:, None] * way)


def _deviation(t_s: Array, velocity: Array, known: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Distance (n,) of each velocity (n, axes) at `t_s` (n,) from what those beside it foretell; NaN if not known.

    What they foretell is the segment from the constant to the linear prediction, each the mean of what the known
    velocities before and after foretell. Also returns the greater speed (n,) beside each, and the factor (n,) that the
    floor takes for want of velocities beside it.
    """
    n = len(t_s)
    index = np.flatnonzero(known)
    here = np.searchsorted(index, np.arange(n))
    constant, linear = np.zeros_like(velocity), np.zeros_like(velocity)
    beside = np.zeros(n)
    ones, twos = np.zeros(n, dtype=int), np.zeros(n, dtype=int)
    for near, far in ((here - 1, here - 2), (here + 1, here + 2)):
        has = known & (near >= 0) & (near < len(index))
        two = has & (far >= 0) & (far < len(index))
        a, b = index[np.clip(near, 0, len(index) - 1)], index[np.clip(far, 0, len(index) - 1)]
        constant[has] += velocity[a[has]]
        linear[has] += velocity[a[has]]
        slope = (velocity[a[two]] - velocity[b[two]]) / (t_s[a[two]] - t_s[b[two]])[:, None]
        linear[two] += slope * (t_s[two] - t_s[a[two]])[:, None]
        beside[has] = np.maximum(beside[has], np.linalg.norm(velocity[a[has]], axis=-1))
        ones += has
        twos += two
    with np.errstate(divide="ignore", invalid="ignore"):
        left = _beyond(velocity, constant / ones[:, None], linear / ones[:, None])
    distance = np.linalg.norm(left, axis=-1)
    factor = np.where(ones < 2, AT_END, np.where(twos < 2, NEAR_END, 1.0))
    return np.where(known & (ones > 0), distance, np.nan), beside, factor
