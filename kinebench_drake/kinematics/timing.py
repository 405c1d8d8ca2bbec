"""Time-optimal parameterization of a joint path under the limits of speed, acceleration and torque.

The method of Drake's Toppra (H. Pham and Q.-C. Pham, "A New Approach to Time-Optimal Path Parameterization Based on
Reachability Analysis", IEEE Trans. Robot. 34, 2018), which solves three linear programs in two variables in every cell
of the grid. Here their optimum is found along lines, exactly and without a solver: Drake's finds no timing on some
paths with exact rests, and takes no limits of speed that depend on the position.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.violation import ViolationKind

STILL_RAD = 1e-4
"""Range of every joint below which a path counts as a rest [rad]."""
ACTIVE_SHARE = 0.98
"""Share of a limit from which on it counts as active."""
FASTEST_REST = 1000.0
"""Greatest speed-up of any part of a path: a rest takes a thousandth of its time."""

_GRID = 192  # cells of the grid along the path, rounded up to whole cells per frame
_GRID_MAX = 1600  # greatest number of cells; a track of more frames is sampled evenly in time
_FINEST = 64  # greatest number of cells between two frames
_HALVINGS = 4  # of cells at the edge of a rest:
_BRINK = 0.6  # the slower end has at most this share of the faster end's speed,
_REST = 1e-3  # unless both are slower than this share of the greatest speed
_COARSER = (1, 0)  # halvings then: a long last cell, whose far end has no limit, may reach the speed of the last frame
_KINDS = (ViolationKind.VELOCITY, ViolationKind.ACCELERATION, ViolationKind.TORQUE)  # limits of the speed of a path


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeScale:
    """Fastest feasible duration of a joint path, and the limits that bound it."""

    value: float | None = None
    """Fastest feasible duration / own duration; None where there is none, with a reason."""
    reason: str | None = None
    """Why there is no value; None where there is one."""
    constraint: ViolationKind | None = None
    """Kind of the limit that is active longest or, without a value, violated; None if there is none."""
    joint: str | None = None
    """Joint of that limit."""
    frame: int | None = None
    """Row of the input arrays where that limit slows the path most (least speed-up while active) or is violated."""


def time_scale(plant: ArmPlant, t_s: Array, q: Array) -> TimeScale:
    """Compute the fastest feasible duration of the path through `q` over its own duration.

    The path is the cubic spline through the rows (ends not-a-knot); its parameter s is its own time.
    `fastest_rates` finds the fastest s(t) with ds/dt = 1 at both ends, as a clip is cut in mid-motion. Limits
    hold at the points of a grid and, to first order, between them: at 49 frames the result is some tenths of a percent
    too large, with rests at either end up to one percent. A rest within a track is passed 1,000 times faster. A
    path without motion has no value.

    Args:
        plant: the robot; accelerations are unlimited where it states no limits.
        t_s: (T,) times [s], increasing, of any spacing.
        q: (T, J) joint angles [rad], denoised; rows with NaN are left out.
    """
    frames = np.flatnonzero(np.isfinite(q).all(axis=-1) & np.isfinite(t_s))
    t = t_s[frames]
    rows = q[frames]
    if len(frames) < 2:
        return TimeScale(reason="fewer than two frames with joint angles: there is no path")
    if not (np.diff(t) > 0.0).all():
        return TimeScale(reason="the times do not increase from frame to frame")
    if not np.isfinite(plant.velocity_limits).any():
        return TimeScale(reason=f"{plant.robot.name} states no velocity limits")
    if (np.ptp(rows, axis=0) < STILL_RAD).all():
        return TimeScale(reason="the joints do not move: a rest has no fastest duration")
    motion = _PathMotion(plant, t, rows, frames)
    end = _broken_end(motion)
    if end is not None and end.constraint is ViolationKind.VELOCITY:
        return end
    rate = fastest_rates(motion.limits, 1.0, 1.0)
    for halvings in _COARSER if rate is None else ():
        motion = _PathMotion(plant, t, rows, frames, halvings)
        rate = fastest_rates(motion.limits, 1.0, 1.0)
        if rate is not None:
            break
    return _explain(motion) if rate is None else _describe(motion, rate)


class _PathMotion:
    """Path of one track on a grid, with its limits."""

    def __init__(
        self, plant: ArmPlant, t_s: Array, q: Array, frames: NDArray[np.intp], halvings: int = _HALVINGS
    ) -> None:
        self.plant = plant
        self.frames = frames
        self.t = t_s - t_s[0]
        spline: Any = CubicSpline(self.t, q)
        self.grid = _grid(self.t, spline, plant.planned_speeds, halvings)
        q, v, a = (np.asarray(spline(self.grid, order)) for order in range(3))
        still = np.zeros_like(v)
        # Torques are linear in d2s/dt2 and (ds/dt)^2.
        torque = plant.chain.torques(q, np.stack([still, still, v]), np.stack([still, v, a])) / plant.effort_limits
        bounds = np.inf if plant.acceleration_limits is None else plant.acceleration_limits
        self.speed = v / plant.robot.limits.speeds(q, v)
        """(G, J) speeds in own time over their limits."""
        self.limits = PathLimits(
            s=self.grid,
            fastest=1.0 / np.maximum(np.abs(self.speed).max(axis=-1), 1.0 / FASTEST_REST),
            slope=np.hstack([v / bounds, torque[1] - torque[0]]),
            bend=np.hstack([a / bounds, torque[2] - torque[0]]),
            rest=np.hstack([still, torque[0]]),
        )

    def ratios(self, points: int | slice | NDArray[np.intp], rate: Array, change: Array) -> Array:
        """Return speed, acceleration and torque over their limits (..., 3, J) at grid `points` (...).

        `rate` (...) is ds/dt there, `change` (...) d2s/dt2.
        """
        rate = np.asarray(rate)[..., None]
        change = np.asarray(change)[..., None]
        limits = self.limits
        both = limits.slope[points] * change + limits.bend[points] * rate**2 + limits.rest[points]
        return np.concatenate([self.speed[points] * rate, both], axis=-1).reshape(
            *both.shape[:-1], 3, both.shape[-1] // 2
        )

    def frame(self, index: int) -> int:
        """Return the frame nearest to a grid point."""
        return int(self.frames[np.argmin(np.abs(self.t - self.grid[index]))])


def _grid(t: Array, spline: Any, speeds: Array, halvings: int) -> Array:
    """Return grid points (G,) in own time: whole cells per frame, cells at the edge of a rest halved repeatedly.

    There the speed-up of the fastest motion changes steeply, while its square is taken as linear within a cell.
    """
    cells = len(t) - 1
    parts = min(-(-_GRID // cells), _FINEST)
    even = np.arange(cells * parts + 1) / parts
    grid = np.interp(even, np.arange(cells + 1), t) if cells <= _GRID_MAX else np.linspace(t[0], t[-1], _GRID_MAX + 1)
    for _ in range(halvings):
        speed = np.abs(spline(grid, 1) / speeds).max(axis=-1)
        slow = np.minimum(speed[1:], speed[:-1])
        fast = np.maximum(speed[1:], speed[:-1])
        brink = (slow < _BRINK * fast) & (fast > _REST * speed.max())
        middle = 0.5 * (grid[1:] + grid[:-1])[brink]
        if len(grid) + len(middle) > 2 * _GRID_MAX:
            break
        grid = np.sort(np.concatenate([grid, middle]))
    return grid


def _describe(motion: _PathMotion, rate: Array) -> TimeScale:
    # ds/dt squared is linear in s between grid points, so the change is constant there.
    change = np.diff(rate**2) / (2.0 * np.diff(motion.grid))
    spent = 2.0 * np.diff(motion.grid) / (rate[1:] + rate[:-1])
    share, active = _usage(motion, rate, change, spent)
    value = float(spent.sum() / (motion.t[-1] - motion.t[0]))
    c, j = np.unravel_index(np.argmax(share), share.shape)
    if share[c, j] == 0.0:
        return TimeScale(value=value)
    cells = np.flatnonzero(active[:, c, j])
    slowest = motion.frame(int(cells[np.argmin(rate[cells] + rate[cells + 1])]))
    return TimeScale(value=value, constraint=_KINDS[c], joint=motion.plant.robot.joints[j], frame=slowest)


def _usage(motion: _PathMotion, rate: Array, change: Array, spent: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the share of time (3, J) in which each limit is active, and whether it is in each cell (G - 1, 3, J)."""
    near = motion.ratios(slice(None, -1), rate[:-1], change)
    active = np.abs([near, motion.ratios(slice(1, None), rate[1:], change)]) >= ACTIVE_SHARE
    return np.einsum("k,ikcj->cj", 0.5 * spent / spent.sum(), active), np.asarray(active.any(axis=0))


def _explain(motion: _PathMotion) -> TimeScale:
    """Explain why no timing is feasible: a posture that the motors cannot hold, else a speed at one of the ends."""
    joints = motion.plant.robot.joints
    still = np.zeros(len(motion.grid))
    weight = motion.ratios(slice(None), still, still)[:, 2]
    heaviest, j = np.unravel_index(np.argmax(np.abs(weight)), weight.shape)
    if abs(weight[heaviest, j]) > 1.0:
        text = f"{joints[j]} cannot hold the arm's weight ({abs(weight[heaviest, j]):.2f} x its torque limit)"
        frame = motion.frame(int(heaviest))
        return TimeScale(reason=text, constraint=ViolationKind.TORQUE, joint=joints[j], frame=frame)
    end = _broken_end(motion)
    if end is not None:
        return end
    own = np.abs(motion.ratios(slice(None), np.ones_like(still), still))
    broken = np.flatnonzero(own.max(axis=(1, 2)) > 1.0)
    if len(broken) == 0:
        return TimeScale(reason="no timing was found, though the path's own one keeps the limits on the grid")
    # If a motion that ends at rest is feasible, the speed of the last frame cannot be reached.
    starts = fastest_rates(motion.limits, 1.0, 0.0) is not None
    k = int(broken[-1] if starts else broken[0])
    c, j = np.unravel_index(np.argmax(own[k]), own[k].shape)
    kind = _KINDS[c]
    text = (
        f"the speed of the {'last' if starts else 'first'} frame cannot be "
        f"{'reached' if starts else 'braked'} in time: {joints[j]} is beyond its {kind.value} limit near it"
    )
    return TimeScale(reason=text, constraint=kind, joint=joints[j], frame=motion.frame(k))


def _broken_end(motion: _PathMotion) -> TimeScale | None:
    """Return the limit that the own speed of the first or last frame violates for any d2s/dt2 there; None if none."""
    for index, end in ((0, "first"), (len(motion.grid) - 1, "last")):
        ratio = _least_ratios(motion, index)
        c, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        if ratio[c, j] > 1.0:
            kind = _KINDS[c]
            joint = motion.plant.robot.joints[j]
            text = f"at its speed in the {end} frame {joint} is beyond its {kind.value} limit ({ratio[c, j]:.2f} x)"
            return TimeScale(reason=text, constraint=kind, joint=joint, frame=motion.frame(index))
    return None


def _least_ratios(motion: _PathMotion, index: int) -> Array:
    """Return |ratios| (3, J) at a grid point at the own speed, for the d2s/dt2 that minimises their maximum."""
    fixed, moved = motion.ratios(index, np.ones(2), np.array([0.0, 1.0]))
    slope = moved - fixed
    # The maximum of |fixed + slope x| is convex and piecewise linear in x: its minimum is where two lines cross.
    level = np.concatenate([fixed.ravel(), -fixed.ravel()])
    incline = np.concatenate([slope.ravel(), -slope.ravel()])
    rise = incline[:, None] - incline
    x = np.divide(level - level[:, None], rise, out=np.zeros_like(rise), where=np.abs(rise) > 1e-12).ravel()
    worst = np.max(level + x[:, None] * incline, axis=-1)
    return np.asarray(np.abs(fixed + slope * x[np.argmin(worst)]))


_ROUNDING = 1e-9  # share of a limit that counts as rounding
_STEPS = 100  # greatest number of lines tried for one optimum; two are typical
FLAT = 1e-9
"""Ratio of the factors of two variables below which a limit bounds only the other one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathLimits:
    """Limits at G points of a path s: ds/dt <= fastest and |slope * d2s/dt2 + bend * (ds/dt)^2 + rest| <= 1."""

    s: Array
    """(G,) values of the path parameter, increasing."""
    fastest: Array
    """(G,) greatest ds/dt."""
    slope: Array
    """(G, R) factors of d2s/dt2."""
    bend: Array
    """(G, R) factors of (ds/dt)^2."""
    rest: Array
    """(G, R) values at rest."""


def fastest_rates(limits: PathLimits, start: float, end: float) -> Array | None:
    """Return ds/dt (G,) of the fastest s(t) with rates `start` and `end` at its ends; None if there is none.

    d2s/dt2 is constant between two points, and the limits hold at both, but in the last cell at its near point only.
    """
    step = 2.0 * np.diff(limits.s)[:, None]
    # With x = (ds/dt)^2 at the near point of a cell and y at the far one, d2s/dt2 = (y - x) / step.
    near = limits.slope[:-1] / step
    far = limits.slope[1:] / step
    of_x = np.concatenate([limits.bend[:-1] - near, -far], axis=-1)
    of_y = np.concatenate([near, limits.bend[1:] + far], axis=-1)
    rest = np.concatenate([limits.rest[:-1], limits.rest[1:]], axis=-1)
    for factor in (of_x, of_y, rest):
        factor[-1, limits.rest.shape[1] :] = 0.0
    most = limits.fastest**2
    back = _bands(of_x, of_y, rest, most[:-1])
    ahead = _bands(of_y, of_x, rest, most[1:])

    # values of x from which the end can be reached
    low = np.empty(len(most))
    high = np.empty(len(most))
    low[-1] = high[-1] = end**2
    for k in range(len(step) - 1, -1, -1):
        y_low = max(low[k + 1], back.low[k])
        y_high = min(high[k + 1], back.high[k])
        incline = back.incline[k]
        above = back.above[k]
        below = back.below[k]
        top = _greatest(incline, above, below, y_low, y_high)
        bottom = _greatest(-incline, -below, -above, y_low, y_high)
        if top is None or bottom is None:
            return None
        low[k] = -bottom
        high[k] = top
    x = np.empty(len(most))
    x[0] = start**2
    if not (1.0 - _ROUNDING) * low[0] <= x[0] <= (1.0 + _ROUNDING) * high[0]:
        return None
    for k in range(len(step)):
        reached = (ahead.above[k] + ahead.incline[k] * x[k]).min()
        x[k + 1] = min(max(reached, low[k + 1]), high[k + 1])
    return np.sqrt(x)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Bands:
    """Limits of x in K cells as functions of y: below + incline * y <= x <= above + incline * y, for y in a range."""

    incline: Array
    """(K, B)."""
    above: Array
    """(K, B)."""
    below: Array
    """(K, B)."""
    low: Array
    """(K,) least y."""
    high: Array
    """(K,) greatest y."""


def _bands(of_x: Array, of_y: Array, rest: Array, most: Array) -> _Bands:
    """Return the limits |of_x * x + of_y * y + rest| <= 1 (K, R) and 0 <= x <= most (K,), solved for x."""
    flat = np.abs(of_x) <= FLAT * np.abs(of_y)
    divisor = np.where(flat, 1.0, of_x)
    middle = np.where(flat, 0.0, -rest / divisor)
    width = np.where(flat, np.inf, np.abs(1.0 / divisor))
    incline = np.where(flat, 0.0, -of_y / divisor)
    # A limit without x bounds y, or is kept, or broken, whatever both are.
    alone = flat & (of_y != 0.0)
    void = flat & (of_y == 0.0) & (np.abs(rest) > 1.0)
    divisor = np.where(alone, of_y, 1.0)
    middle_y = np.where(alone, -rest / divisor, 0.0)
    width_y = np.where(alone, np.abs(1.0 / divisor), np.inf)
    edge = np.zeros((len(most), 1))
    return _Bands(
        incline=np.hstack([incline, edge]),
        above=np.hstack([middle + width, most[:, None]]),
        below=np.hstack([middle - width, edge]),
        low=np.where(void.any(axis=-1), np.inf, (middle_y - width_y).max(axis=-1)),
        high=(middle_y + width_y).min(axis=-1),
    )


def _greatest(incline: Array, above: Array, below: Array, low: float, high: float) -> float | None:
    """Return the greatest x with below + incline * y <= x <= above + incline * y (B,) for a y from `low` to `high`.

    The upper bound of x is concave in y: it is computed at both ends, then where the lines that bound it there cross,
    until no other line is below. None if there is no x.
    """
    right = _bound(incline, above, below, high, low)
    if right is None or right[2] >= 0.0:
        return None if right is None else right[1]
    left = _bound(incline, above, below, low, right[0])
    if left is None or left[2] <= 0.0:
        return None if left is None else left[1]
    for _ in range(_STEPS):
        y = left[0] + (right[1] - left[1] + right[2] * (left[0] - right[0])) / (left[2] - right[2])
        upper = above + incline * y
        i = upper.argmin()
        middle = y, float(upper[i]), float(incline[i])
        if middle[2] in {left[2], right[2]}:
            break
        left, right = (middle, right) if middle[2] > 0.0 else (left, middle)
    return middle[1]


def _bound(incline: Array, above: Array, below: Array, y: float, other: float) -> tuple[float, float, float] | None:
    """Return the first y on the way to `other` that has an x, the greatest x there and its derivative; None if none."""
    for _ in range(_STEPS):
        line = incline * y
        upper = above + line
        lower = below + line
        i = upper.argmin()
        j = lower.argmax()
        gap = upper[i] - lower[j]
        if gap >= -_ROUNDING * min(above[i] - below[i], above[j] - below[j]):
            return y, float(upper[i]), float(incline[i])
        closing = incline[i] - incline[j]
        met = y - gap / closing if closing else np.inf
        if not min(y, other) <= met <= max(y, other):
            return None
        y = float(met)
    return None
