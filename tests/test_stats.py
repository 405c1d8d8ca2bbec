"""Intervals, resampling and paired comparison: reference values, symmetry, coverage."""

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinebench_drake.errors import InputError
from kinebench_drake.stats import (
    RESAMPLES,
    PairedShares,
    bootstrap_mean,
    group_means,
    independent_mean_difference,
    pass_at_k,
    percentile_interval,
    resampled_counts,
    resampled_indices,
    resampled_means,
    share_interval,
    sign_flip_test,
    sign_test,
    wilson,
)


def paired(both, first_only, second_only, neither):
    counts = (both, first_only, second_only, neither)
    first, second = (np.repeat(outcomes, counts) for outcomes in ([1.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 0.0]))
    return PairedShares(first=first, second=second)


@pytest.mark.parametrize(
    ("counts", "low", "high"),  # Newcombe 1998, table II, method 10
    [((36, 12, 2, 0), 0.0569, 0.3404), ((36, 14, 0, 0), 0.1528, 0.4167)],
)
def test_paired_intervals_equal_those_published_by_newcombe(counts, low, high):
    assert paired(*counts).interval() == pytest.approx((low, high), abs=5e-5)


def test_swapping_the_pair_changes_only_the_sign():
    rng = np.random.default_rng(0)
    for a, b, c, d in rng.integers(0, 12, (50, 4)):
        if a + b + c + d:
            one = paired(a, b, c, d)
            other = paired(a, c, b, d)
            assert one.difference == -other.difference
            assert one.p_value == pytest.approx(other.p_value)
            low, high = other.interval()
            assert one.interval() == pytest.approx((-high, -low))
            assert one.interval()[0] <= one.difference <= one.interval()[1]


def test_paired_intervals_cover_the_true_difference_at_their_level():
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(600):
        common = rng.random(60) < 0.5
        first = common | (rng.random(60) < 0.3)
        second = common | (rng.random(60) < 0.1)
        low, high = PairedShares(first=first.astype(float), second=second.astype(float)).interval()
        held += low <= 0.5 * 0.2 <= high
    assert 0.92 <= held / 600 <= 0.98


def test_mcnemar_counts_discordant_pairs_only():
    assert paired(500, 8, 1, 40).p_value == paired(0, 8, 1, 0).p_value == pytest.approx(2 * 10 / 2**9)
    assert paired(5, 0, 0, 5).p_value == 1.0


def test_pairs_without_common_episodes_are_refused():
    with pytest.raises(InputError, match="nothing to compare"):
        PairedShares(first=np.zeros(0), second=np.zeros(0))
    with pytest.raises(InputError, match="1 and 0 episodes"):
        PairedShares(first=np.ones(1), second=np.zeros(0))


def test_wilson_interval_agrees_with_its_formula_and_widens_with_its_level():
    z = 1.959963984540054
    for hits, n in ((0, 5), (5, 5), (7, 10), (193, 200)):
        centre = (hits + z * z / 2) / (n + z * z)
        half = z / (n + z * z) * (hits * (n - hits) / n + z * z / 4) ** 0.5
        assert wilson(hits, n) == pytest.approx((centre - half, centre + half), abs=1e-12)
    assert wilson(0, 0) == (0.0, 1.0)
    narrow = wilson(3, 10, 0.5)
    wide = wilson(3, 10, 0.99)
    assert wide[0] < narrow[0] < 0.3 < narrow[1] < wide[1]


def test_resampling_in_chunks_draws_the_same_indices(monkeypatch):
    values = np.random.default_rng(2).normal(size=31)
    whole = np.concatenate(list(resampled_indices(31, np.random.default_rng(3))))
    for at_once in (2_000_000, 31, 100, 1):
        monkeypatch.setattr("kinebench_drake.stats._AT_ONCE", at_once)
        parts = list(resampled_indices(31, np.random.default_rng(3)))
        assert max(map(len, parts)) <= max(1, at_once // 31)
        assert np.array_equal(np.concatenate(parts), whole)
        means = resampled_means(values, np.random.default_rng(3))
        assert np.array_equal(means, values[whole].mean(axis=1))
    assert list(resampled_indices(0, np.random.default_rng(3), 0)) == []


def test_resampled_counts_sum_to_the_number_of_units():
    counts = resampled_counts(7, np.random.default_rng(0))
    assert counts.shape == (RESAMPLES, 7)
    assert (counts.sum(axis=1) == 7).all()


def test_percentile_intervals_ignore_non_finite_draws():
    draws = np.arange(101.0)
    assert percentile_interval(draws) == pytest.approx((2.5, 97.5))
    assert percentile_interval([*draws, np.nan, np.inf]) == percentile_interval(draws)
    assert np.isnan(percentile_interval([np.nan])).all()


@given(outcomes=st.lists(st.booleans(), min_size=1, max_size=8), data=st.data())
def test_pass_at_k_is_the_share_of_subsets_with_a_success(outcomes, data):
    k = data.draw(st.integers(1, len(outcomes)))
    subsets = list(combinations(outcomes, k))
    expected = sum(any(own) for own in subsets) / len(subsets)
    assert pass_at_k(sum(outcomes), len(outcomes), k) == pytest.approx(expected)


def test_pass_at_k_is_unbiased():
    """The mean over runs of 5 samples of pass@3 is the probability that one of 3 succeeds."""
    hits = np.random.default_rng(0).binomial(5, 0.3, 20_000)
    assert np.mean([pass_at_k(int(c), 5, 3) for c in hits]) == pytest.approx(1 - 0.7**3, abs=0.01)
    for hits, n, k in ((1, 2, 3), (1, 2, 0), (3, 2, 1)):
        with pytest.raises(InputError, match="expected 1 <= k"):
            pass_at_k(hits, n, k)


@given(st.lists(st.integers(-4, 4), min_size=1, max_size=9))
def test_the_sign_flip_test_counts_all_sign_patterns(steps):
    sums = np.abs(np.array(list(product((1, -1), repeat=len(steps)))) @ steps)
    expected = np.mean(sums >= abs(sum(steps)))
    assert sign_flip_test(np.array(steps) / 4) == pytest.approx(expected)


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=30))
def test_p_value_of_single_samples_is_that_of_the_sign_test(pairs):
    a, b = np.array(pairs, dtype=float).T
    shares = PairedShares(first=a, second=b)
    assert shares.better == (int((a > b).sum()), int((a < b).sum()))
    assert shares.p_value == sign_test(*shares.better) == pytest.approx(sign_flip_test(a - b))


def test_identical_samples_of_an_episode_narrow_no_interval():
    """Copies of samples narrow no interval; Wilson's of single samples is kept."""
    rng = np.random.default_rng(0)
    assert share_interval(np.array([1.0, 0.0, 1.0, 1.0]), rng) == wilson(3, 4)
    assert share_interval(np.full(6, 0.5), rng) == wilson(3, 6)
    assert share_interval(np.full(5, 0.5), rng) == (wilson(2, 5)[0], wilson(3, 5)[1])
    assert share_interval(np.empty(0), rng) == (0.0, 1.0)


def test_share_intervals_over_episodes_cover_the_mean_success_at_their_level():
    """40 episodes of 4 samples whose rates differ: an interval of 160 independent samples would hold it too rarely."""
    rng = np.random.default_rng(3)
    held = 0
    naive = 0
    for trial in range(400):
        rates = rng.choice([0.1, 0.9], size=40)
        hits = rng.binomial(4, rates)
        low, high = share_interval(hits / 4, np.random.default_rng(trial))
        held += low <= 0.5 <= high
        low, high = wilson(int(hits.sum()), 160)
        naive += low <= 0.5 <= high
    assert 0.91 <= held / 400 <= 0.98
    assert naive / 400 < 0.85


def test_group_means_keep_the_order_of_the_groups():
    assert group_means([1.0, 2.0, 3.0, 5.0], ["b", "a", "b", "c"]).tolist() == [2.0, 2.0, 5.0]


def test_interval_of_independent_shares_equals_that_published_by_newcombe():
    """Published example: 56 of 70 and 48 of 80 (Newcombe, Stat. Med. 17, 1998, pp. 873-890, table II, method 10)."""
    first = np.repeat([1.0, 0.0], (56, 14))
    second = np.repeat([1.0, 0.0], (48, 32))
    value = independent_mean_difference(first, second, np.random.default_rng(0))
    assert value.value == pytest.approx(0.2)
    assert (value.low, value.high) == pytest.approx((0.0524, 0.3339), abs=5e-5)
    swapped = independent_mean_difference(second, first, np.random.default_rng(0))
    assert (swapped.low, swapped.high) == pytest.approx((-value.high, -value.low))


def test_interval_of_independent_means_covers_their_difference_at_its_level():
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(200):
        value = independent_mean_difference(rng.normal(1.0, 1.0, 20), rng.normal(0.0, 2.0, 30), rng)
        covered += value.low <= 1.0 <= value.high
    assert 0.89 <= covered / 200 <= 0.98
    equal = independent_mean_difference(np.full(3, 0.5), np.full(4, 0.25), rng)
    assert equal.value == 0.25
    assert np.isnan([equal.low, equal.high]).all()
    with pytest.raises(InputError, match="without units"):
        independent_mean_difference(np.ones(1), np.array([]), rng)


@pytest.mark.parametrize("name", ["normal", "lognormal", "one outlier", "heavy tails", "two values"])
def test_the_bootstrap_of_many_values_agrees_with_plain_resampling(name):
    rng = np.random.default_rng(3)
    values = {
        "normal": rng.normal(2.0, 1.0, 4000),
        "lognormal": rng.lognormal(0.0, 2.0, 4000),
        "one outlier": np.append(rng.normal(0.0, 1.0, 3999), 1e4),
        "heavy tails": rng.standard_t(1.5, 4000),
        "two values": rng.choice([0.5, 1.0], 4000, p=[0.999, 0.001]),
    }[name]
    expected = percentile_interval(resampled_means(values, np.random.default_rng(0)))
    found = bootstrap_mean(values, np.random.default_rng(0))
    error = values.std() / np.sqrt(len(values))
    assert np.abs(np.subtract(found, expected)).max() < 0.2 * error
