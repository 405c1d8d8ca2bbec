"""Means in which every task counts the same."""

from collections.abc import Mapping, Sequence

import numpy as np

from kinebench_drake.aggregate import CONFIDENCE, Estimate

RESAMPLES = 2000


def balanced(groups: Mapping[str, Sequence[float | None]], *, seed: int = 0) -> Estimate:
    """Mean over tasks of the mean over each task's episodes, with a percentile bootstrap interval.

    m = 1/T sum_t 1/n_t sum_i x_ti over the tasks that have a value. Each of 2000 resamples draws as many episodes as
    there are within every task, with replacement (Efron and Tibshirani, An Introduction to the Bootstrap, 1993,
    chapters 8 and 13): the tasks themselves are fixed, and the interval tells what other episodes of the same tasks
    might have given.

    Args:
        groups: values of each task's episodes; None where there is none. Of a single task it is the plain mean.
        seed: of the resampling.

    Returns:
        No interval where a task has but one value, or where resampling changes nothing: what has no spread shows
        none, which is not to say that there is none.
    """
    total = sum(len(values) for values in groups.values())
    known = [np.array([v for v in values if v is not None], dtype=np.float64) for values in groups.values()]
    known = [values for values in known if len(values)]
    if not known:
        return Estimate(mean=None, low=None, high=None, n=0, total=total)
    n, mean = sum(map(len, known)), float(np.mean([values.mean() for values in known]))
    nothing = Estimate(mean=mean, low=None, high=None, n=n, total=total)
    if min(map(len, known)) < 2:
        return nothing
    rng = np.random.default_rng(seed)
    means = np.mean([v[rng.integers(len(v), size=(RESAMPLES, len(v)))].mean(axis=1) for v in known], axis=0)
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = (float(v) for v in np.percentile(means, [tail, 100.0 - tail]))
    return nothing if high - low < 1e-12 else Estimate(mean=mean, low=low, high=high, n=n, total=total)


def tasks_counted(groups: Mapping[str, Sequence[float | None]]) -> int:
    """Tasks that have a value."""
    return sum(any(v is not None for v in values) for values in groups.values())
