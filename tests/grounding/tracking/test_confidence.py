"""Calibration of the confidence."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import expit

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.tracking.pose import (
    FRAME_FEATURES,
    TRACK_FEATURES,
    Confidence,
    LogisticRegression,
    load_confidence,
    save_confidence,
    track_features,
)
from kinebench_drake.track import Domain
from training.calibration import calibration_bins, fit_logistic

LAW = [-1.0, -0.5, 0.8, 0.0, 0.3, -0.2, 0.5, -0.7]


def drawn_frames(n: int, intercept: float) -> tuple[Array, NDArray[np.bool_]]:
    """Features of frames, and labels drawn by a logistic law."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(n, len(LAW)))
    return x, rng.random(n) < expit(intercept + x @ np.array(LAW))


def test_logistic_regression_recovers_the_law_of_its_samples() -> None:
    result = fit_logistic(*drawn_frames(6000, 0.7))
    assert result.intercept == pytest.approx(0.7, abs=0.15)
    np.testing.assert_allclose(result.weights, LAW, atol=0.15)


def test_calibration_bins_show_an_overconfident_probability() -> None:
    features, good = drawn_frames(4000, 0.0)
    p = fit_logistic(features, good).probability(features)
    assert max(abs(mean - share) for mean, share, _ in calibration_bins(p, good)) < 0.05
    assert max(abs(mean - share) for mean, share, _ in calibration_bins(np.sqrt(p), good)) > 0.1
    assert sum(n for _, _, n in calibration_bins(p, good)) == len(good)


def test_frames_without_neighbours_have_an_indicator_feature_and_zero_distance() -> None:
    confidence = np.array([0.5, 0.5, 1.0])
    distance = np.array([0.01, np.nan, 0.1])
    angle = np.array([0.05, np.nan, 0.5])
    features = track_features(confidence, distance, angle)
    np.testing.assert_allclose(features[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(features[1], [0.0, 0.0, 0.0, 1.0], atol=1e-12)
    assert np.isfinite(features).all()
    assert (features[2, :3] > 2.0).all()


def test_saved_confidence_is_loaded_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "confidence.json"
    frame, other, arm = (
        LogisticRegression(intercept=0.5 + i, weights=(i - 1) * np.arange(float(len(FRAME_FEATURES[domain]))))
        for i, domain in enumerate(Domain)
    )
    track = LogisticRegression(intercept=-1.5, weights=np.arange(float(len(TRACK_FEATURES))))
    saved = {
        Domain.FAMILIAR: Confidence(frame=frame, track=track),
        Domain.UNFAMILIAR: Confidence(frame=other, track=track),
        Domain.ARM: Confidence(frame=arm, track=track),
    }
    save_confidence(saved, path)
    loaded = load_confidence(path)
    for domain, before in saved.items():
        for step in ("frame", "track"):
            assert getattr(loaded[domain], step).intercept == getattr(before, step).intercept
            assert getattr(loaded[domain], step).weights.tolist() == getattr(before, step).weights.tolist()


@pytest.mark.parametrize(
    "text", ["", "{}", '{"familiar": {"frame": {"features": ["a"], "intercept": 0, "weights": [1]}}}']
)
def test_invalid_and_missing_calibration_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "confidence.json"
    path.write_text(text)
    with pytest.raises(SetupError, match="no usable calibration"):
        load_confidence(path)
    with pytest.raises(SetupError, match="no usable calibration"):
        load_confidence(tmp_path / "absent.json")
