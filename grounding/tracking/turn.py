"""Turn of the last joint along a video, from the likelihood of each turn in each frame and its changes between frames.

A hidden Markov model whose state is the turn on a grid: the likeliest path (Viterbi) and its uncertainty
(forward-backward), as in Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77(2), 1989. Where the change
between two frames is measured, both vote for the same turn, up to the error of that change.
"""

import numpy as np
from scipy.special import logsumexp

from kinebench_drake.geometry import Array

TURNS_RAD = np.deg2rad(np.arange(-170.0, 171.0, 10.0))
"""Turns over the range of the joint [rad]."""
OFFSETS_RAD = np.deg2rad(np.arange(-15.0, 15.1, 3.0))
"""Offsets from turns that are known roughly [rad]."""
_STATES = 5  # states from one turn of the grid to the next
_STEP_RAD = np.deg2rad(8.0)  # standard deviation of a step from frame to frame, and of a change that is measured badly
_CHANGE_RAD, _BADLY = np.deg2rad(1.5), 0.1  # standard deviation of a measured change, and share of the bad ones


def likeliest_turns(grid_rad: Array, log_likelihood: Array, change_rad: Array) -> tuple[Array, Array]:
    """Return the turns (T,) that are likeliest together, and their standard deviations (T,) [rad].

    Args:
        grid_rad: (M,) turns at equal steps [rad]; between them likelihoods are interpolated.
        log_likelihood: (T, M) of each turn in each frame; 0 where nothing is known.
        change_rad: (T - 1,) measured changes of the turn from each frame to the next [rad]; NaN where there is none.
    """
    state = np.linspace(grid_rad[0], grid_rad[-1], _STATES * (len(grid_rad) - 1) + 1)
    own = np.array([np.interp(state, grid_rad, row) for row in log_likelihood])
    steps = [_step(state, change) for change in change_rad]
    best, origins = own[0], []
    for step, row in zip(steps, own[1:], strict=True):
        reached = best + step
        origins.append(reached.argmax(axis=1))
        best = reached.max(axis=1) + row
    path = [int(best.argmax())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    turns = state[path[::-1]]
    posterior = _forward(own, steps) + _forward(own[::-1], [step.T for step in reversed(steps)])[::-1] - own
    probability = np.exp(posterior - logsumexp(posterior, axis=1, keepdims=True))
    return turns, np.sqrt((probability * (state - turns[:, None]) ** 2).sum(axis=1))


def _step(state: Array, change_rad: float) -> Array:
    """Return the log-probability of each state (rows) after each other (columns), up to a constant."""
    moved = state[:, None] - state
    if not np.isfinite(change_rad):
        return np.asarray(_log_normal(moved, _STEP_RAD))
    error = moved - change_rad
    good, bad = np.log(1.0 - _BADLY) + _log_normal(error, _CHANGE_RAD), np.log(_BADLY) + _log_normal(error, _STEP_RAD)
    return np.asarray(np.logaddexp(good, bad))


def _log_normal(error: Array, sigma: float) -> Array:
    return np.asarray(-0.5 * (error / sigma) ** 2 - np.log(sigma))


def _forward(own: Array, steps: list[Array]) -> Array:
    """Return the log-likelihoods (T, M) of the states given all frames up to each."""
    forward = [own[0]]
    for step, row in zip(steps, own[1:], strict=True):
        forward.append(row + logsumexp(forward[-1] + step, axis=1))
    return np.array(forward)
