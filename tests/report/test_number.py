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
    SHARES,
    compare_numbers,
    number_lines,
    verdict_line,
    verdict_lines,
)
from kinebench_drake.report.number import tabulate_numbers as tabulate
from kinebench_drake.report.table import table_csv, table_latex
from kinebench_drake.results.direction import LOWER_IS_BETTER
from kinebench_drake.results.row import Status
from kinebench_drake.stats import PairedShares
from tests.report.pages import row

VALUES = st.none() | st.integers(-5, 5).map(float)
"""Few values, so that ties occur."""


_OF_FOLLOWING = [name for name in NUMBERS if name.startswith(("follow", "deviation_"))]
"""Numbers that only rows of `follow` have."""


def rows(name, values, task="T"):
    """Rows of samples with one number each."""
    made = []
    for k, value in enumerate(values):
        fields = {"extra" if name == "success" else "metrics": {name: value}}
        fields = {name: value} if name in ("executable", "feasible") else fields
        made.append(row(f"s{k}", task=task, **fields))
    return made


def compare(name, first, second):
    if name in SHARES:
        first, second = ([None if v is None else v > 0 for v in own] for own in (first, second))
    comparisons = compare_numbers(
        [((a,), (b,)) for a, b in zip(rows(name, first), rows(name, second), strict=True)], "a", "b"
    )
    return next((c for c in comparisons if c.metric.name == name and c.task == ALL_TASKS), None)


@pytest.mark.parametrize("name", ["success", "executable", "feasible", "sparc", "slowdown_min"])
@given(values=st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=12), place=st.integers(0, 11))
@settings(max_examples=60, deadline=None)
def test_a_missing_value_never_improves_the_comparison_of_its_model(name, values, place):
    first = [a for a, _ in values]
    second = [b for _, b in values]
    place %= len(values)
    before = compare(name, first, second)
    removed = [None if k == place else v for k, v in enumerate(first)]
    after = compare(name, removed, second)
    if after is None or before is None:  # no value at all is left to compare
        return
    assert after.better[0] <= before.better[0]
    assert after.better[1] >= before.better[1]
    share = name in SHARES
    sign = -1 if name in LOWER_IS_BETTER else 1
    others = [sign * v for v in (*removed, *second) if v is not None]
    if share or (first[place] is not None and min(others, default=np.inf) <= sign * first[place]):
        assert sign * after.bound.mean <= sign * before.bound.mean + 1e-12


@pytest.mark.parametrize("name", ["feasible", "manipulability_mean", "slowdown_min"])
@given(values=st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=10))
@settings(max_examples=40, deadline=None)
def test_exchanging_the_models_negates_the_difference(name, values):
    first = [a for a, _ in values]
    second = [b for _, b in values]
    one = compare(name, first, second)
    other = compare(name, second, first)
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
    assert [c.metric.name for c in comparisons if c.task == ALL_TASKS] == [
        name for name in NUMBERS if name not in ("success", "progress", *_OF_FOLLOWING)
    ]
    assert comparisons[0].metric.name == "executable"
    assert {c.task for c in comparisons} == {ALL_TASKS, "A", "B"}
    table = tabulate(comparisons)
    assert len(table_csv(table).splitlines()) == len(comparisons) + 1
    assert "+0.00" in table_latex(table)
    text = list(number_lines(comparisons))
    assert text[0] == "Numbers on shared samples: a and b"
    assert text[1].split() == ["Number", "a", "b", "a", "−", "b", "Both", "p"]
    assert text[2].startswith("Executable")


@given(values=st.lists(st.tuples(VALUES, VALUES), min_size=1, max_size=10), loss=st.none() | st.integers(1, 9))
@settings(max_examples=60, deadline=None)
def test_a_loss_that_lowers_the_worst_case_never_improves_the_comparison_of_its_model(values, loss):
    """The value of a sample with lost frames stays, or rises; only its worst case decides."""
    first, second = (rows("sparc", own) for own in zip(*values, strict=True))
    before = compare_numbers([((a,), (b,)) for a, b in zip(first, second, strict=True)], "a", "b")
    value = values[0][0]
    if value is None:
        return
    bound = None if loss is None else value - loss
    first[0] = row("s0", metrics={"sparc": value + 1.0, "sparc_bound": bound}, task="T")
    after = compare_numbers([((a,), (b,)) for a, b in zip(first, second, strict=True)], "a", "b")
    one, other = (next(c for c in some if c.metric.name == "sparc") for some in (before, after))
    assert other.better[0] <= one.better[0]
    assert other.better[1] >= one.better[1]
    if bound is not None:
        assert other.bound.mean <= one.bound.mean + 1e-12


def shares(*counts):
    """Executable or not of both, of one and of neither of two models: counts of both, first, second, none."""
    pairs = np.repeat([(1, 1), (1, 0), (0, 1), (0, 0)], counts, axis=0)
    return PairedShares(first=pairs[:, 0].astype(float), second=pairs[:, 1].astype(float))


def test_the_better_model_is_named_first_with_its_difference_interval_and_p():
    line = verdict_line("wan", "cog", "", "executable", shares(10, 2, 20, 8), (0.3, 0.9))
    assert line == (
        "cog is better than wan: executable 75% (at most 90%) against 30% of 40 shared samples, difference +45% "
        "[+24% to +61%], p = 0.00012"
    )
    assert verdict_line("cog", "wan", "", "executable", shares(10, 20, 2, 8), (0.9, 0.3)) == line


def test_an_undecided_comparison_names_the_samples_that_would_decide():
    line = verdict_line("wan", "cog", "Suite 0", "success", shares(10, 6, 3, 1))
    assert line.startswith("Undecided between wan and cog: success 80% against 65% of 20 shared samples of Suite 0, ")
    needed = int(line.split("about ")[1].split()[0])
    assert line.endswith("such samples would decide")
    enough = verdict_line("wan", "cog", "", "success", shares(*(n * needed // 20 for n in (10, 6, 3, 1))))
    assert enough.startswith("wan is better than cog")


def test_equal_models_are_undecided_with_the_difference_that_would_have_shown():
    assert verdict_line("a", "b", "", "executable", shares(10, 5, 5, 10)).endswith(
        "samples show differences of 37% and more"
    )
    assert verdict_line("a", "b", "", "executable", shares(2, 0, 0, 0)).endswith(
        "too few samples to show any difference"
    )


def test_open_verdicts_count_as_no_with_the_share_that_is_possible_beside_it():
    one = rows("executable", [True, None, None, False])
    other = rows("executable", [True, True, False, False])
    [line] = verdict_lines(compare_numbers([((a,), (b,)) for a, b in zip(one, other, strict=True)], "a", "b"))
    assert "executable 50% against 25% (at most 75%) of 4 shared samples" in line


def test_the_table_on_a_terminal_fits_100_columns_whatever_the_names():
    names = "command:python serve.py step=1000", "command:python serve.py step=2000"
    rng = np.random.default_rng(0)
    values = [name for name in NUMBERS if name in BY_NAME]
    pairs = [
        tuple(
            (
                row(
                    f"s{k}",
                    executable=bool(rng.integers(2)),
                    feasible=True,
                    metrics=dict(zip(values, x, strict=True)),
                    extra={"success": bool(rng.integers(2)), "progress": 0.5},
                ),
            )
            for x in 10.0 + 5.0 * rng.standard_normal((2, len(values)))
        )
        for k in range(9)
    ]
    lines = list(number_lines(compare_numbers(pairs, *names)))
    table = lines[1 : lines.index("")]
    assert len(table) == len(NUMBERS) - len(_OF_FOLLOWING) + 1
    assert max(map(len, table)) <= 100
    assert len(set(table[0].split())) == 6, "two names are equal"


def test_several_pairs_of_models_have_a_table_each_with_their_names():
    pairs = [((a,), (b,)) for a, b in zip(rows("sparc", [1.0, 2.0]), rows("sparc", [0.0, 3.0]), strict=True)]
    table = tabulate([*compare_numbers(pairs, "a", "b"), *compare_numbers(pairs, "a", "c")])
    titles = {own.title: own.columns[2].label for own in table.by_pair()}
    assert titles == {"Numbers on shared samples: a and b": "a", "Numbers on shared samples: a and c": "a"}
    assert [own.columns[3].label for own in table.by_pair()] == ["b", "c"]
    assert [own.name for own in table.by_pair()] == ["numbers", "numbers_2"]
    assert table_csv(table).splitlines()[0].startswith("first,second,task")


def test_shortened_model_names_stay_distinct():
    one, two = (f"command:python /srv/models/a-rather-long-name/serve.py step={k}" for k in (1000, 2000))
    assert len(shorten(one)) == len(shorten(two)) == 48
    assert shorten(one) != shorten(two)
    assert (shorten("wan"), len(shorten(one, 28))) == ("wan", 28)
