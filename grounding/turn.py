"""Turn of the last joint along a video, from the likelihood of each turn in each frame.

A hidden Markov model whose state is the turn on a grid, and whose steps are Gaussian: the likeliest path (Viterbi) and
its uncertainty (forward-backward), as in Rabiner, "A tutorial on hidden Markov models", Proc. IEEE 77(2), 1989.
"""

import numpy as np
from scipy.special import logsumexp

from kinebench_drake.geometry import Array

TURNS_RAD = np.deg2rad(np.arange(-170.0, 171.0, 10.0))
"""(M,) turns of the grid, which covers the range of the joint [rad]."""
_STEP_RAD = np.deg2rad(8.0)  # standard deviation of a step from frame to frame


def likeliest_turns(log_likelihood: Array) -> tuple[Array, Array]:
    """Return the turns (T,) that are likeliest together, and their standard deviations (T,) [rad].

    Args:
        log_likelihood: (T, M) of each turn of the grid in each frame; 0 where nothing is known.
    """
    step = -0.5 * ((TURNS_RAD[:, None] - TURNS_RAD) / _STEP_RAD) ** 2
    best, origins = log_likelihood[0], []
    for own in log_likelihood[1:]:
        reached = best + step
        origins.append(reached.argmax(axis=1))
        best = reached.max(axis=1) + own
    path = [int(best.argmax())]
    for origin in reversed(origins):
        path.append(int(origin[path[-1]]))
    turns = TURNS_RAD[path[::-1]]
    posterior = _forward(log_likelihood, step) + _forward(log_likelihood[::-1], step)[::-1] - log_likelihood
    probability = np.exp(posterior - logsumexp(posterior, axis=1, keepdims=True))
    return turns, np.sqrt((probability * (TURNS_RAD - turns[:, None]) ** 2).sum(axis=1))


def _forward(log_likelihood: Array, step: Array) -> Array:
    """Return the log-likelihoods (T, M) of the turns given all frames up to each."""
    forward = [log_likelihood[0]]
    for own in log_likelihood[1:]:
        forward.append(own + logsumexp(forward[-1] + step, axis=1))
    return np.array(forward)
