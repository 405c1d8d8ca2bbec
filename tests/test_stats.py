"""Intervals, resampling and paired comparison: reference values, symmetry, coverage."""

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.stats import (
    PairedOutcomes,
    percentile_interval,
    resampled_counts,
    resampled_indices,
    resampled_means,
    wilson,
)


def paired(both, first_only, second_only, neither):
    return PairedOutcomes(both=both, first_only=first_only, second_only=second_only, neither=neither)


@pytest.mark.parametrize(
    ("counts", "low", "high"),  # Newcombe 1998, table II, method 10
    [((36, 12, 2, 0), 0.0569, 0.3404), ((36, 14, 0, 0), 0.1528, 0.4167)],
)
def test_intervals_are_newcombe_s(counts, low, high):
    assert paired(*counts).interval() == pytest.approx((low, high), abs=5e-5)


def test_the_other_way_round_only_the_sign_changes():
    rng = np.random.default_rng(0)
    for a, b, c, d in rng.integers(0, 12, (50, 4)):
        if a + b + c + d:
            one, other = paired(a, b, c, d), paired(a, c, b, d)
            assert one.difference == -other.difference
            assert one.p_value == pytest.approx(other.p_value)
            low, high = other.interval()
            assert one.interval() == pytest.approx((-high, -low))
            assert one.interval()[0] <= one.difference <= one.interval()[1]


def test_intervals_hold_the_true_difference_as_often_as_they_say():
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(600):
        common = rng.random(60) < 0.5
        first = common | (rng.random(60) < 0.3)
        second = common | (rng.random(60) < 0.1)
        low, high = PairedOutcomes.of(first.tolist(), second.tolist()).interval()
        held += low <= 0.5 * 0.2 <= high
    assert 0.92 <= held / 600 <= 0.98


def test_mcnemar_counts_discordant_pairs_only():
    assert paired(500, 8, 1, 40).p_value == paired(0, 8, 1, 0).p_value == pytest.approx(2 * 10 / 2**9)
    assert paired(5, 0, 0, 5).p_value == 1.0


def test_nothing_in_common_is_told():
    with pytest.raises(InputError, match="nothing to compare"):
        PairedOutcomes.of([], [])
    with pytest.raises(InputError, match="cannot be paired"):
        PairedOutcomes.of([True], [])


def test_wilson_agrees_with_its_formula_and_its_limits():
    z = 1.959963984540054
    for hits, n in ((0, 5), (5, 5), (7, 10), (193, 200)):
        centre = (hits + z * z / 2) / (n + z * z)
        half = z / (n + z * z) * (hits * (n - hits) / n + z * z / 4) ** 0.5
        assert wilson(hits, n) == pytest.approx((centre - half, centre + half), abs=1e-12)
    assert wilson(0, 0) == (0.0, 1.0)
    narrow, wide = wilson(3, 10, 0.5), wilson(3, 10, 0.99)
    assert wide[0] < narrow[0] < 0.3 < narrow[1] < wide[1]


def test_resamples_in_parts_are_the_same_draws(monkeypatch):
    values = np.random.default_rng(2).normal(size=31)
    whole = np.concatenate(list(resampled_indices(31, np.random.default_rng(3), 50)))
    for at_once in (2_000_000, 31, 100, 1):
        monkeypatch.setattr("kinebench_drake.stats._AT_ONCE", at_once)
        parts = list(resampled_indices(31, np.random.default_rng(3), 50))
        assert max(map(len, parts)) <= max(1, at_once // 31)
        assert np.array_equal(np.concatenate(parts), whole)
        means = resampled_means(values, np.random.default_rng(3), 50)
        assert np.array_equal(means, values[whole].mean(axis=1))
    assert list(resampled_indices(0, np.random.default_rng(3), 0)) == []


def test_counts_are_of_as_many_units_as_there_are():
    counts = resampled_counts(7, np.random.default_rng(0), 40)
    assert counts.shape == (40, 7)
    assert (counts.sum(axis=1) == 7).all()


def test_percentile_intervals_leave_out_what_is_not_finite():
    draws = np.arange(101.0)
    assert percentile_interval(draws) == pytest.approx((2.5, 97.5))
    assert percentile_interval([*draws, np.nan, np.inf]) == percentile_interval(draws)
    assert np.isnan(percentile_interval([np.nan])).all()
