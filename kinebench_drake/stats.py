"""Statistics: intervals of shares and means, and paired comparisons."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinebench_drake.errors import InputError

_CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedOutcomes:
    """How two groups of outcomes, episode by episode, compare."""

    both: int
    """Episodes in which both succeed."""
    first_only: int
    second_only: int
    neither: int

    def __post_init__(self) -> None:
        """Check that there is something to compare.

        Raises:
            InputError: there is no pair, or a count is negative.
        """
        if min(self.both, self.first_only, self.second_only, self.neither) < 0 or self.n == 0:
            raise InputError("no episodes in common: there is nothing to compare")

    @classmethod
    def of(cls, first: Sequence[bool], second: Sequence[bool]) -> "PairedOutcomes":
        """Count outcomes of the same episodes in the same order.

        Raises:
            InputError: they are not as many, or none.
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
        """Episodes."""
        return self.both + self.first_only + self.second_only + self.neither

    @property
    def difference(self) -> float:
        """Success rate of the first less that of the second."""
        return (self.first_only - self.second_only) / self.n

    @property
    def p_value(self) -> float:
        """Two-sided exact test of McNemar (Psychometrika 12, 1947): the discordant pairs are as likely either way."""
        from scipy.stats import binomtest

        discordant = self.first_only + self.second_only
        return float(binomtest(self.first_only, discordant).pvalue) if discordant else 1.0

    def interval(self) -> tuple[float, float]:
        """95 % interval of the difference: method 10 of Newcombe (Statistics in Medicine 17, 1998, pp. 2635-2650).

        Wilson's intervals of both rates, put together with their correlation.
        """
        first, second = (self.both + self.first_only, self.both + self.second_only)
        (p_1, l_1, u_1), (p_2, l_2, u_2) = (_wilson(hits, self.n) for hits in (first, second))
        phi, d = self._correlation(), self.difference
        low = (p_1 - l_1) ** 2 - 2.0 * phi * (p_1 - l_1) * (u_2 - p_2) + (u_2 - p_2) ** 2
        high = (u_1 - p_1) ** 2 - 2.0 * phi * (u_1 - p_1) * (p_2 - l_2) + (p_2 - l_2) ** 2
        return max(-1.0, d - float(np.sqrt(max(low, 0.0)))), min(1.0, d + float(np.sqrt(max(high, 0.0))))

    def _correlation(self) -> float:
        """Phi, with Newcombe's continuity correction where it is positive."""
        a, b, c, d = self.both, self.first_only, self.second_only, self.neither
        product = (a + b) * (c + d) * (a + c) * (b + d)
        if product == 0:
            return 0.0
        determinant = a * d - b * c
        corrected = max(determinant - self.n / 2.0, 0.0) if determinant > 0 else float(determinant)
        return float(corrected / np.sqrt(product))


def _wilson(hits: int, n: int) -> tuple[float, float, float]:
    """A rate and the ends of Wilson's interval."""
    from scipy.stats import binomtest

    bounds = binomtest(hits, n).proportion_ci(confidence_level=_CONFIDENCE, method="wilson")
    return hits / n, float(bounds.low), float(bounds.high)
