"""Errors of a grounding against ground truth."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.perception.clip import TruthClip
from benchmarks.perception.errors import ClipErrors, compare
from benchmarks.perception.store import MeasurementStore
from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.grounding.pipeline import PipelineResult

HALF_TURN = make_pose(rotation_exp([0.0, 0.0, np.pi]), np.zeros(3))


def test_ground_truth_poses_have_zero_error(errors: Callable[..., ClipErrors]) -> None:
    e = errors()
    assert e.position_m.max() == 0.0
    assert e.rotation_rad.max() < 1e-7
    assert e.finger_m.max() == 0.0
    assert e.tracked_fraction == 1.0
    assert e.flips == []


def test_position_error_equals_the_offset_of_the_poses(errors: Callable[..., ClipErrors]) -> None:
    np.testing.assert_allclose(errors(0.010).position_m, 0.010, atol=1e-12)


@pytest.mark.parametrize(("hidden", "runs"), [((), [5]), ((5,), [4]), ((2,), [5])])
def test_the_length_of_a_flip_counts_only_tracked_frames(
    clip: TruthClip, grounded: Callable[..., PipelineResult], hidden: tuple[int, ...], runs: list[int]
) -> None:
    X: Array = clip.X_CH.copy()
    X[3:8] = X[3:8] @ HALF_TURN
    tracked = ~np.isin(np.arange(len(X)), hidden)
    assert compare(clip, grounded(clip, X, tracked), 1.0).flips == runs


def test_separate_flips_are_counted_separately(clip: TruthClip, grounded: Callable[..., PipelineResult]) -> None:
    X = clip.X_CH.copy()
    X[1:3], X[9:] = X[1:3] @ HALF_TURN, X[9:] @ HALF_TURN
    e = compare(clip, grounded(clip, X), 1.0)
    assert e.flips == [2, 3]
    assert e.longest_flip == 3


def test_clip_errors_survive_storage_as_json(errors: Callable[..., ClipErrors], tmp_path: Path) -> None:
    fault = Anomaly(kind=AnomalyKind.VANISH, frame_start=4, frame_end=6, severity=3.0)
    e = errors(0.0123, faults=(fault,), gone=slice(4, 7), tracked=np.arange(12) != 5)
    store = MeasurementStore(tmp_path / "kept.jsonl", ClipErrors)
    store.put("a", e)
    again = MeasurementStore(tmp_path / "kept.jsonl", ClipErrors)["a"]
    np.testing.assert_array_equal(again.position_m, store["a"].position_m)
    assert again.planted == e.planted
    np.testing.assert_allclose(again.position_m, e.position_m, atol=1e-7)
    np.testing.assert_array_equal(np.isnan(again.rotation_rad), np.isnan(e.rotation_rad))
