"""Planned numbers of episodes: published values, simulated power, bounds."""

import math

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.results.power import PowerDesign, least_difference
from kinebench_drake.stats import PairedShares

TRIALS = 800


def simulate(design: PowerDesign, episodes: int, rng: np.random.Generator) -> PairedShares:
    """Outcomes of two models: a sample is its model's outcome of the episode, or where `fresh` an independent one."""
    p = np.array([design.success, design.success + design.difference])
    both = p[0] * p[1] + design.correlation / design.icc * math.sqrt((p * (1 - p)).prod())
    kinds = rng.choice(4, size=episodes, p=[both, p[0] - both, p[1] - both, 1 - p.sum() + both])
    own = np.stack([np.isin(kinds, (0, 1)), np.isin(kinds, (0, 2))])[..., None]
    shape = (2, episodes, design.samples)
    fresh = rng.random(shape) > math.sqrt(design.icc)
    shares = np.where(fresh, rng.random(shape) < p[:, None, None], own).mean(axis=2)
    return PairedShares(first=shares[1], second=shares[0], samples=design.samples)


@pytest.mark.parametrize(
    "design",
    [
        PowerDesign(success=0.5, difference=0.2, icc=1.0),
        PowerDesign(success=0.3, difference=0.25, icc=1.0, correlation=0.4),
        PowerDesign(success=0.8, difference=0.15, icc=1.0, correlation=0.3, power=0.9),
        PowerDesign(success=0.4, difference=0.2, samples=4, icc=0.5, correlation=0.3),
        PowerDesign(success=0.6, difference=0.2, samples=2, icc=0.7, correlation=0.2),
    ],
)
def test_planned_episodes_detect_the_difference_as_often_as_planned(design: PowerDesign) -> None:
    rng = np.random.default_rng(0)
    n = design.paired_episodes()
    error = 3 * math.sqrt(design.power * (1 - design.power) / TRIALS)
    detected = np.mean([simulate(design, n, rng).p_value < 0.05 for _ in range(TRIALS)])
    assert design.power - error < detected < design.power + error + 0.04
    fewer = np.mean([simulate(design, n // 2, rng).p_value < 0.05 for _ in range(TRIALS)])
    assert fewer < design.power - error


def test_unpaired_episodes_detect_the_difference_as_often_as_planned() -> None:
    from scipy.stats import fisher_exact

    rng = np.random.default_rng(1)
    design = PowerDesign(success=0.4, difference=0.25)
    n = design.unpaired_episodes()
    hits = rng.binomial(n, [[0.4, 0.65]] * TRIALS)
    tables = [[[a, n - a], [b, n - b]] for a, b in hits.tolist()]
    assert np.mean([fisher_exact(table).pvalue < 0.05 for table in tables]) == pytest.approx(0.8, abs=0.045)


def test_unpaired_episodes_equal_the_published_sample_sizes_of_fleiss() -> None:
    """Fleiss, Levin and Paik 2003, table A.4 (two-sided 0.05, power 0.8), with their continuity correction."""
    for success, difference, n in ((0.5, 0.1, 408), (0.1, 0.1, 219), (0.25, 0.25, 66)):
        assert PowerDesign(success=success, difference=difference).unpaired_episodes() == pytest.approx(n, abs=1)


def test_more_samples_and_more_correlation_need_fewer_episodes() -> None:
    def episodes(**changes: float) -> int:
        return PowerDesign(**{"success": 0.5, "difference": 0.1, "icc": 0.6, **changes}).paired_episodes()

    assert episodes(samples=1) > episodes(samples=2) > episodes(samples=8)
    assert episodes(correlation=0.0) > episodes(correlation=0.3) > episodes(correlation=0.6)
    assert episodes(difference=0.1) > episodes(difference=0.2)
    assert episodes(samples=100, icc=1.0) >= 0.95 * episodes(icc=1.0)
    assert episodes(success=0.6, difference=-0.1) == episodes(success=0.5, difference=0.1)


@pytest.mark.parametrize(("samples", "seed"), [(1, 0), (1, 1), (4, 2)])
def test_the_least_difference_is_detected_with_the_planned_power(samples: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    design = PowerDesign(success=0.5, difference=1e-9, samples=samples, icc=0.6, correlation=0.3)
    x = least_difference(simulate(design, 120, rng))
    assert x is not None
    planned = PowerDesign(success=0.5 - x / 2, difference=x, samples=samples, icc=0.6, correlation=0.3)
    detected = np.mean([simulate(planned, 120, rng).p_value < 0.05 for _ in range(TRIALS)])
    assert detected == pytest.approx(0.8, abs=0.1)  # the variance is an estimate from 120 episodes


def test_fewer_than_six_discordant_episodes_have_no_least_difference() -> None:
    def equal(n: int) -> PairedShares:
        return PairedShares(first=np.ones(n), second=np.ones(n))

    assert least_difference(equal(5)) is None  # of 5 discordant episodes p is 0.0625 at least
    assert least_difference(equal(6)) == pytest.approx(1.0, abs=0.1)
    assert least_difference(equal(20)) > least_difference(equal(200)) > 0.03
    half = np.arange(40) % 2.0
    assert least_difference(PairedShares(first=half, second=1 - half)) > least_difference(equal(40))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"difference": 0.6}, r"takes .success 50 to 110; expected -50 to 50 points and not 0"),
        ({"difference": 0.0}, "not 0"),
        ({"success": 1.2}, "expected 0 to 100"),
        ({"icc": 2.0}, "expected 0 to 1"),
        ({"power": 1.0}, "less than 100"),
        ({"success": 0.05, "correlation": 0.9}, r"allows -0\.096 to 0\.55"),
        ({"samples": 2, "correlation": 0.6}, "agree no more than two samples of one model"),
    ],
)
def test_power_design_values_out_of_range_are_usage_errors(changes: dict[str, float], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        PowerDesign(**{"success": 0.5, "difference": 0.1, **changes})
