"""Numbers of two models on shared samples: paired, and no gain by missing values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinebench_drake.io.figure import shorten
from kinebench_drake.report.metric import BY_NAME
from kinebench_drake.report.number import (
    ALL_TASKS,
    NUMBERS,
    compare_numbers,
    draw_numbers,
    executable_lines,
    number_lines,
)
from kinebench_drake.report.number import tabulate_numbers as tabulate
from kinebench_drake.report.table import table_csv, table_latex
from kinebench_drake.results.direction import LOWER_IS_BETTER
from kinebench_drake.results.row import Status
from tests.report.pages import row

VALUES = st.none() | st.integers(-5, 5).map(float)
"""Few values, so that ties occur."""


def rows(name, values, task="T"):
    """Rows of samples with one number each."""
    made = []
    for k, value in enumerate(values):
        fields = {name: value} if name in ("executable", "feasible") else {"metrics": {name: value}}
        made.append(row(f"s{k}", task=task, **fields))
    return made


def compare(name, first, second):
    if name in ("executable", "feasible", "trajopt_feasible"):
        first, second = ([None if v is None else v > 0 for v in own] for own in (first, second))
    comparisons = compare_numbers(
        [((a,), (b,)) for a, b in zip(rows(name, first), rows(name, second), strict=True)], "a", "b"
    )
    return next((c for c in comparisons if c.metric.name == name and c.task == ALL_TASKS), None)


@pytest.mark.parametrize("name", ["executable", "feasible", "sparc", "slowdown_min"])
@given(values=st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=12), place=st.integers(0, 11))
@settings(max_examples=60, deadline=None)
def test_a_missing_value_never_improves_the_comparison_of_its_model(name, values, place):
    first, second = [a for a, _ in values], [b for _, b in values]
    place %= len(values)
    before = compare(name, first, second)
    removed = [None if k == place else v for k, v in enumerate(first)]
    after = compare(name, removed, second)
    if after is None or before is None:  # no value at all is left to compare
        return
    assert after.better[0] <= before.better[0]
    assert after.better[1] >= before.better[1]
    share, sign = name in ("executable", "feasible"), -1 if name in LOWER_IS_BETTER else 1
    others = [sign * v for v in (*removed, *second) if v is not None]
    if share or (first[place] is not None and min(others, default=np.inf) <= sign * first[place]):
        assert sign * after.bound.mean <= sign * before.bound.mean + 1e-12


@pytest.mark.parametrize("name", ["feasible", "manipulability_mean", "slowdown_min"])
@given(values=st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=10))
@settings(max_examples=40, deadline=None)
def test_exchanging_the_models_negates_the_difference(name, values):
    first, second = [a for a, _ in values], [b for _, b in values]
    one, other = compare(name, first, second), compare(name, second, first)
    assert (one is None) == (other is None)
    if one is not None:
        assert one.better == other.better[::-1]
        assert one.p_value == other.p_value
        assert one.difference.n == other.difference.n == sum(a is not None and b is not None for a, b in values)
        if one.difference.n:
            assert one.difference.mean == pytest.approx(-other.difference.mean, abs=1e-12)
        assert one.bound.mean == pytest.approx(-other.bound.mean, abs=1e-12)


def test_paired_differences_are_clear_where_unpaired_intervals_overlap():
    """Samples of very different difficulty: every pair differs by 0.1, which unpaired intervals would hide."""
    base = np.arange(20.0)
    c = compare("manipulability_mean", list(base + 0.1 + 0.001 * (base % 3)), list(base))
    assert c.difference.low < c.difference.mean < c.difference.high
    assert c.difference.low > 0.09
    assert c.means[0].low < c.means[1].high
    assert c.better == (20, 0)
    assert c.p_value == pytest.approx(2.0**-19)
    assert c.is_clear


def test_a_gain_that_rests_on_missing_values_is_not_clear():
    """The first model has no number for its 15 hard samples and looks better on the other 10."""
    first = [1.0 + 0.01 * k for k in range(10)] + [None] * 15
    second = [0.5 + 0.02 * k for k in range(10)] + [0.8 + 0.01 * k for k in range(15)]
    c = compare("manipulability_mean", first, second)
    assert c.difference.low > 0.0
    assert (c.difference.n, c.shared, c.better) == (10, 25, (10, 15))
    assert c.bound.mean < c.difference.mean
    assert not c.is_clear


def test_three_samples_are_never_clear():
    c = compare("sparc", [-2.0, -2.1, -2.2], [-3.0, -3.2, -3.1])
    assert c.difference.low > 0.0
    assert c.bound.low > 0.0
    assert c.p_value == 0.25
    assert not c.is_clear


def test_equal_models_do_not_differ():
    c = compare("sparc", [-2.0, -3.0, None], [-2.0, -3.0, None])
    assert (c.difference.mean, c.difference.low, c.better, c.p_value) == (0.0, None, (0, 0), 1.0)
    assert not c.is_clear


def test_failed_samples_have_no_number():
    ok = row("a", feasible=True, metrics={"sparc": -2.0})
    failed = row("a", Status.ERROR, feasible=True, metrics={"sparc": -1.0})
    feasible, sparc = (c for c in compare_numbers([((ok,), (failed,))], "a", "b") if c.task == ALL_TASKS)
    assert (feasible.metric.name, sparc.metric.name) == ("feasible", "sparc")
    assert feasible.difference.n == sparc.difference.n == 0
    assert feasible.bound.mean == 1.0
    assert sparc.better == (1, 0)


def test_comparison_tables_lead_with_executable_and_have_every_number():
    values = {name: -2.0 if "sparc" in name else 0.5 for name in NUMBERS if name in BY_NAME}
    one = row("a", task="A", feasible=True, metrics=values | {"trajopt_feasible": True}, executable=True)
    two = row("a", task="B", feasible=False, metrics=values | {"trajopt_feasible": False}, executable=True)
    comparisons = compare_numbers([((one,), (one,)), ((two,), (two,))], "a", "b")
    assert [c.metric.name for c in comparisons if c.task == ALL_TASKS] == list(NUMBERS)
    assert comparisons[0].metric.name == "executable"
    assert {c.task for c in comparisons} == {ALL_TASKS, "A", "B"}
    table = tabulate(comparisons)
    assert len(table_csv(table).splitlines()) == len(comparisons) + 1
    assert "+0.00" in table_latex(table)
    text = list(number_lines(comparisons))
    assert text[0] == "a - b"
    assert text[2].startswith("Executable")
    [lead] = executable_lines(comparisons)
    assert lead == "a - b: executable 100% and 100% of 2, difference +0% [-66% to +66%]"
    assert len(draw_numbers(comparisons).figure.axes) >= len(NUMBERS)


def test_shortened_model_names_stay_distinct():
    one, two = (f"command:python /srv/models/a-rather-long-name/serve.py step={k}" for k in (1000, 2000))
    assert len(shorten(one)) == len(shorten(two)) == 48
    assert shorten(one) != shorten(two)
    assert (shorten("wan"), len(shorten(one, 28))) == ("wan", 28)
