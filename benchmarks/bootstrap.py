"""Intervals of statistics of groups of frames or videos."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from kinebench_drake.stats import IntervalEstimate, percentile_interval, resampled_indices

RESAMPLES = 400
Group = TypeVar("Group")


def cluster_bootstrap(
    groups: Sequence[Group], statistic: Callable[[Sequence[Group]], float], seed: int = 0
) -> IntervalEstimate:
    """Return a statistic of groups with its 95 % percentile interval over resamples of whole groups.

    Values within a group are correlated (Efron and Tibshirani 1993, chapter 8). The interval is NaN for fewer than two
    groups.
    """
    parts = resampled_indices(len(groups), np.random.default_rng(seed), RESAMPLES if len(groups) > 1 else 0)
    low, high = percentile_interval([statistic([groups[i] for i in drawn]) for part in parts for drawn in part])
    return IntervalEstimate(value=statistic(groups), low=low, high=high)
