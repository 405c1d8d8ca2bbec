"""Laws of the dense score: monotone in every planted fault, no ties, never higher for less evidence or less motion."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.executability import (
    TERMS,
    Executability,
    MotionFaults,
    gather_faults,
    rate_faults,
    start_ratio,
)
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.track import GripperTrack
from tests.metrics.motions import gripper

FRAMES = 25
LEAST_CORRELATION = 0.8
"""Least rank correlation of the score with the size of a fault, with the sign turned."""


@pytest.fixture(scope="module")
def judge(plant: ArmPlant) -> TrackJudge:
    return TrackJudge(plant)


def reach_out(plant: ArmPlant) -> GripperTrack:
    """Track of a video in which the arm swings by half a radian in 4.8 s, seen with 1 mm and 0.3 degrees of noise."""
    rng = np.random.default_rng(1)
    s = np.linspace(0.0, 1.0, FRAMES)[:, None]
    q = np.array([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8]) + 0.5 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    X = plant.forward_path(q)
    X[:, :3, 3] += rng.normal(0.0, 0.001, size=(FRAMES, 3))
    X[:, :3, :3] = X[:, :3, :3] @ rotation_exp(rng.normal(0.0, 0.005, size=(FRAMES, 3)))
    track = gripper(0.2 * np.arange(FRAMES), X)
    return replace(track, confidence=np.full(FRAMES, 0.95), offset_m=0.01, offset_rad=0.087)


def moved(track: GripperTrack, shift: Array) -> GripperTrack:
    X = track.X_BG.copy()
    X[:, :3, 3] += shift
    return replace(track, X_BG=X)


def bump(frames: slice = slice(8, 17)) -> Array:
    weight = np.zeros((FRAMES, 1))
    count = frames.stop - frames.start
    weight[frames, 0] = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
    return weight


def lose(track: GripperTrack, frames: Array) -> GripperTrack:
    lost = np.isin(np.arange(FRAMES), frames)
    X = np.where(lost[:, None, None], np.nan, track.X_BG)
    return replace(track, X_BG=X, X_CH=X, tracked=~lost, confidence=np.where(lost, 0.0, track.confidence))


_NOISE = np.random.default_rng(3).normal(size=(FRAMES, 3))
FAULTS: dict[str, tuple[tuple[float, ...], Callable[[GripperTrack, float], GripperTrack]]] = {
    "teleport [m]": (
        (0.02, 0.04, 0.07, 0.1, 0.14, 0.18, 0.22, 0.26),
        lambda track, size: moved(track, size * (np.arange(FRAMES) >= 12)[:, None] * [0.0, -1.0, 0.0]),
    ),
    "reach [m]": (
        (0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8),
        lambda track, size: moved(track, size * bump() * [1.0, 0.0, 0.2]),
    ),
    "table [m]": (
        (0.22, 0.23, 0.24, 0.25, 0.26, 0.28, 0.3, 0.32),
        lambda track, size: moved(track, size * bump() * [0.0, 0.0, -1.0]),
    ),
    "speed": (
        (1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 14.0),
        lambda track, size: replace(track, t_s=track.t_s / size),
    ),
    "jitter [m]": (
        (0.004, 0.006, 0.009, 0.012, 0.016, 0.02, 0.025, 0.03),
        lambda track, size: moved(track, size * _NOISE),
    ),
    "lost frames": (
        (1, 2, 3, 4, 6, 8, 10, 12),
        lambda track, size: lose(track, np.arange(6, 6 + int(size))),
    ),
    "still frames": (
        (4, 6, 8, 10, 12, 14, 17, 20),
        lambda track, size: replace(track, X_BG=track.X_BG[np.minimum(np.arange(FRAMES), FRAMES - 1 - int(size))]),
    ),
    "doubt": (
        (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        lambda track, size: replace(track, confidence=track.confidence - size),
    ),
}


def rate(judge: TrackJudge, track: GripperTrack, motion_m: float | None = None) -> Executability:
    faults = gather_faults(judge.judge_poses(track), {})
    assert faults is not None
    return rate_faults(faults, motion_m=motion_m)


@pytest.mark.parametrize("kind", FAULTS)
def test_the_score_falls_with_the_size_of_a_fault_without_ties(plant: ArmPlant, judge: TrackJudge, kind: str) -> None:
    clean = reach_out(plant)
    sizes, plant_fault = FAULTS[kind]
    before = rate(judge, clean).score
    scores = [rate(judge, plant_fault(clean, size)).score for size in sizes]
    assert max(scores) < before
    assert spearmanr(sizes, scores).statistic <= -LEAST_CORRELATION
    assert len(set(scores)) == len(scores)


def test_a_clean_motion_is_worth_most_of_what_its_length_and_its_confidence_allow(
    plant: ArmPlant, judge: TrackJudge
) -> None:
    rated = rate(judge, reach_out(plant), motion_m=0.67)
    assert 0.75 < rated.score <= 1.0
    assert rated.terms["motion"] > 0.98
    assert rated.terms["evidence"] == pytest.approx(0.95**0.5)
    assert set(rated.terms) <= {"coverage", *TERMS}


def test_less_than_the_expected_path_is_worth_its_share(plant: ArmPlant, judge: TrackJudge) -> None:
    track = reach_out(plant)
    whole = rate(judge, track, motion_m=0.1).score
    shares = [rate(judge, track, motion_m=length).score / whole for length in (1.0, 2.0, 4.0)]
    assert shares[0] / shares[1] == pytest.approx(2.0)
    assert shares[1] / shares[2] == pytest.approx(2.0)


def test_a_detour_costs_a_part_of_its_excess(plant: ArmPlant, judge: TrackJudge) -> None:
    track = reach_out(plant)
    faults = gather_faults(judge.judge_poses(track), {})
    assert faults is not None
    terms = [rate_faults(faults, motion_m=faults.path_m / times).terms["motion"] for times in (1.0, 2.0, 11.0)]
    assert terms == pytest.approx([1.0, 1.0 / 1.1, 0.5])


def test_too_few_frames_give_no_score(plant: ArmPlant, judge: TrackJudge) -> None:
    half = lose(reach_out(plant), np.arange(13))
    assert gather_faults(judge.judge_poses(half), {}) is None


def faults_of(**ratios: float) -> MotionFaults:
    arrays = {name: np.full(10, ratio) for name, ratio in ratios.items()}
    return MotionFaults(ratios=arrays, lost=np.zeros(10, dtype=bool), path_m=1e9)


def test_the_formula_and_its_weights() -> None:
    assert rate_faults(faults_of(reach=0.0)).score == pytest.approx(1.0)
    one = 2.0**-0.5
    assert rate_faults(faults_of(reach=1.0)).score == pytest.approx(one)
    assert rate_faults(faults_of(reach=1.0, jitter=1.0)).score == pytest.approx(0.5 * one)
    assert rate_faults(faults_of(reach=1.0, jump=1.0)).score == pytest.approx(one * one)
    assert rate_faults(faults_of(reach=1.0, jump=1.0), {"jump": 0.0}).score == pytest.approx(one)
    assert rate_faults(faults_of(reach=np.nan)).score == pytest.approx(1.0)
    lossy = replace(faults_of(reach=0.0), lost=np.arange(10) == 5)
    assert rate_faults(lossy).score == pytest.approx((1.0 - 0.3 ** (1 / 6)) ** 2)
    assert rate_faults(lossy).terms["coverage"] == pytest.approx(rate_faults(lossy).score)


def test_wrong_weights_and_lengths_are_usage_errors() -> None:
    for weights in ({"reach": -1.0}, {"grace": 1.0}):
        with pytest.raises(UsageError, match="expected a number from 0 on"):
            rate_faults(faults_of(reach=0.0), weights)
    with pytest.raises(UsageError, match="motion_m is 0"):
        rate_faults(faults_of(reach=0.0), motion_m=0.0)


def test_another_picture_at_the_start_is_a_fault_and_a_smaller_one_is_not() -> None:
    rng = np.random.default_rng(0)
    image = np.kron(rng.integers(256, size=(16, 16, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    assert start_ratio(image, image[::2, ::2]) < 0.5
    assert start_ratio(image, image[::-1]) > 1.5
