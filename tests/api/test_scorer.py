"""Rewards: bounded, higher for what a robot can do, and never higher because frames are lost."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake import Scorer
from kinebench_drake.errors import UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.runs.evaluator import judge_row
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.track import GripperTrack
from tests.rows import make_row

FRAMES = 25


@pytest.fixture(scope="module")
def tools() -> Resources:
    return Resources(RobotOptions())


def follow(q: Array, tools: Resources) -> GripperTrack:
    """Track that a video of joint angles shows."""
    X_BG = tools.plant.forward_path(q)
    confidence = np.linspace(0.9, 1.0, FRAMES)
    return GripperTrack(
        t_s=0.2 * np.arange(FRAMES), X_CH=X_BG, X_BG=X_BG, tracked=np.ones(FRAMES, dtype=bool), confidence=confidence,
        finger_width_m=np.full(FRAMES, 0.08), offset_m=0.003, offset_rad=0.02,
    )  # fmt: skip


def lose(track: GripperTrack, frames: Array) -> GripperTrack:
    lost = np.isin(np.arange(FRAMES), frames)
    X = np.where(lost[:, None, None], np.nan, track.X_BG)
    return replace(
        track, X_BG=X, X_CH=X, tracked=~lost, confidence=np.where(lost, 0.0, track.confidence),
        finger_width_m=np.where(lost, np.nan, track.finger_width_m),
    )  # fmt: skip


def reward(track: GripperTrack, tools: Resources) -> float:
    row = judge_row(make_row(metrics={"anomalies": []}), tools.judge(track))
    return row.metrics.number("executability") or 0.0


def motions() -> dict[str, Array]:
    s = np.linspace(0.0, 1.0, FRAMES)[:, None]
    slow = np.array([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.8]) + 0.5 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    jump = slow + np.where(np.arange(FRAMES) >= 12, 0.5, 0.0)[:, None] * np.array([1, 0, 0, 0, 0, 0, 0])
    return {"slow": slow, "jump": jump, "still": slow[:1].repeat(FRAMES, axis=0)}


def test_a_motion_is_worth_more_than_a_jump_and_standing_still_nothing(tools: Resources) -> None:
    rewards = {name: reward(follow(q, tools), tools) for name, q in motions().items()}
    assert 0.7 < rewards["slow"] <= 1.0
    assert rewards["jump"] < 0.85 * rewards["slow"]
    assert rewards["still"] < 0.001


@pytest.mark.parametrize("name", ["slow", "jump"])
def test_losing_frames_never_raises_the_reward(name: str, tools: Resources) -> None:
    rng = np.random.default_rng(0)
    track = follow(motions()[name], tools)
    before = reward(track, tools)
    losses = [np.arange(10, 14), np.arange(11, 13), np.array([12]), np.array([11]), np.arange(20, 25)]
    losses += [rng.choice(FRAMES, size=int(rng.integers(1, 8)), replace=False) for _ in range(8)]
    for lost in losses:
        assert reward(lose(track, lost), tools) < before, lost


def test_a_clip_that_cannot_be_measured_has_no_reward_and_a_reason() -> None:
    score = Scorer()(np.zeros((9, 96, 96, 3), np.uint8), camera="benchmark", period_s=0.2)
    assert (score.reward, score.executability, score.executable) == (0.0, None, None)
    assert score.reasons[0]


def test_wrong_arguments_are_usage_errors() -> None:
    with pytest.raises(UsageError, match="jobs is 0"):
        Scorer(jobs=0)
    with pytest.raises(UsageError, match="stride is 0"):
        Scorer(stride=0)
    with pytest.raises(UsageError, match="nowhere"):
        Scorer(camera="nowhere")
    with pytest.raises(UsageError, match="period_s"):
        Scorer()(np.zeros((9, 96, 96, 3), np.uint8), period_s=-1.0)
