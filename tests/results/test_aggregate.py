"""Means with their coverage and bounds, and the share of executable samples."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinebench_drake.results.aggregate import aggregate, estimate_passes, worst_values
from kinebench_drake.results.direction import HIGHER_IS_BETTER, LOWER_IS_BETTER, worst_value
from kinebench_drake.results.row import SampleRow, Status, sample_suffix
from kinebench_drake.stats import bootstrap_mean, wilson
from tests.rows import make_row

VALUES = st.lists(st.none() | st.floats(-100.0, 100.0), min_size=1, max_size=12)


def _row(id: str, executable: bool | None = None, reasons: tuple[str, ...] = (), **changes: object) -> SampleRow:
    fields = {"status": Status.OK, "reason": None, "task": None, "model": None, "content_hash": "", **changes}
    return make_row(id=id, video=id, executable=executable, executable_reasons=reasons, **fields)


def _rows(name: str, values: list[float | None]) -> list[SampleRow]:
    return [_row(str(k), metrics={name: value}) for k, value in enumerate(values)]


@pytest.mark.parametrize(("name", "worst"), [("sparc", min), ("manipulability_cost_mean", max)])
@given(values=VALUES)
def test_the_bound_replaces_nulls_by_the_worst_value_of_the_run(name, worst, values) -> None:
    estimate = aggregate(_rows(name, values)).estimates[name]
    numbers = [v for v in values if v is not None]
    assert (estimate.n, estimate.total) == (len(numbers), len(values))
    if not numbers:
        assert estimate.bound is None
        return
    expected = [worst(numbers) if v is None else v for v in values]
    assert estimate.bound == pytest.approx(math.fsum(expected) / len(expected))
    assert estimate.mean is not None
    assert worst(estimate.mean, estimate.bound) == pytest.approx(estimate.bound)


@given(values=st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=12), data=st.data())
def test_replacing_a_value_by_null_never_improves_the_bound(values: list[float], data: st.DataObject) -> None:
    """Unless it was the only worst one: the run then has no such value any more."""
    lost = data.draw(st.integers(0, len(values) - 1))
    rest = values[:lost] + values[lost + 1 :]
    if min(rest) > values[lost]:
        return
    before, after = (
        aggregate(_rows("sparc", own)).estimates["sparc"].bound
        for own in (values, [None if k == lost else v for k, v in enumerate(values)])
    )
    assert before is not None
    assert after is not None
    assert after <= before + 1e-9


def test_the_bound_of_a_group_uses_the_worst_value_of_the_whole_run() -> None:
    run = [*_rows("sparc", [-2.0, None]), _row("other", metrics={"sparc": -5.0})]
    assert aggregate(run[:2], worst=worst_values(run)).estimates["sparc"].bound == pytest.approx(-3.5)
    assert aggregate(run[1:2], worst=worst_values(run)).estimates["sparc"].bound == -5.0


def test_samples_without_a_verdict_count_as_not_executable() -> None:
    rows = [
        _row("a", executable=True),
        _row("b", executable=False, reasons=("lost: 4 frames", "vanish: 3 frames")),
        _row("c", executable=None, reasons=("undecided",)),
        _row("d", status=Status.ERROR, reason="broken"),
    ]
    total = aggregate(rows)
    assert total.estimates["executable"].mean == 0.25
    assert total.estimates["executable"].n == 4
    assert total.executable_reasons == {"lost": 1, "undecided": 1, "vanish": 1}
    assert total.to_json()["executable"]["bound"] == 0.25
    assert "executable" not in total.to_json()["metrics"]


def test_a_group_without_verdicts_has_share_0_where_other_groups_have_verdicts() -> None:
    good = [_row(k, executable=True, feasible=True, metrics={"trajopt_feasible": True}) for k in "ab"]
    broken = [_row(k, status=Status.ERROR, reason="broken") for k in "cd"]
    null = [_row("e", metrics={"trajopt_feasible": None})]
    worst = worst_values([*good, *broken, *null])
    executable = aggregate(broken, worst=worst).estimates["executable"]
    assert (executable.mean, executable.n) == (0.0, 2)
    assert aggregate(broken, worst=worst).estimates["feasible"].bound == 0.0
    assert aggregate(null, worst=worst).estimates["trajopt_feasible"].bound == 0.0


def test_a_run_without_verdicts_has_no_executable_share() -> None:
    assert aggregate([_row("a"), _row("b")]).estimates["executable"].n == 0


def test_rows_keep_their_verdict_on_execution() -> None:
    row = _row("a", executable=False, reasons=("lost: 3 frames",))
    assert SampleRow.from_json(row.to_json()) == row
    earlier = {k: v for k, v in row.to_json().items() if k not in ("executable", "executable_reasons")}
    assert SampleRow.from_json(earlier).executable is None


def test_every_metric_has_at_most_one_better_direction() -> None:
    assert not HIGHER_IS_BETTER & LOWER_IS_BETTER
    assert worst_value("sparc", [-3.0, -2.0]) == -3.0
    assert worst_value("slowdown_min", [0.3, 0.2]) == 0.3
    assert worst_value("sparc_floor_low", [1.0]) is None


def _samples(*episodes: list[bool | None]) -> list[SampleRow]:
    """Rows of episodes with several samples; None: not measured."""
    return [
        _row(
            f"e{number}{sample_suffix(index)}",
            status=Status.ERROR if success is None else Status.OK,
            metrics={"sparc": float(number)},
            extra={"sample_index": index, "success": success},
        )
        for number, own in enumerate(episodes)
        for index, success in enumerate(own)
    ]


def test_intervals_over_several_samples_per_episode_resample_episodes() -> None:
    rows = _samples([True, True, True], [False, True, False], [False] * 3, [True] * 3)
    assert [row.episode for row in rows[:4]] == ["e0", "e0", "e0", "e1"]
    estimates = aggregate(rows).estimates
    success = estimates["success"]
    assert (success.n, success.total) == (12, 12)
    assert success.mean == pytest.approx(7 / 12)
    low, high = wilson(7, 12)
    assert (success.low, success.high) != (low, high)
    assert success.high - success.low > high - low
    assert estimates["sparc"].mean == 1.5
    assert (estimates["sparc"].low, estimates["sparc"].high) == bootstrap_mean(np.arange(4.0), np.random.default_rng(0))
    passes = {name: e.mean for name, e in estimates.items() if name.startswith("pass_at_")}
    assert passes == {"pass_at_1": pytest.approx(7 / 12), "pass_at_2": pytest.approx(2 / 3), "pass_at_3": 0.75}


def test_one_sample_per_episode_has_a_wilson_interval_and_no_pass_at_k() -> None:
    estimates = aggregate(_samples([True], [False], [True])).estimates
    assert not any(name.startswith("pass") for name in estimates)
    assert (estimates["success"].low, estimates["success"].high) == wilson(2, 3)


def test_an_unmeasured_sample_never_improves_the_bound_of_pass_at_k() -> None:
    whole = estimate_passes(_samples([True, False], [False, False], [True, True]))
    lost = estimate_passes(_samples([True, None], [False, None], [None, True]))
    for k, share in whole.items():
        assert lost[k].bound <= share.bound
    assert (lost[1].n, lost[2].n, lost[2].mean) == (3, 0, None)
    assert lost[1].mean == pytest.approx(2 / 3)
