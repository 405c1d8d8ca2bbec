"""Smoothing of the gripper width."""

import numpy as np

from kinebench_drake.grounding.registration.hand_contour import GAPS_M
from kinebench_drake.grounding.tracking.markov import smooth_gripper_width

WIDTH = np.where(np.arange(30) < 15, 0.08, 0.0)


def test_smoothing_keeps_precise_widths() -> None:
    np.testing.assert_allclose(smooth_gripper_width(WIDTH, np.full(30, 1e-3)), WIDTH, atol=2e-3)


def test_widths_from_priors_are_kept_exactly() -> None:
    width = np.linspace(0.0, 0.08, 30) ** 2 / 0.08
    assert smooth_gripper_width(width, np.zeros(30)).tolist() == width.tolist()


def test_uncertain_and_missing_widths_follow_their_neighbours() -> None:
    wild = WIDTH.copy()
    sigma = np.full(30, 1e-3)
    # fingers behind each other
    wild[20:24] = 0.06
    sigma[20:24] = 0.012
    smoothed = smooth_gripper_width(wild, sigma)
    assert not (smoothed > 0.015).any(where=np.arange(30) >= 15)
    wild[20:24] = np.nan
    assert smooth_gripper_width(wild, sigma)[20:24].max() < 0.005


def test_smoothing_keeps_a_sudden_opening_of_the_fingers() -> None:
    width = np.where(np.arange(30) < 18, 0.04, 0.08)
    sigma = np.full(30, 1e-3)
    sigma[10:18] = 0.006  # half hidden while they hold, and read too wide by and by
    width = width + np.where(sigma > 1e-3, np.linspace(0.0, 0.008, 30), 0.0)
    smoothed = smooth_gripper_width(width, sigma)
    assert (np.abs(smoothed[:17] - 0.04) < 0.004).all()
    assert (np.abs(smoothed[19:] - 0.08) < 0.002).all()


def test_the_width_of_moving_fingers_continues_through_hidden_frames() -> None:
    width = np.clip(0.08 - 0.006 * np.arange(30), 0.0, None)
    sigma = np.full(30, 1e-3)
    width[8:11] = np.nan
    assert np.abs(smooth_gripper_width(width, sigma)[8:11] - (0.08 - 0.006 * np.arange(8, 11))).max() < 0.004


def test_widths_far_from_a_measurement_are_unknown() -> None:
    width = np.full(30, np.nan)
    sigma = np.full(30, np.nan)
    assert np.isnan(smooth_gripper_width(width, sigma)).all()
    width[:3] = 0.03
    sigma[:3] = 1e-3
    smoothed = np.isfinite(smooth_gripper_width(width, sigma))
    assert smoothed[:4].all()
    assert not smoothed[15:].any()


def test_edges_tell_the_width_where_nothing_is_measured_but_not_against_priors() -> None:
    row = -0.5 * ((GAPS_M - 0.03) / 0.002) ** 2
    known = np.full(6, np.nan)
    sigma = np.full(6, np.nan)
    known[0] = 0.06
    sigma[0] = 0.0
    smoothed = smooth_gripper_width(known, sigma, [row] * 6)
    assert smoothed[0] == 0.06
    np.testing.assert_allclose(smoothed[2:], 0.03, atol=2e-3)
