"""Time-optimal path parameterization by reachability analysis, in NumPy.

The method of Drake's Toppra (H. Pham and Q.-C. Pham, "A New Approach to Time-Optimal Path Parameterization Based on
Reachability Analysis", IEEE Trans. Robot. 34, 2018), which solves three linear programs in two variables in every cell
of the grid. Here their optimum is found along lines, exactly and without a solver.
"""

from dataclasses import dataclass

import numpy as np

from kinebench_drake.geometry import Array

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
