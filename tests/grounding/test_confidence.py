from pathlib import Path

import numpy as np
import pytest
from scipy.special import expit

from kinebench_drake.errors import SetupError
from kinebench_drake.grounding.confidence import FEATURES, Confidence
from kinebench_drake.grounding.training.holdout import FrameErrors, calibrate, reliability

LAW = [-1.0, -0.5, 0.8, 0.0, 0.3, -0.2, 0.5, -0.7]


def drawn_frames(n: int, intercept: float, weights: list[float]) -> tuple[FrameErrors, ...]:
    """Frames whose errors follow a known logistic law of their features."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(n, len(FEATURES)))
    good = rng.random(n) < expit(intercept + x @ np.array(weights))
    return tuple(
        FrameErrors(
            scene=0, features=row, position_m=0.002 if ok else 0.05, rotation_rad=0.01, mask_iou=0.9, depth_error=0.01
        )
        for row, ok in zip(x, good, strict=True)
    )


def test_calibration_finds_the_law_that_made_the_frames() -> None:
    found = calibrate(drawn_frames(6000, 0.7, LAW))
    assert found.intercept == pytest.approx(0.7, abs=0.15)
    np.testing.assert_allclose(found.weights, LAW, atol=0.15)


def test_a_calibrated_confidence_is_reliable_and_a_boastful_one_is_not() -> None:
    frames = drawn_frames(4000, 0.0, LAW)
    good = np.array([f.good for f in frames])
    fitted = calibrate(frames)
    p = np.array([fitted.probability_of(f.features) for f in frames])
    assert max(abs(mean - share) for mean, share, _ in reliability(p, good)) < 0.05
    assert max(abs(mean - share) for mean, share, _ in reliability(np.sqrt(p), good)) > 0.1
    assert sum(n for _, _, n in reliability(p, good)) == len(frames)


def test_save_and_load(tmp_path: Path) -> None:
    path = tmp_path / "confidence.json"
    Confidence(intercept=0.5, weights=np.array(LAW)).save(path)
    loaded = Confidence.load(path)
    assert loaded.intercept == 0.5
    assert loaded.weights.tolist() == LAW


@pytest.mark.parametrize("text", ["", "{}", '{"features": ["a"], "intercept": 0, "weights": [1]}'])
def test_what_is_no_calibration_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "confidence.json"
    path.write_text(text)
    with pytest.raises(SetupError, match="no usable calibration"):
        Confidence.load(path)
    with pytest.raises(SetupError, match="no usable calibration"):
        Confidence.load(tmp_path / "absent.json")
