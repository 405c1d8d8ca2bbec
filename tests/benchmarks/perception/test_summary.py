"""The figures of several clips."""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.summary import (
    confidence_samples,
    intervals,
    open_is_correct,
    open_threshold,
    reliability_curve,
    summarize,
)


def test_frames_of_all_clips_are_pooled(errors: Callable[..., ClipErrors]) -> None:
    half = np.arange(12) < 6
    figures = summarize([errors(0.010), errors(0.020, tracked=half), errors(0.010)])
    assert figures["position_median_mm"] == pytest.approx(10.0)
    assert figures["position_max_mm"] == pytest.approx(20.0)
    assert figures["tracked_fraction"] == pytest.approx((1 + 0.5 + 1) / 3)
    assert figures["tracked_fraction_worst"] == 0.5
    assert figures["cpu_median_s"] == pytest.approx(0.5 * 49 / 12)


def test_tracked_frames_off_by_3_cm_or_without_a_gripper_are_false(errors: Callable[..., ClipErrors]) -> None:
    assert summarize([errors(0.029)])["tracked_frames_off_by_3_cm"] == 0.0
    assert summarize([errors(0.031), errors()])["tracked_frames_off_by_3_cm"] == pytest.approx(0.5)
    assert summarize([errors(gone=slice(4, 7))])["tracked_frames_off_by_3_cm"] == pytest.approx(3 / 12)
    lost = ~np.isin(np.arange(12), [4, 5, 6])
    assert summarize([errors(gone=slice(4, 7), tracked=lost)])["tracked_frames_off_by_3_cm"] == 0.0


def test_tracked_when_seen_counts_frames_that_show_30_percent_of_the_gripper(errors: Callable[..., ClipErrors]) -> None:
    nothing = np.zeros(12)
    group = [errors(share=0.31), errors(share=0.29, tracked=nothing)]
    assert summarize(group)["tracked_when_seen"] == 1.0
    assert summarize([errors(share=0.31), errors(share=0.30, tracked=nothing)])["tracked_when_seen"] == 0.5


def test_bootstrap_intervals_contain_the_figure_and_repeat_by_seed(errors: Callable[..., ClipErrors]) -> None:
    group = [errors(0.001 * i) for i in range(1, 12)]
    first = intervals(group, seed=3)
    again = intervals(group, seed=3)
    figure = first["position_median_mm"]
    assert figure == again["position_median_mm"]
    assert figure.value == pytest.approx(6.0)
    assert 1.0 < figure.low < figure.value < figure.high < 11.0
    assert np.isnan(intervals(group[:1])["position_median_mm"].low)


def test_the_open_threshold_is_halfway_between_widest_and_narrowest_true_opening() -> None:
    assert open_threshold(np.array([0.08, 0.05, np.nan, 0.065])) == pytest.approx(0.065)
    assert open_threshold(np.zeros(5)) == 0.04
    assert open_threshold(np.array([0.080, 0.065])) == 0.04


def test_open_and_closed_are_not_judged_near_the_threshold() -> None:
    true = np.array([0.08, 0.00, 0.041, 0.00, 0.08])
    seen = np.array([0.07, 0.05, 0.000, 0.01, np.nan])
    assert open_is_correct(seen, true).tolist() == [True, False, True]


def test_a_calibrated_confidence_has_no_calibration_error() -> None:
    rng = np.random.default_rng(0)
    confidence = rng.uniform(0, 1, 40_000)
    good = rng.random(40_000) < confidence
    curve = reliability_curve(confidence, good)
    assert curve.error < 0.02
    assert sum(b.frames for b in curve.bins) == 40_000
    assert all(b.good_low <= b.good <= b.good_high for b in curve.bins)
    boastful = reliability_curve(np.full(100, 0.95), np.arange(100) < 60)
    assert boastful.error == pytest.approx(0.35)


def test_a_pose_without_a_true_gripper_is_never_good(errors: Callable[..., ClipErrors]) -> None:
    confidence, good = confidence_samples([errors(0.009, gone=slice(0, 3)), errors(0.011)])
    assert len(confidence) == 24
    assert good.sum() == 9
