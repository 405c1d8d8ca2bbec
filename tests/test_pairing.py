"""Paired comparison: reference values, symmetry, coverage."""

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.stats import PairedOutcomes


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
