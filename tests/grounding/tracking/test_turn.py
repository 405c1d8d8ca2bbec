"""Turn of the last joint along a video."""

import numpy as np
import pytest

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.tracking.markov import TURNS_RAD, likeliest_turns


def peaks(truth_rad: Array, weight: float = 8.0) -> Array:
    """Log-likelihoods (T, M) with one peak a frame."""
    return np.asarray(weight * np.exp(-0.5 * ((TURNS_RAD - truth_rad[:, None]) / 0.2) ** 2))


def unknown(frames: int) -> Array:
    return np.full(frames - 1, np.nan)


def test_an_unambiguous_turn_is_followed_through_the_video() -> None:
    truth = np.linspace(-1.0, 0.8, 40)
    turns, sigma = likeliest_turns(TURNS_RAD, peaks(truth), unknown(40))
    assert np.abs(turns - truth).max() < np.deg2rad(10.0)
    assert (sigma < np.deg2rad(10.0)).all()


def test_neighbouring_frames_resolve_a_half_turn_ambiguity() -> None:
    truth = np.full(20, 0.7)
    log_likelihood = peaks(truth)
    log_likelihood[8:12] = peaks(truth[8:12]) + peaks(truth[8:12] - np.pi) * 1.2
    turns, sigma = likeliest_turns(TURNS_RAD, log_likelihood, unknown(20))
    assert np.abs(turns - truth).max() < np.deg2rad(10.0)
    assert (sigma < np.deg2rad(10.0)).all()


def test_two_equally_likely_turns_give_a_sigma_that_spans_their_distance() -> None:
    truth = np.full(15, np.deg2rad(60.0))
    turns, sigma = likeliest_turns(TURNS_RAD, peaks(truth, 6.0) + peaks(truth - np.deg2rad(120.0), 6.0), unknown(15))
    assert set(np.round(np.rad2deg(turns))) in ({60.0}, {-60.0})
    assert np.rad2deg(sigma) == pytest.approx(120.0 * np.sqrt(0.5), rel=0.1)


def test_uniform_likelihoods_give_a_large_sigma() -> None:
    turns, sigma = likeliest_turns(TURNS_RAD, np.zeros((10, len(TURNS_RAD))), unknown(10))
    assert turns.shape == sigma.shape == (10,)
    assert (sigma > np.deg2rad(60.0)).all()


def test_measured_changes_between_frames_combine_their_likelihoods() -> None:
    truth = 0.4 + 0.6 * np.sin(np.linspace(0.0, 6.0, 30))
    log_likelihood = peaks(truth, 1.0)
    change = np.diff(truth)
    turns, sigma = likeliest_turns(TURNS_RAD, log_likelihood, change)
    _, alone = likeliest_turns(TURNS_RAD, log_likelihood, unknown(30))
    assert np.abs(turns - truth).max() < np.deg2rad(5.0)
    assert (sigma < np.deg2rad(6.0)).all()
    assert (sigma < 0.5 * alone).all()


def test_likelihoods_override_a_contradicting_measured_change() -> None:
    truth = np.repeat([-0.2, 0.2], 10)
    turns, _ = likeliest_turns(TURNS_RAD, peaks(truth), np.zeros(19))
    assert np.abs(turns - truth).max() < np.deg2rad(8.0)
