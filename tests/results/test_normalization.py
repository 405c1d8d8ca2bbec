import numpy as np
import pytest

from kinebench_drake.results.aggregate import normalize_run, robust_normalize
from kinebench_drake.results.row import SampleRow, Status


def _row(id: str, cost: float | None, model: str | None = None, status: Status = Status.OK) -> SampleRow:
    return SampleRow(
        id=id,
        video=id,
        task=None,
        model=model,
        status=status,
        reason=None,
        content_hash="",
        metrics={"manipulability_cost_mean": cost},
    )


def test_robust_scale_runs_from_the_10th_to_the_90th_percentile() -> None:
    values = np.arange(101.0)
    scaled = robust_normalize(values)
    np.testing.assert_allclose(scaled, np.clip((values - 10) / 80, 0, 1))
    np.testing.assert_allclose(robust_normalize(1e3 - 5 * values), 1 - scaled, atol=1e-12)
    np.testing.assert_array_equal(robust_normalize([1.0, np.nan, 3.0]), [0.0, np.nan, 1.0])


def test_robust_scale_maps_equal_values_to_one_half() -> None:
    np.testing.assert_array_equal(robust_normalize([2.0, 2.0]), [0.5, 0.5])
    np.testing.assert_array_equal(robust_normalize([1.0] + 40 * [2.0] + [7.0]), [0.0] + 40 * [0.5] + [1.0])
    assert len(robust_normalize([])) == 0
    assert np.isnan(robust_normalize([np.nan])).all()


def test_a_run_is_normalized_by_the_percentiles_of_its_measured_samples() -> None:
    rows = [_row(str(k), float(k), "a" if k < 51 else "b") for k in range(101)]
    rows += [_row("none", None), _row("broken", 1e9, status=Status.ERROR)]
    found = normalize_run(rows)["manipulability_cost_mean"]
    scaled = np.clip((np.arange(101.0) - 10) / 80, 0, 1)
    assert (
        found
        == {
            "low": pytest.approx(10.0),
            "high": pytest.approx(90.0),
            "n": 101,
            "mean": pytest.approx(scaled.mean()),
            "bound": pytest.approx((scaled.sum() + 2.0) / 103),  # those without a value are at the bad end
            "per_task": {},
            "bound_per_task": {},
            "per_model": {"a": pytest.approx(scaled[:51].mean()), "b": pytest.approx(scaled[51:].mean())},
            "bound_per_model": {"a": pytest.approx(scaled[:51].mean()), "b": pytest.approx(scaled[51:].mean())},
        }
    )


def test_a_run_of_one_value_is_not_normalized() -> None:
    assert normalize_run([_row("a", 1.0), _row("b", None)]) == {}
