"""What recorders do to the rows of a trajectory: states that are held, rows before the first state, wrapped angles.

None of it is motion: a log at 60 Hz of a state at 20 Hz would stop and start in every frame. (Rounded values are noise:
`metrics.noise`.)
"""

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.geometry import Array
from kinebench_drake.segments import finite_rows

MOST_HELD = 20
"""Most rows for which a recorder holds one state of a moving arm: a 1,000 Hz log of a state at 50 Hz."""
LEAST_HELD_RUNS = 3
"""Fewest states that a recorder held; fewer may be an arm that stopped for a frame."""
LEAST_HELD_SHARE = 0.1
"""Least share of the states of a moving arm that are held."""
LIKE_STEPS = 0.25
"""Least ratio of the steps before and after a held state: an arm that stops slows down before."""
LEAST_UNITS = 3.0
"""Least step before and after a held state, in least steps of a column: rounding alone repeats rows of slow motions."""
EMPTY_JUMP = 0.1
"""Least jump [rad or m] between a row of zeros and its neighbour, if the row was never filled."""
WRAP_SLACK_RAD = 0.5
"""Greatest distance of a jump of an angle from a full turn that is taken for a wrapped angle [rad]."""


@np.errstate(over="ignore", invalid="ignore")
def find_held(values: Array) -> NDArray[np.bool_]:
    """Return the mask (T,) of rows that repeat a held state: all but its first row.

    A state is held if the rows are equal although the arm moves: the steps into it and out of it are alike. Where
    most states are held for about the same number of rows, an arm at rest keeps one row of as many.

    Args:
        values: (T, N) finite numbers.
    """
    rows = len(values)
    repeated = np.zeros(rows, dtype=bool)
    if rows < 2:
        return repeated
    change = np.abs(np.diff(values, axis=0))
    step = change.max(axis=1)
    units = (change / np.where(change > 0.0, change, np.inf).min(axis=0)).max(axis=1)
    starts = np.concatenate([[0], np.flatnonzero(step > 0.0) + 1])
    lengths = np.diff(np.append(starts, rows))
    if len(starts) < LEAST_HELD_RUNS + 2:
        return repeated
    before = starts[1:-1] - 1
    after = starts[2:] - 1
    inner = lengths[1:-1]
    alike = np.minimum(step[before], step[after]) >= LIKE_STEPS * np.maximum(step[before], step[after])
    alike &= np.minimum(units[before], units[after]) >= LEAST_UNITS
    moving = alike & (inner <= MOST_HELD)
    repeats = moving & (inner > 1)
    if repeats.sum() < max(LEAST_HELD_RUNS, LEAST_HELD_SHARE * moving.sum()):
        return repeated
    usual = int(np.median(inner[moving]))
    for start, length, is_held in zip(starts, lengths, [False, *repeats, False], strict=True):
        keep_every = length if is_held else max(usual, 1)
        own = np.arange(length)
        repeated[start : start + length] = own % keep_every != 0
    return repeated


def find_empty(values: Array) -> NDArray[np.bool_]:
    """Return the mask (T,) of rows that were never filled: all numbers are 0, and a neighbour's are far from it."""
    zero = (values == 0.0).all(axis=1)
    if not zero.any() or zero.all():
        return np.zeros(len(values), dtype=bool)
    filled = np.flatnonzero(~zero)
    after = filled[np.minimum(np.searchsorted(filled, np.arange(len(values))), len(filled) - 1)]
    before = filled[np.maximum(np.searchsorted(filled, np.arange(len(values)), side="right") - 1, 0)]
    nearest = np.minimum(np.abs(values[after]).max(axis=1), np.abs(values[before]).max(axis=1))
    return np.asarray(zero & (nearest > EMPTY_JUMP))


@np.errstate(over="ignore", invalid="ignore")
def unwrap(q: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return joint angles (T, N) [rad] without jumps of about a full turn, and which joints (N,) had some.

    Rows of NaN are passed over.
    """
    frames = np.flatnonzero(finite_rows(q))
    steps = np.diff(q[frames], axis=0)
    turns = np.round(steps / (2.0 * np.pi))
    turns[np.abs(steps - 2.0 * np.pi * turns) > WRAP_SLACK_RAD] = 0.0
    continuous = q.copy()
    continuous[frames[1:]] -= 2.0 * np.pi * np.cumsum(turns, axis=0)
    return continuous, np.asarray(turns.any(axis=0))
