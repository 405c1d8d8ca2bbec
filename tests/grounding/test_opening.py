"""Finger gaps along a video."""

import numpy as np

from kinebench_drake.grounding.opening import smooth_opening

WIDTH = np.where(np.arange(30) < 15, 0.08, 0.0)


def test_what_is_seen_well_stays() -> None:
    np.testing.assert_allclose(smooth_opening(WIDTH, np.full(30, 1e-3)), WIDTH, atol=2e-3)


def test_a_hidden_stretch_keeps_what_was_seen_before_and_after() -> None:
    wild, sigma = WIDTH.copy(), np.full(30, 1e-3)
    wild[20:24], sigma[20:24] = 0.06, 0.012  # fingers behind each other
    assert smooth_opening(wild, sigma)[20:24].max() < 0.015
    wild[20:24] = np.nan
    assert smooth_opening(wild, sigma)[20:24].max() < 0.005


def test_what_nobody_tells_is_unknown() -> None:
    width, sigma = np.full(30, np.nan), np.full(30, np.nan)
    assert np.isnan(smooth_opening(width, sigma)).all()
    width[0], sigma[0] = 0.03, 1e-3
    told = np.isfinite(smooth_opening(width, sigma))
    assert told[:2].all()
    assert not told[5:].any()
