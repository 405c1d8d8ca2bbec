import numpy as np

from kinebench_drake.segments import finite_rows, segments


def test_segments_are_the_maximal_runs_of_true() -> None:
    mask = np.array([True, False, True, True, False, True])
    assert segments(mask) == [slice(0, 1), slice(2, 4), slice(5, 6)]
    assert segments(np.zeros(4, dtype=bool)) == []
    assert segments(np.zeros(0, dtype=bool)) == []


def test_a_row_with_one_nan_is_not_finite() -> None:
    rows = np.zeros((3, 7))
    rows[1, 4] = np.nan
    assert finite_rows(rows).tolist() == [True, False, True]
