"""Power of comparisons of success rates: episodes that show a difference, and the least difference that runs show."""

import math
from dataclasses import dataclass

from kinebench_drake.errors import UsageError
from kinebench_drake.stats import CONFIDENCE, PairedShares

POWER = 0.8
"""Probability with which a difference should be detected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PowerDesign:
    """Assumptions about two models whose success rates are compared."""

    success: float
    """Success rate of one model, 0..1."""
    difference: float
    """Success rate of the other model minus `success`, not 0."""
    samples: int = 1
    """Samples of each episode."""
    correlation: float = 0.0
    """Correlation of the outcomes of the two models in the same episode, one sample each."""
    icc: float = 0.5
    """Correlation of two samples of one model in the same episode (intraclass correlation)."""
    power: float = POWER
    """Probability of a p-value below 0.05 (two-sided) if the difference is true."""

    def __post_init__(self) -> None:
        """Check that there are two models with these properties.

        Raises:
            UsageError: there are not.
        """
        p = self.success
        q = self.success + self.difference
        if not 0.0 <= p <= 1.0:
            raise UsageError(f"$success is {100 * p:g}, expected 0 to 100 [%]")
        if self.difference == 0.0 or not -1e-9 <= q <= 1.0 + 1e-9:
            raise UsageError(
                f"$difference is {100 * self.difference:g}, which takes $success {100 * p:g} to {100 * q:g}; "
                f"expected {-100 * p:g} to {100 * (1 - p):g} points and not 0"
            )
        if not 0.0 <= self.icc <= 1.0:
            raise UsageError(f"$icc is {self.icc:g}, expected 0 to 1")
        if not 0.5 <= self.power < 1.0:
            raise UsageError(f"$power is {100 * self.power:g}, expected at least 50 and less than 100 [%]")
        both = p * q + self.correlation * self._spread
        if not max(0.0, p + q - 1.0) - 1e-9 <= both <= min(p, q) + 1e-9:
            low, high = ((end - p * q) / self._spread for end in (max(0.0, p + q - 1.0), min(p, q)))
            raise UsageError(
                f"$correlation is {self.correlation:g}; success of {100 * p:g} and {100 * q:g} % allows "
                f"{low:.2g} to {high:.2g}"
            )
        if self.samples > 1 and abs(self.correlation) > self.icc:
            raise UsageError(
                f"$correlation is {self.correlation:g}: two models agree no more than two samples of one model, "
                f"$icc {self.icc:g}"
            )

    @property
    def _variances(self) -> tuple[float, float]:
        """Variances of a single outcome of the two models."""
        p = self.success
        q = self.success + self.difference
        return max(p * (1.0 - p), 0.0), max(q * (1.0 - q), 0.0)

    @property
    def _spread(self) -> float:
        """Product of the standard deviations of single outcomes."""
        return math.sqrt(self._variances[0] * self._variances[1])

    @property
    def _design_effect(self) -> float:
        """Variance of the mean of an episode's samples over that of one sample (Kish, Survey Sampling, 1965)."""
        return self.icc + (1.0 - self.icc) / self.samples

    def paired_episodes(self) -> int:
        """Return the episodes that both models need, compared episode by episode."""
        variance = sum(self._variances) * self._design_effect - 2.0 * self.correlation * self._spread
        return _paired(abs(self.difference), max(variance, 0.0), self.samples, self.power)

    def unpaired_episodes(self) -> int:
        """Return the episodes that each model needs, on different episodes.

        n = (z_a sqrt(2 p q) + z_b sqrt(p1 q1 + p2 q2))^2 / x^2 with the mean p of the two rates (Fleiss, Levin and
        Paik, Statistical Methods for Rates and Proportions, 3rd edition, 2003, equation 4.14), both variances times
        the design effect of the samples (Donner and Klar, Design and Analysis of Cluster Randomization Trials, 2000).
        """
        mean = self.success + self.difference / 2.0
        null, variance = (self._design_effect * total for total in (2.0 * mean * (1.0 - mean), sum(self._variances)))
        return _episodes(abs(self.difference), null, variance, self.samples, self.power)


def _paired(difference: float, variance: float, samples: int, power: float) -> int:
    """Return the number of paired episodes.

    n = (z_a sqrt(E D^2) + z_b sqrt(Var D))^2 / x^2 with the difference D of an episode, of mean x; of single samples
    E D^2 is the share of discordant episodes, and the formula Connor's (Biometrics 43, 1987). As D is a multiple of
    1 / samples, E D^2 is at least x / samples.
    """
    null = max(variance + difference**2, difference / samples)
    return _episodes(difference, null, null - difference**2, samples, power)


def _episodes(difference: float, null: float, variance: float, samples: int, power: float) -> int:
    """Return the number of episodes, with continuity correction for an exact test.

    Args:
        difference: true difference, above 0.
        null: variance of an episode's difference if there is no true one.
        samples: samples of each episode: their number sets the steps of the test statistic, 2 / samples.

    n' = n / 4 (1 + sqrt(1 + 4 / (n x K)))^2 (Casagrande, Pike and Smith, Biometrics 34, 1978, for K = 1).
    """
    from scipy.stats import norm

    z_a = float(norm.ppf(0.5 + 0.5 * CONFIDENCE))
    z_b = float(norm.ppf(power))
    n = (z_a * math.sqrt(null) + z_b * math.sqrt(max(variance, 0.0))) ** 2 / difference**2
    return math.ceil(0.25 * n * (1.0 + math.sqrt(1.0 + 4.0 / (n * difference * samples))) ** 2 - 1e-9)


def episodes_to_decide(paired: PairedShares) -> int | None:
    """Return how many episodes show the difference of `paired` with probability POWER, if it is the true one.

    More than there are: these have not shown it. None if the difference is 0, or of a single episode.
    """
    if paired.difference == 0.0 or paired.n < 2:
        return None
    variance = float((paired.first - paired.second).var(ddof=1))
    return max(_paired(abs(paired.difference), variance, paired.samples, POWER), paired.n + 1)


def least_difference(paired: PairedShares) -> float | None:
    """Return the least true difference that as many episodes would have shown with probability POWER.

    Args:
        paired: outcomes, for the number of episodes and the variance of their differences.

    Returns:
        The difference, 0..1; None if the episodes are too few to show any.
    """
    differences = paired.first - paired.second
    if paired.n < 2 or _paired(1.0, 0.0, paired.samples, POWER) > paired.n:
        return None
    variance = float(differences.var(ddof=1))
    low = 0.0
    high = 1.0
    if _paired(high, variance, paired.samples, POWER) > paired.n:
        return None
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _paired(middle, variance, paired.samples, POWER) <= paired.n else (middle, high)
    return high
