"""The least time in which a joint path can be run: Toppra under the limits of speed, acceleration and torque."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.optimization import Toppra, ToppraDiscretization
from pydrake.trajectories import PiecewisePolynomial
from scipy.interpolate import CubicSpline

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant, silent_drake
from kinebench_drake.models.robot import N_JOINTS

STILL_RAD = 1e-4
"""A path whose every joint stays within this range does not move [rad]."""
FASTEST = 1000.0
"""No part of the path is run more than this many times faster than it was: a rest takes a thousandth of its time."""
ACTIVE = 0.98
"""Share of a limit from which on the fastest motion counts as held back by it."""

_GRID = 192  # cells of the grid along the path, rounded up to whole cells a frame
_GRID_MAX = 1600  # cells at most: a track of more frames is looked at in even steps of its time instead
_FINEST = 64  # cells between two frames at most
_HALVINGS = 4  # of cells at the brink of a rest:
_BRINK = 0.6  # the slower end has at most this share of the faster end's speed,
_REST = 1e-3  # unless both are slower than this share of the greatest speed
_CAP_RATE = 1e-6  # what the last joint beside the arm's, such as a finger [m], moves a second of the path's own time:
# its speed limit caps the speed-up
_STRETCHES = (100.0, 10.0, 1000.0, 1.0)  # of the path's parameter, the next where the one before finds no solution
_ELSE = ((1, (100.0, 10.0)), (0, (100.0, 10.0)))  # halvings and stretches then: small cells are hard on Toppra
_UNBOUNDED = 1e9  # what Toppra takes for a limit that is not there


class TimingConstraint(Enum):
    """What keeps a path from being run faster."""

    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    TORQUE = "torque"


@dataclass(frozen=True, slots=True, kw_only=True)
class ActiveLimit:
    """One limit that holds the fastest motion back."""

    constraint: TimingConstraint
    joint: str
    """Name of the joint, such as panda_joint4."""
    share: float
    """Part 0..1 of the fastest duration in which the limit is used to `ACTIVE` or more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeScale:
    """How fast a joint path could be run, and what forbids to run it faster."""

    value: float | None
    """Least feasible duration / own duration; None where there is none, with a reason."""
    reason: str | None
    """Why there is no value; None where there is one."""
    constraint: TimingConstraint | None
    """Kind of the limit that is active longest or, without a value, that is broken; None if no limit is at fault."""
    joint: str | None
    """Joint of that limit."""
    frame: int | None
    """Row of the arrays given where that limit slows the path most (least speed-up while active) or is broken."""
    active: tuple[ActiveLimit, ...]
    """All limits that are ever active, the longest first; several may be active at once."""
    own_s: Array
    """(G,) own times along the path [s], from `t_s[0]` on; empty without a value."""
    fastest_s: Array
    """(G,) when the fastest motion passes them [s], from 0 on; empty without a value."""


def time_scale(plant: ArmPlant, t_s: Array, q: Array) -> TimeScale:
    """The least time in which the path through `q` can be run, over the time it took.

    The path is the cubic spline through the rows (second derivative continuous, ends not-a-knot); its parameter s is
    its own time, so that ds/dt = 1 is its own timing. Toppra (H. Pham and Q.-C. Pham, "A New Approach to Time-Optimal
    Path Parameterization Based on Reachability Analysis", IEEE Trans. Robot. 34, 2018), as Drake has it, finds the
    fastest s(t) with ds/dt = 1 at both ends: a clip is cut in mid-motion, so its boundary speeds are kept. Limits
    hold at the points of a grid and, to first order, between them: at 49 frames the result is some tenths of a
    percent too large, in rests at either end up to one percent.

    A rest in the middle of a track costs nothing, since nothing makes the robot wait: it is passed `FASTEST` times
    faster, and the robot comes to rest there as the path does. A path without motion has no value.

    Args:
        plant: the robot; accelerations are unlimited where none are published.
        t_s: (T,) times [s], increasing, the spacing as it may be.
        q: (T, 7) joint angles [rad], already free of noise; rows with NaN are left out.
    """
    frames = np.flatnonzero(np.isfinite(q).all(axis=-1) & np.isfinite(t_s))
    t, rows = t_s[frames], q[frames]
    if len(frames) < 2:
        return _nothing("fewer than two frames with joint angles: there is no path")
    if not (np.diff(t) > 0.0).all():
        return _nothing("the times do not increase from frame to frame")
    if (np.ptp(rows, axis=0) < STILL_RAD).all():
        return _nothing("the joints do not move: a rest has no fastest duration")
    motion = _Motion(plant, t, rows, frames)
    end = _broken_end(motion)
    if end is not None and end.constraint is TimingConstraint.VELOCITY:  # no need to ask Toppra
        return end
    try:
        profile = motion.fastest(1.0, 1.0)
        for halvings, stretches in _ELSE if profile is None else ():
            motion = _Motion(plant, t, rows, frames, halvings)
            profile = motion.fastest(1.0, 1.0, stretches)
            if profile is not None:
                break
    except RuntimeError as error:  # Drake's own checks of its input
        return _nothing(f"Toppra refused the path: {str(error).splitlines()[0]}")
    return _explain(motion) if profile is None else _describe(motion, *profile)


def _nothing(
    reason: str, constraint: TimingConstraint | None = None, joint: str | None = None, frame: int | None = None
) -> TimeScale:
    empty = np.empty(0)
    return TimeScale(
        value=None,
        reason=reason,
        constraint=constraint,
        joint=joint,
        frame=frame,
        active=(),
        own_s=empty,
        fastest_s=empty,
    )


class _Motion:
    """The path of one track with its limits, on a grid."""

    def __init__(
        self, plant: ArmPlant, t_s: Array, q: Array, frames: NDArray[np.intp], halvings: int = _HALVINGS
    ) -> None:
        self.plant, self.frames = plant, frames
        self.origin_s, self.t = float(t_s[0]), t_s - t_s[0]
        t = self.t
        spline: Any = CubicSpline(t, q)
        self.spline = spline
        self.grid = _grid(t, spline, plant.velocity_limits, halvings)
        self.q, self.v, self.a = (np.asarray(spline(self.grid, order)) for order in range(3))

    def fastest(
        self, start: float, end: float, stretches: tuple[float, ...] = _STRETCHES
    ) -> tuple[Array, Array] | None:
        """Times (G,) [s] and rates ds/dt (G,) at the grid points, with those of the ends given; None if there are none.

        Toppra's linear programs may miss solutions where their unknown, (ds/dt)^2, is too small or too large for the
        solver's tolerance, which is absolute. So the path's parameter is stretched, by one factor after the other.
        """
        for stretch in stretches:
            with silent_drake():
                s: Any = self._toppra(stretch).SolvePathParameterization(stretch * start, stretch * end)
            if s is not None:
                times = np.asarray(s.get_segment_times())
                return times, np.array([s.EvalDerivative(t, 1)[0, 0] for t in times]) / stretch
        return None

    def _toppra(self, stretch: float) -> Any:
        """Drake's Toppra with all limits on the path whose parameter is own time * `stretch`."""
        plant = self.plant
        positions = plant.positions(self.spline(self.t))
        rates = np.zeros_like(positions)
        rates[:, plant.arm] = self.spline(self.t, 1) / stretch
        held = np.delete(np.arange(positions.shape[1]), plant.arm)[-1:]
        positions[:, held] += _CAP_RATE * self.t[:, None]
        rates[:, held] = _CAP_RATE / stretch
        # Toppra refers to the path without keeping it alive.
        self._path: Any = PiecewisePolynomial.CubicHermite(stretch * self.t, positions.T, rates.T)
        grid: Any = stretch * self.grid
        toppra: Any = Toppra(self._path, plant.drake, grid)
        speed = _bounds(plant, plant.velocity_limits)
        speed[np.delete(np.arange(len(speed)), plant.arm_rates)[-1:]] = FASTEST * _CAP_RATE
        toppra.AddJointVelocityLimit(-speed, speed)
        if plant.acceleration_limits is not None:
            acceleration = _bounds(plant, plant.acceleration_limits)
            toppra.AddJointAccelerationLimit(-acceleration, acceleration, ToppraDiscretization.kInterpolation)
        torque = _bounds(plant, plant.effort_limits)
        toppra.AddJointTorqueLimit(-torque, torque, ToppraDiscretization.kInterpolation)
        return toppra

    def ratios(self, index: int, rate: float, change: float) -> Array:
        """Velocity, acceleration and torque over their limits (3, 7) at a grid point, with ds/dt and d2s/dt2 given."""
        plant = self.plant
        v = self.v[index] * rate
        a = self.a[index] * rate**2 + self.v[index] * change
        out = np.zeros((3, N_JOINTS))
        out[0] = v / plant.velocity_limits
        if plant.acceleration_limits is not None:
            out[1] = a / plant.acceleration_limits
        out[2] = plant.torque(self.q[index], v, a) / plant.effort_limits
        return out

    def frame(self, index: int) -> int:
        """The frame nearest to a grid point."""
        return int(self.frames[np.argmin(np.abs(self.t - self.grid[index]))])


def _grid(t: Array, spline: Any, speeds: Array, halvings: int) -> Array:
    """Grid points (G,) along the path's own time: whole cells a frame, those at the brink of a rest halved and again.

    There the fastest motion runs ahead of the path's own time by a factor that changes steeply, and Toppra takes the
    square of that factor as linear in a cell.
    """
    cells = len(t) - 1
    parts = min(-(-_GRID // cells), _FINEST)
    even = np.arange(cells * parts + 1) / parts
    grid = np.interp(even, np.arange(cells + 1), t) if cells <= _GRID_MAX else np.linspace(t[0], t[-1], _GRID_MAX + 1)
    for _ in range(halvings):
        speed = np.abs(spline(grid, 1) / speeds).max(axis=-1)
        slow, fast = np.minimum(speed[1:], speed[:-1]), np.maximum(speed[1:], speed[:-1])
        brink = (slow < _BRINK * fast) & (fast > _REST * speed.max())
        middle = 0.5 * (grid[1:] + grid[:-1])[brink]
        if len(grid) + len(middle) > 2 * _GRID_MAX:
            break
        grid = np.sort(np.concatenate([grid, middle]))
    return grid


def _bounds(plant: ArmPlant, limits: Array) -> Array:
    """The arm's limits (7,) among those of all the plant's joints, which have none."""
    bounds = np.full(plant.drake.num_velocities(), _UNBOUNDED)
    bounds[plant.arm_rates] = np.minimum(limits, _UNBOUNDED)
    return bounds


def _describe(motion: _Motion, times: Array, rate: Array) -> TimeScale:
    # ds/dt squared is linear in s between grid points, so the change is constant there.
    change = np.diff(rate**2) / (2.0 * np.diff(motion.grid))
    spent = np.diff(times)
    share, active = _usage(motion, rate, change, spent)
    kinds, joints = tuple(TimingConstraint), motion.plant.robot.joints
    order = [np.unravel_index(i, share.shape) for i in np.argsort(-share, axis=None, kind="stable")]
    c, j = order[0]
    slowest = None
    if share[c, j] > 0.0:
        cells = np.flatnonzero(active[:, c, j])
        slowest = motion.frame(int(cells[np.argmin(rate[cells] + rate[cells + 1])]))
    return TimeScale(
        value=float(spent.sum() / (motion.t[-1] - motion.t[0])),
        reason=None,
        constraint=kinds[c] if slowest is not None else None,
        joint=joints[j] if slowest is not None else None,
        frame=slowest,
        active=tuple(
            ActiveLimit(constraint=kinds[c], joint=joints[j], share=float(share[c, j])) for c, j in order if share[c, j]
        ),
        own_s=motion.grid + motion.origin_s,
        fastest_s=times - times[0],
    )


def _usage(motion: _Motion, rate: Array, change: Array, spent: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Share of the time (3, 7) in which each limit is active, and whether it is so in each cell (G - 1, 3, 7)."""
    plant = motion.plant
    at_ends = np.zeros((2, len(spent), 3, N_JOINTS))
    for i, points in enumerate((slice(None, -1), slice(1, None))):
        at_ends[i, :, 0] = motion.v[points] * rate[points, None] / plant.velocity_limits
        a = motion.a[points] * rate[points, None] ** 2 + motion.v[points] * change[:, None]
        if plant.acceleration_limits is not None:
            at_ends[i, :, 1] = a / plant.acceleration_limits
        if i == 0:  # torques cost most: once a cell
            v = motion.v * rate[:, None]
            torque = np.array([plant.torque(motion.q[k], v[k], a[k]) for k in range(len(spent))])
            at_ends[:, :, 2] = torque / plant.effort_limits
    active = np.abs(at_ends) >= ACTIVE
    return np.einsum("k,ikcj->cj", 0.5 * spent / spent.sum(), active), np.asarray(active.any(axis=0))


def _explain(motion: _Motion) -> TimeScale:
    """Why no timing keeps the limits: a posture that the motors cannot hold, else a speed at one of the ends."""
    joints, last = motion.plant.robot.joints, len(motion.grid) - 1
    weight = np.array([motion.ratios(k, 0.0, 0.0)[2] for k in range(last + 1)])
    heaviest, j = np.unravel_index(np.argmax(np.abs(weight)), weight.shape)
    if abs(weight[heaviest, j]) > 1.0:
        text = f"{joints[j]} cannot hold the arm's weight ({abs(weight[heaviest, j]):.2f} x its torque limit)"
        return _nothing(text, TimingConstraint.TORQUE, joints[j], motion.frame(int(heaviest)))
    end = _broken_end(motion)
    if end is not None:
        return end
    own = np.abs([motion.ratios(k, 1.0, 0.0) for k in range(last + 1)])
    broken = np.flatnonzero(own.max(axis=(1, 2)) > 1.0)
    if len(broken) == 0:
        return _nothing("Toppra found no solution, though the path's own timing keeps the limits on the grid")
    starts = (
        motion.fastest(1.0, 0.0, _STRETCHES[:2]) is not None
    )  # then it is the last frame's speed that cannot be reached
    k = int(broken[-1] if starts else broken[0])
    c, j = np.unravel_index(np.argmax(own[k]), own[k].shape)
    kind = tuple(TimingConstraint)[c]
    text = (
        f"the speed of the {'last' if starts else 'first'} frame cannot be "
        f"{'reached' if starts else 'braked'} in time: {joints[j]} is beyond its {kind.value} limit near it"
    )
    return _nothing(text, kind, joints[j], motion.frame(k))


def _broken_end(motion: _Motion) -> TimeScale | None:
    """The limit that the own speed breaks in the first or the last frame, whatever d2s/dt2 is there; None if none."""
    for index, end in ((0, "first"), (len(motion.grid) - 1, "last")):
        ratio = _least_ratios(motion, index)
        c, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        if ratio[c, j] > 1.0:
            kind, joint = tuple(TimingConstraint)[c], motion.plant.robot.joints[j]
            text = f"at its speed in the {end} frame {joint} is beyond its {kind.value} limit ({ratio[c, j]:.2f} x)"
            return _nothing(text, kind, joint, motion.frame(index))
    return None


def _least_ratios(motion: _Motion, index: int) -> Array:
    """|Ratios| (3, 7) at a grid point at the path's own speed, with the d2s/dt2 that makes their greatest least."""
    fixed = motion.ratios(index, 1.0, 0.0)
    slope = motion.ratios(index, 1.0, 1.0) - fixed
    # The greatest of |fixed + slope x| is convex and piecewise linear in x: its least is where two of its lines cross.
    level = np.concatenate([fixed.ravel(), -fixed.ravel()])
    incline = np.concatenate([slope.ravel(), -slope.ravel()])
    rise = incline[:, None] - incline
    x = np.divide(level - level[:, None], rise, out=np.zeros_like(rise), where=np.abs(rise) > 1e-12).ravel()
    worst = np.max(level + x[:, None] * incline, axis=-1)
    return np.asarray(np.abs(fixed + slope * x[np.argmin(worst)]))
