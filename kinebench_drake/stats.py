"""Statistics: intervals of shares and means, resampling, and paired comparisons."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array

CONFIDENCE = 0.95
"""Level of every interval in results and reports."""
PERCENTILES = (50.0 * (1.0 - CONFIDENCE), 50.0 * (1.0 + CONFIDENCE))
"""Percentiles of a bootstrap distribution at the ends of its interval."""
RESAMPLES = 2000
_AT_ONCE = 2_000_000  # numbers drawn at a time: all at once would take 1 GB for 20,000 samples


@dataclass(frozen=True, slots=True, kw_only=True)
class IntervalEstimate:
    """Figure with the ends of its 95 % interval; NaN where there is none."""

    value: float
    low: float
    high: float


def wilson(hits: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the ends of the score interval of the share hits / n (Wilson, JASA 22, 1927); (0, 1) for n = 0."""
    if n == 0:
        return 0.0, 1.0
    from scipy.stats import binomtest

    bounds = binomtest(hits, n).proportion_ci(confidence_level=confidence, method="wilson")
    return float(bounds.low), float(bounds.high)


def bootstrap_mean(values: Array, rng: np.random.Generator, resamples: int = RESAMPLES) -> tuple[float, float]:
    """Return the ends of the percentile bootstrap interval of the mean of `values` (N,), N > 1 (Efron 1979)."""
    from scipy.stats import bootstrap

    result = bootstrap(
        (values,),
        np.mean,
        n_resamples=resamples,
        batch=max(1, _AT_ONCE // len(values)),
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=rng,
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def percentile_interval(draws: ArrayLike, percentiles: tuple[float, float] = PERCENTILES) -> tuple[float, float]:
    """Return the ends of the percentile interval of a bootstrap distribution (Efron, Ann. Statist. 7, 1979).

    Args:
        draws: (D,) the statistic of each resample; those not finite are left out.
        percentiles: of the draws, at the lower and upper end.

    Returns:
        NaN twice if no draw is finite.
    """
    values = np.asarray(draws, dtype=np.float64)
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, percentiles) if values.size else (np.nan, np.nan)
    return float(low), float(high)


def resampled_indices(n: int, rng: np.random.Generator, resamples: int = RESAMPLES) -> Iterator[NDArray[np.int64]]:
    """Yield resamples of n units with replacement, in parts (D, n) of bounded memory that do not change the draws."""
    part = max(1, _AT_ONCE // max(n, 1))
    for start in range(0, resamples, part):
        yield rng.integers(n, size=(min(part, resamples - start), n))


def resampled_means(values: Array, rng: np.random.Generator, resamples: int = RESAMPLES) -> Array:
    """Return the means (resamples,) of resamples of `values` (N,) with replacement."""
    return np.concatenate([values[drawn].mean(axis=1) for drawn in resampled_indices(len(values), rng, resamples)])


def resampled_counts(n: int, rng: np.random.Generator, resamples: int = RESAMPLES) -> Array:
    """Return how often each of n units occurs in each resample with replacement (resamples, n)."""
    return rng.multinomial(n, np.full(n, 1.0 / n), size=resamples).astype(np.float64)


def paired_mean_difference(first: Array, second: Array, rng: np.random.Generator) -> IntervalEstimate:
    """Return the mean of first - second (N,) over the same units with its paired bootstrap interval (Efron 1979).

    Units are resampled with both their values. There is no interval for fewer than two units, or where all differences
    are equal: zero spread within the sample does not mean zero uncertainty.

    Raises:
        InputError: the arrays differ in length, or are empty.
    """
    if len(first) != len(second) or len(first) == 0:
        raise InputError(f"{len(first)} values cannot be paired with {len(second)}")
    differences = np.asarray(first, dtype=np.float64) - np.asarray(second, dtype=np.float64)
    ends = (np.nan, np.nan) if np.ptp(differences) < 1e-12 else bootstrap_mean(differences, rng)
    return IntervalEstimate(value=float(differences.mean()), low=ends[0], high=ends[1])


def independent_mean_difference(first: Array, second: Array, rng: np.random.Generator) -> IntervalEstimate:
    """Return the difference of the means of first (N,) and second (M,), of independent units, with its 95 % interval.

    Of outcomes 0 and 1 it is that of Newcombe (Stat. Med. 17, 1998, pp. 873-890, method 10), which combines the Wilson
    intervals of both shares; else the percentile bootstrap interval, none if a group has fewer than two units or
    resampling changes nothing.

    Raises:
        InputError: a group is empty.
    """
    if min(len(first), len(second)) == 0:
        raise InputError("a group without units has no mean to compare")
    a, b = (np.asarray(values, dtype=np.float64) for values in (first, second))
    value = float(a.mean() - b.mean())
    if np.isin(a, (0.0, 1.0)).all() and np.isin(b, (0.0, 1.0)).all():
        (p, p_low, p_high), (q, q_low, q_high) = (
            (float(own.mean()), *wilson(int(own.sum()), len(own))) for own in (a, b)
        )
        low, high = np.hypot(p - p_low, q_high - q), np.hypot(p_high - p, q - q_low)
        return IntervalEstimate(value=value, low=max(-1.0, value - float(low)), high=min(1.0, value + float(high)))
    low, high = np.nan, np.nan
    if min(len(a), len(b)) > 1:
        draws = resampled_means(a, rng) - resampled_means(b, rng)
        low, high = percentile_interval(draws) if np.ptp(draws) > 1e-12 else (np.nan, np.nan)
    return IntervalEstimate(value=value, low=low, high=high)


def sign_test(first: int, second: int) -> float:
    """Return the two-sided p-value of the exact sign test: units in which the first, and the second, is better."""
    from scipy.stats import binomtest

    return float(binomtest(first, first + second).pvalue) if first + second else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedOutcomes:
    """Counts of episodes by the outcomes of two groups, such as two models on the same episodes."""

    both: int
    """Episodes in which both succeed."""
    first_only: int
    second_only: int
    neither: int

    def __post_init__(self) -> None:
        """Check the counts.

        Raises:
            InputError: there is no pair, or a count is negative.
        """
        if min(self.both, self.first_only, self.second_only, self.neither) < 0 or self.n == 0:
            raise InputError("no episodes in common: there is nothing to compare")

    @classmethod
    def of(cls, first: Sequence[bool], second: Sequence[bool]) -> "PairedOutcomes":
        """Count the outcomes of the same episodes in the same order.

        Raises:
            InputError: the sequences differ in length, or are empty.
        """
        if len(first) != len(second):
            raise InputError(f"{len(first)} outcomes cannot be paired with {len(second)}")
        a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
        return cls(
            both=int((a & b).sum()),
            first_only=int((a & ~b).sum()),
            second_only=int((~a & b).sum()),
            neither=int((~a & ~b).sum()),
        )

    @property
    def n(self) -> int:
        """Number of episodes."""
        return self.both + self.first_only + self.second_only + self.neither

    @property
    def difference(self) -> float:
        """Difference of the success rates, first minus second."""
        return (self.first_only - self.second_only) / self.n

    @property
    def p_value(self) -> float:
        """Two-sided p-value of the exact test of McNemar (Psychometrika 12, 1947) on the discordant pairs."""
        return sign_test(self.first_only, self.second_only)

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of the difference: method 10 of Newcombe (Stat. Med. 17, 1998, pp. 2635-2650).

        The Wilson intervals of both rates are combined with the correlation of the outcomes.
        """
        first, second = (self.both + self.first_only, self.both + self.second_only)
        (p_1, l_1, u_1), (p_2, l_2, u_2) = ((hits / self.n, *wilson(hits, self.n)) for hits in (first, second))
        phi, d = self._correlation(), self.difference
        low = (p_1 - l_1) ** 2 - 2.0 * phi * (p_1 - l_1) * (u_2 - p_2) + (u_2 - p_2) ** 2
        high = (u_1 - p_1) ** 2 - 2.0 * phi * (u_1 - p_1) * (p_2 - l_2) + (p_2 - l_2) ** 2
        return max(-1.0, d - float(np.sqrt(max(low, 0.0)))), min(1.0, d + float(np.sqrt(max(high, 0.0))))

    def _correlation(self) -> float:
        """Return the phi coefficient, with Newcombe's continuity correction where it is positive."""
        a, b, c, d = self.both, self.first_only, self.second_only, self.neither
        product = (a + b) * (c + d) * (a + c) * (b + d)
        if product == 0:
            return 0.0
        determinant = a * d - b * c
        corrected = max(determinant - self.n / 2.0, 0.0) if determinant > 0 else float(determinant)
        return float(corrected / np.sqrt(product))
