"""Detection of discontinuities: single steps of a track that its motion before and after does not explain.

At video rates a jump can lie within every speed limit, so the criterion is statistical. Each step is predicted from the
two steps before and the two after, for constant and for linearly changing velocity; a smooth motion lies between or
near the two predictions. A step is a jump if its deviation from both exceeds a floor, the noise, a share of the
neighbouring steps and a multiple of the usual deviation nearby. Near the ends of a run of tracked frames a quick start
or stop gives the same deviation, and the floor is higher.
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
from kinebench_drake.violation import Violation, ViolationKind

JUMP_M = 0.06
"""Floor of a jump of the TCP's position for steps of 0.2 s [m]."""
JUMP_RAD = 0.35
"""Floor of a jump of the TCP's orientation, or of a joint, for steps of 0.2 s [rad]."""
STEP_S = 0.2
"""Step above which the floors grow with the square of the time, as the effect of an acceleration does [s]."""
ACCELERATION_M_S2 = 13.0
ACCELERATION_RAD_S2 = 25.0
JOINT_ACCELERATION_RAD_S2 = 20.0
"""Acceleration limits of the Panda that bound the floors over shorter steps: Cartesian, and of its fastest joint.

Source: libfranka, `rate_limiting.h` (limits of the Franka Emika Robot, also in its control interface's documentation).
"""
CONTRAST = 3.0
"""Least ratio of the deviation of a jump to the median of the steps before it, or of those after it."""
SHARE = 0.6
"""Least ratio of the deviation to the longer neighbouring step: a fast motion may change direction fast."""
NEAR_END = 2.0
AT_END = 4.0
"""Factors of the floor where one side has only one step, and where it has none."""
FALSE_ALARM = 0.001
"""Greatest probability of a jump by white noise alone on a track at rest, for each of position, rotation, joints."""

_AROUND = 5  # steps on either side whose median deviation is the usual one


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
    tolerance: float = 1.0,
) -> tuple[Violation, ...]:
    """Find jumps of the TCP, and of recorded joint angles, within runs of tracked frames.

    The frames of a violation are the last one before the jump and the first after it; a jump away and straight back is
    one violation. `value` is the deviation of the step from its predictions and `limit` the threshold: in metres for a
    jump of the TCP's position, in radians for one of its orientation alone (`joint` is None for both) or of a joint.

    Args:
        t_s: (T,) times [s], increasing.
        X_BG: (T, 4, 4) poses of the TCP in B [m].
        tracked: (T,) frames with a usable pose.
        noise: noise of the poses; where unknown (NaN), no step counts as a jump.
        q: (T, 7) recorded joint angles [rad], NaN where unknown; not those of inverse kinematics.
        joints: names of the columns of `q`.
        tolerance: factor of the thresholds of poses.
    """
    violations: list[Violation] = []
    for run in segments(tracked):
        n = run.stop - run.start
        if n <= 2:
            continue
        t = t_s[run]
        moved = set[int]()
        for unit, step, sigma, floor in (
            ("m", np.diff(X_BG[run, :3, 3], axis=0), noise.position_m, _floor(t, JUMP_M, ACCELERATION_M_S2)),
            ("rad", rotation_steps(X_BG[run, :3, :3]), noise.rotation_rad, _floor(t, JUMP_RAD, ACCELERATION_RAD_S2)),
        ):
            jumps = _jumps(t, step, floor, _noise_norm(sigma, 3, n, FREEDOM_PER_FRAME), tolerance)
            alone = [jump for jump in jumps if moved.isdisjoint(range(jump.start, jump.end))]
            moved.update(frame for jump in alone for frame in range(jump.start, jump.end))
            violations += [_violation(jump, run, None, unit) for jump in alone]
    if q is not None:
        violations += _joint_jumps(t_s, q, joints)
    return tuple(sorted(violations, key=lambda v: (v.frame_start, v.frame_end, v.joint or "")))


def _joint_jumps(t_s: Array, q: Array, joints: tuple[str, ...]) -> list[Violation]:
    sigma = estimate_joint_noise(t_s, q)
    violations = []
    for run in segments(finite_rows(q)):
        t = t_s[run]
        n = run.stop - run.start
        floor = _floor(t, JUMP_RAD, JOINT_ACCELERATION_RAD_S2)
        for j, name in enumerate(joints):
            step = np.diff(q[run, j : j + 1], axis=0)
            noise_norm = _noise_norm(sigma[j], 1, n, JOINT_FREEDOM_PER_FRAME, groups=q.shape[1])
            violations += [_violation(jump, run, name, "rad") for jump in _jumps(t, step, floor, noise_norm)]
    return violations


def _violation(jump: _Jump, run: slice, joint: str | None, unit: str) -> Violation:
    frames = slice(run.start + jump.start, run.start + jump.end + 1)
    return Violation.of_run(ViolationKind.DISCONTINUITY, frames, joint, jump.size, jump.threshold, unit)


def _floor(t_s: Array, floor: float, acceleration: float) -> Array:
    """Return the floor (n - 1,) of a jump for steps between the times `t_s` (n,) [s]."""
    dt2 = np.diff(t_s) ** 2
    return np.minimum(floor * np.maximum(dt2 / STEP_S**2, 1.0), acceleration * dt2)


def _noise_norm(sigma: float, axes: int, frames: int, freedom: float, groups: int = 1) -> float:
    """Return the deviation that noise `sigma` per axis exceeds at any step with probability FALSE_ALARM.

    The difference of two neighbouring, evenly spaced steps has sqrt(6) sigma per axis; its squared norm over the
    measured variance, a mean over axes, follows Fisher's distribution, with `freedom` degrees of freedom of the
    variance per frame.
    """
    chance = 1.0 - FALSE_ALARM / (frames * groups)
    return float(np.sqrt(6.0 * axes * fdtri(axes, max(freedom * frames, 1.0), chance)) * sigma)


def _jumps(t_s: Array, steps: Array, floor: Array, noise_norm: float, tolerance: float = 1.0) -> list[_Jump]:
    """Find jumps among `steps` (n - 1, axes) between the times `t_s` (n,) [s], in order of frames.

    Thresholds are multiplied by `tolerance`.
    """
    dt = np.diff(t_s)
    velocity = steps / dt[:, None]
    middle = 0.5 * (t_s[:-1] + t_s[1:])
    sizes, thresholds = _excursions(middle, velocity, dt, tolerance * floor, tolerance * noise_norm)
    while True:
        usable = sizes == 0.0
        speed, beside, factor = _deviation(middle, velocity, usable)
        deviation = speed * dt
        threshold = tolerance * np.maximum(np.maximum(factor * floor, SHARE * beside * dt), noise_norm)  # NaN: unknown
        jumps = np.flatnonzero(~usable)  # their neighbours deviate because of them and are not tested
        threshold[jumps[jumps > 0] - 1] = threshold[jumps[jumps < len(dt) - 1] + 1] = np.inf
        for i in np.argsort(-np.nan_to_num(deviation / threshold)).tolist():
            if not deviation[i] > threshold[i]:
                return _merged(velocity, dt, sizes, thresholds)
            if deviation[i] > CONTRAST * _usual(deviation, i):
                sizes[i] = deviation[i]
                thresholds[i] = threshold[i]
                break
        else:
            return _merged(velocity, dt, sizes, thresholds)


def _usual(deviation: Array, i: int) -> float:
    """Return the lesser median deviation of the steps before and after the i-th: one side may contain another jump."""
    sides = (deviation[max(0, i - _AROUND) : i], deviation[i + 1 : i + 1 + _AROUND])
    return min((float(np.median(side)) for side in (s[np.isfinite(s)] for s in sides) if len(side)), default=0.0)


def _merged(velocity: Array, dt: Array, sizes: Array, thresholds: Array) -> list[_Jump]:
    """Merge neighbouring jumps. For a single outlying frame, which deviates on both sides, its own distance counts."""
    jumps = []
    for run in segments(sizes > 0.0):
        worst = run.start + int(np.argmax(sizes[run]))
        first = run.start
        last = run.stop - 1
        size = float(sizes[worst])
        pairs = [(i, i + 1) for i in range(max(last - 1, 0), min(first + 1, len(dt) - 1)) if last - first <= 1]
        for pair in pairs:  # the return of an outlying frame may be below the threshold
            beside = [k for k in (pair[0] - 1, pair[1] + 1) if 0 <= k < len(dt)]
            left = (velocity[list(pair)] - velocity[beside].mean(axis=0)) * dt[list(pair), None]
            if float(np.linalg.norm(left.sum(axis=0))) < 0.5 * size:
                (first, last) = pair
                size = 0.5 * float(np.linalg.norm(left[0] - left[1]))
                break
        if size > thresholds[worst]:
            jumps.append(_Jump(start=first, end=last + 1, size=size, threshold=float(thresholds[worst])))
    return jumps


def _excursions(t_s: Array, velocity: Array, dt: Array, floor: Array, noise_norm: float) -> tuple[Array, Array]:
    """Return sizes and thresholds (n,) of the steps of two-frame excursions (away, nearly at rest, back); else 0.

    Such steps would predict each other, so the step away is compared with the two steps before it alone, the step back
    with the two after it.
    """
    n = len(dt)
    sizes, thresholds = np.zeros((2, n))
    out = np.arange(2, n - 4)  # first of the three steps of an excursion
    back = out + 2
    if len(out) == 0:
        return sizes, thresholds
    away, home = np.zeros((2, len(out), velocity.shape[1]))
    for steps, here, side in ((away, out, -1), (home, back, 1)):
        near = here + side
        far = here + 2 * side
        slope = (velocity[near] - velocity[far]) / (t_s[near] - t_s[far])[:, None]
        steps[:] = _beyond(velocity[here], velocity[near], velocity[near] + slope * (t_s[here] - t_s[near])[:, None])
    away = away * dt[out, None]
    home = home * dt[back, None]
    still = (velocity[out + 1] - 0.5 * (velocity[out - 1] + velocity[back + 1])) * dt[out + 1, None]
    size = np.minimum(np.linalg.norm(away, axis=-1), np.linalg.norm(home, axis=-1))
    beside = np.maximum(np.linalg.norm(velocity[out - 1], axis=-1), np.linalg.norm(velocity[back + 1], axis=-1))
    # Larger than its neighbours: else a rest between two fast motions would count as an excursion.
    threshold = np.maximum(np.maximum(floor[out], 1.2 * beside * dt[out]), noise_norm)
    returns = np.linalg.norm(away + home, axis=-1) < 0.5 * size
    for i in np.flatnonzero((size > threshold) & returns & (np.linalg.norm(still, axis=-1) < 0.5 * size)):
        sizes[out[i] : back[i] + 1] = size[i]
        thresholds[out[i] : back[i] + 1] = threshold[i]
    return sizes, thresholds


def _beyond(velocity: Array, constant: Array, linear: Array) -> Array:
    """Return the vectors (n, axes) from the nearest points of the segments `constant` to `linear` to the velocities."""
    way = linear - constant
    length2 = np.sum(way**2, axis=-1)
    along = np.sum((velocity - constant) * way, axis=-1)
    share = np.clip(np.divide(along, length2, out=np.zeros_like(along), where=length2 > 0.0), 0.0, 1.0)
    return np.asarray(velocity - constant - share[:, None] * way)


def _deviation(t_s: Array, velocity: Array, usable: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Return the distance (n,) of each velocity (n, axes) at `t_s` (n,) from its predictions; NaN if not usable.

    The prediction is the segment from the constant to the linear extrapolation, each the mean of those of the usable
    velocities before and after. Also returned: the greater neighbouring speed (n,) and the factor (n,) of the floor for
    missing neighbours.
    """
    n = len(t_s)
    index = np.flatnonzero(usable)
    here = np.searchsorted(index, np.arange(n))
    constant = np.zeros_like(velocity)
    linear = np.zeros_like(velocity)
    beside = np.zeros(n)
    ones = np.zeros(n, dtype=int)
    twos = np.zeros(n, dtype=int)
    for near, far in ((here - 1, here - 2), (here + 1, here + 2)):
        has = usable & (near >= 0) & (near < len(index))
        two = has & (far >= 0) & (far < len(index))
        a = index[np.clip(near, 0, len(index) - 1)]
        b = index[np.clip(far, 0, len(index) - 1)]
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
    return np.where(usable & (ones > 0), distance, np.nan), beside, factor
