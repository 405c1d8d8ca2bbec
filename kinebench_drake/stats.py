"""Statistics: intervals of shares and means, resampling, and paired comparisons."""

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
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
"""Resamples of a bootstrap distribution."""
MANY = 1000
"""Number of values up to which a mean is resampled value by value."""
_EXTREME = 30
"""Values drawn one by one of more than MANY: no other differs from the mean by more than 0.18 sqrt(N) deviations."""
# Numbers drawn at a time: all at once would take 1 GB for 20,000 samples.
_AT_ONCE = 2_000_000


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


def bootstrap_mean(values: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Return the ends of the percentile bootstrap interval of the mean of `values` (N,), N > 1 (Efron 1979).

    Of more than MANY values only the extreme ones are resampled one by one (`_means_of_many`).
    """
    draw = _means_of_many if len(values) > MANY else resampled_means
    return percentile_interval(draw(values, rng))


def _means_of_many(values: Array, rng: np.random.Generator) -> Array:
    """Draw means (RESAMPLES,) of resamples of many values (N,), in a time that does not grow with their number.

    The values farthest from the mean are drawn one by one; the sum of the others, of which no single one matters, has
    its normal limit (Bickel and Freedman, Ann. Statist. 9, 1981, theorem 2.1).
    """
    n = len(values)
    order = np.argsort(np.abs(values - values.mean()), kind="stable")
    middle = values[order[:-_EXTREME]]
    extreme = values[order[-_EXTREME:]]
    counts = rng.multinomial(n, [*[1.0 / n] * _EXTREME, 1.0 - _EXTREME / n], size=RESAMPLES)
    of_middle = counts[:, -1]
    sums = of_middle * middle.mean() + np.sqrt(of_middle) * middle.std() * rng.standard_normal(RESAMPLES)
    return np.asarray((counts[:, :-1] @ extreme + sums) / n)


def percentile_interval(draws: ArrayLike) -> tuple[float, float]:
    """Return the ends of the percentile interval of a bootstrap distribution (Efron, Ann. Statist. 7, 1979).

    Values of the statistic `draws` (D,) that are not finite are left out; NaN twice if none is finite.
    """
    values = np.asarray(draws, dtype=np.float64)
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, PERCENTILES) if values.size else (np.nan, np.nan)
    return float(low), float(high)


def resampled_indices(n: int, rng: np.random.Generator, resamples: int = RESAMPLES) -> Iterator[NDArray[np.int64]]:
    """Yield resamples of n units with replacement, in parts (D, n) of bounded memory that do not change the draws."""
    part = max(1, _AT_ONCE // max(n, 1))
    for start in range(0, resamples, part):
        yield rng.integers(n, size=(min(part, resamples - start), n))


def resampled_means(values: Array, rng: np.random.Generator) -> Array:
    """Return the means (RESAMPLES,) of resamples of `values` (N,) with replacement."""
    return np.concatenate([values[drawn].mean(axis=1) for drawn in resampled_indices(len(values), rng)])


def resampled_counts(n: int, rng: np.random.Generator) -> Array:
    """Return how often each of n units occurs in each resample with replacement (RESAMPLES, n)."""
    return rng.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES).astype(np.float64)


def group_means(values: Sequence[float], groups: Sequence[Hashable]) -> Array:
    """Return the mean of the values of each group, such as the samples of an episode, in order of first occurrence."""
    members: dict[Hashable, list[float]] = {}
    for value, group in zip(values, groups, strict=True):
        members.setdefault(group, []).append(value)
    return np.array([math.fsum(own) / len(own) for own in members.values()])


def share_interval(shares: Array, rng: np.random.Generator) -> tuple[float, float]:
    """Return the ends of the interval of the mean success of episodes, from the `shares` (N,) of their samples, 0..1.

    Episodes whose samples all agree are single outcomes: Wilson's interval. Otherwise episodes are resampled with all
    their samples (cluster bootstrap; Davison and Hinkley, Bootstrap Methods and their Application, 1997, section 3.8).
    If all shares are equal it is Wilson's for as many samples as there are episodes.
    """
    n = len(shares)
    hits = math.fsum(shares)
    if np.isin(shares, (0.0, 1.0)).all():
        return wilson(round(hits), n)
    if np.ptp(shares) < 1e-12:
        return wilson(math.floor(hits), n)[0], wilson(math.ceil(hits), n)[1]
    return bootstrap_mean(shares, rng)


def pass_at_k(hits: int, n: int, k: int) -> float:
    """Return the unbiased estimate of the probability that one of k samples succeeds, from `hits` among n samples.

    1 - C(n - c, k) / C(n, k): Chen et al., Evaluating Large Language Models Trained on Code, 2021, arXiv:2107.03374,
    equation 1.

    Raises:
        InputError: there are fewer than k samples, or more hits than samples.
    """
    if not (1 <= k <= n and 0 <= hits <= n):
        raise InputError(f"pass@{k} of {hits} successes among {n} samples, expected 1 <= k <= samples")
    return 1.0 - math.comb(n - hits, k) / math.comb(n, k)


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
        low = np.hypot(p - p_low, q_high - q)
        high = np.hypot(p_high - p, q - q_low)
        return IntervalEstimate(value=value, low=max(-1.0, value - float(low)), high=min(1.0, value + float(high)))
    low = np.nan
    high = np.nan
    if min(len(a), len(b)) > 1:
        draws = resampled_means(a, rng) - resampled_means(b, rng)
        low, high = percentile_interval(draws) if np.ptp(draws) > 1e-12 else (np.nan, np.nan)
    return IntervalEstimate(value=value, low=low, high=high)


def adjust_p_values(p_values: Mapping[str, float]) -> dict[str, float]:
    """Return p-values by name, adjusted for their number as Benjamini and Hochberg (J. R. Statist. Soc. B 57, 1995)."""
    from scipy.stats import false_discovery_control

    adjusted = false_discovery_control(list(p_values.values())) if p_values else []
    return {name: float(p) for name, p in zip(p_values, adjusted, strict=True)}


def sign_test(first: int, second: int) -> float:
    """Return the two-sided p-value of the exact sign test: units in which the first, and the second, is better."""
    from scipy.stats import binomtest

    return float(binomtest(first, first + second).pvalue) if first + second else 1.0


_RESOLUTION = 2520
"""Steps of a share in `sign_flip_test`: exact for up to 10 samples."""


def sign_flip_test(differences: Array) -> float:
    """Return the two-sided p-value of the exact randomization test of paired differences (N,), each in -1..1.

    If the two groups are alike, the sign of each difference is random: the distribution of the sum over all 2^N signs,
    by convolution (Fisher, The Design of Experiments, 1935, section 21). For single outcomes it is McNemar's exact
    test. Differences are rounded to multiples of 1 / 2520.
    """
    steps = np.rint(_RESOLUTION * np.asarray(differences, dtype=np.float64)).astype(np.int64)
    steps = steps[steps != 0]
    if not len(steps):
        return 1.0
    steps //= np.gcd.reduce(steps)
    probability = np.ones(1)  # of the sums -total, -total + 1, ..., total
    for step in np.abs(steps).tolist():
        wider = np.zeros(len(probability) + 2 * step)
        wider[: len(probability)] += 0.5 * probability
        wider[2 * step :] += 0.5 * probability
        probability = wider
    middle = len(probability) // 2
    observed = abs(int(steps.sum()))
    return min(1.0, float(probability[: middle - observed + 1].sum() + probability[middle + observed :].sum()))


def paired_share_interval(first: Array, second: Array) -> tuple[float, float]:
    """Return the 95 % interval of the difference of the shares of outcomes 0 or 1 (N,) of the same units.

    Method 10 of Newcombe (Stat. Med. 17, 1998, pp. 2635-2650): the Wilson intervals of both shares, combined with the
    phi coefficient of the outcomes, with his continuity correction where it is positive.
    """
    n = len(first)
    hits_1 = int(first.sum())
    hits_2 = int(second.sum())
    both = int(first @ second)
    (p_1, l_1, u_1), (p_2, l_2, u_2) = ((hits / n, *wilson(hits, n)) for hits in (hits_1, hits_2))
    product = hits_1 * (n - hits_1) * hits_2 * (n - hits_2)
    determinant = both * n - hits_1 * hits_2
    corrected = max(determinant - n / 2.0, 0.0) if determinant > 0 else float(determinant)
    phi = float(corrected / np.sqrt(product)) if product else 0.0
    d = (hits_1 - hits_2) / n
    low = (p_1 - l_1) ** 2 - 2.0 * phi * (p_1 - l_1) * (u_2 - p_2) + (u_2 - p_2) ** 2
    high = (u_1 - p_1) ** 2 - 2.0 * phi * (u_1 - p_1) * (p_2 - l_2) + (p_2 - l_2) ** 2
    return max(-1.0, d - float(np.sqrt(max(low, 0.0)))), min(1.0, d + float(np.sqrt(max(high, 0.0))))


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedShares:
    """Success of two groups, such as two models, in the same episodes, with one or several samples each."""

    first: Array
    """(N,) share of successes among the samples of each episode, of the first group, 0..1."""
    second: Array
    """(N,) of the second group."""
    samples: int = 1
    """Most samples of an episode."""

    def __post_init__(self) -> None:
        """Check the shares.

        Raises:
            InputError: they differ in number, or there are none.
        """
        if len(self.first) != len(self.second) or len(self.first) == 0:
            raise InputError(f"{len(self.first)} and {len(self.second)} episodes: there is nothing to compare")

    @property
    def n(self) -> int:
        """Number of episodes."""
        return len(self.first)

    @property
    def rates(self) -> tuple[float, float]:
        """Mean success of the first and of the second group."""
        return math.fsum(self.first) / self.n, math.fsum(self.second) / self.n

    @property
    def difference(self) -> float:
        """Difference of the rates, first minus second."""
        return math.fsum(self.first - self.second) / self.n

    def ratio(self) -> IntervalEstimate:
        """Return the ratio of the rates, first over second, with its paired bootstrap interval over episodes.

        NaN where the second rate is 0; no interval where all resamples have the same ratio.
        """
        sums = resampled_counts(self.n, np.random.default_rng(0)) @ np.stack([self.first, self.second], axis=1)
        draws = sums[sums[:, 1] > 0.0]
        low, high = percentile_interval(draws[:, 0] / draws[:, 1])
        one, other = self.rates
        ends = (low, high) if other and high - low > 1e-12 else (np.nan, np.nan)
        return IntervalEstimate(value=one / other if other else np.nan, low=ends[0], high=ends[1])

    @property
    def better(self) -> tuple[int, int]:
        """Episodes in which the first, and in which the second, succeeds more often."""
        return int((self.first > self.second).sum()), int((self.first < self.second).sum())

    @property
    def p_value(self) -> float:
        """Two-sided p-value.

        Of single outcomes the exact test of McNemar (Psychometrika 12, 1947), else `sign_flip_test`.
        """
        return sign_test(*self.better) if self._are_outcomes else sign_flip_test(self.first - self.second)

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of the difference.

        Newcombe's of single outcomes, else the paired bootstrap over episodes; (-1, 1) if all differences are equal.
        """
        if self._are_outcomes:
            return paired_share_interval(self.first, self.second)
        value = paired_mean_difference(self.first, self.second, np.random.default_rng(0))
        return (-1.0, 1.0) if math.isnan(value.low) else (value.low, value.high)

    @property
    def _are_outcomes(self) -> bool:
        """True if each share is 0 or 1, as those of single samples are."""
        return bool(np.isin((self.first, self.second), (0.0, 1.0)).all())
