"""Faults of recordings: idle ends, lags between action and state, copies."""

import numpy as np
import pytest

from kinebench_drake.geometry import make_pose
from kinebench_drake.metrics.recording_faults import find_action_lag, fingerprint, idle_ends
from kinebench_drake.track import GripperTrack

PERIOD_S = 0.05


def _states(frames: int = 160, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None] * PERIOD_S
    return np.sin(t * rng.uniform(0.5, 3.0, 8) + rng.uniform(0.0, 6.0, 8)).cumsum(axis=0) * PERIOD_S


def _track(x: np.ndarray, gap: np.ndarray | None = None) -> GripperTrack:
    n = len(x)
    X = make_pose(np.tile(np.eye(3), (n, 1, 1)), np.column_stack([x, np.zeros((n, 2))]))
    return GripperTrack(
        t_s=PERIOD_S * np.arange(n), X_CH=np.full_like(X, np.nan), X_BG=X, tracked=np.ones(n, dtype=bool),
        confidence=np.ones(n), finger_width_m=np.full(n, np.nan) if gap is None else gap,
    )  # fmt: skip


@pytest.mark.parametrize("lag", [-9, -1, 0, 1, 4, 13])
def test_the_lag_of_targets_and_of_deltas_is_found(lag: int) -> None:
    states = _states()
    at = np.clip(np.arange(len(states)) + lag, 0, len(states) - 1)
    targets = find_action_lag(states, states[at], PERIOD_S)
    changes = np.diff(states, axis=0, append=states[-1:])
    deltas = find_action_lag(states, 7.0 * changes[at], PERIOD_S)
    assert targets is not None
    assert deltas is not None
    assert (targets.frames, deltas.frames) == (lag, lag)
    assert targets.tolerance < 9


@pytest.mark.parametrize("action", [np.zeros((160, 8)), np.random.default_rng(1).normal(size=(160, 8))])
def test_actions_that_do_not_move_the_state_have_no_lag(action: np.ndarray) -> None:
    assert find_action_lag(_states(), action, PERIOD_S) is None


def test_a_constant_speed_has_no_lag() -> None:
    ramp = np.arange(160.0)[:, None] * np.ones(8)
    assert find_action_lag(ramp, ramp + 1.0, PERIOD_S) is None


@pytest.mark.parametrize(("start", "end"), [(0, 0), (30, 0), (0, 40), (25, 30), (10, 10)])
def test_rests_of_a_second_at_the_ends_are_counted(start: int, end: int) -> None:
    way = np.linspace(0.0, 0.5, 60)
    x = np.concatenate([np.zeros(start), way, np.full(end, 0.5)])
    counts = idle_ends(_track(x + 0.001 * np.random.default_rng(0).normal(size=len(x))))
    assert counts is not None
    for count, planted in zip(counts, (start, end), strict=True):
        assert count == 0 if planted < 20 else planted <= count <= planted + 2


def test_a_gripper_that_closes_does_not_rest_and_one_at_rest_throughout_counts_once() -> None:
    assert idle_ends(_track(np.zeros(60), np.linspace(0.08, 0.0, 60))) == [0, 0]
    assert idle_ends(_track(np.zeros(60))) == [60, 0]


def test_equal_motions_share_a_fingerprint_in_any_precision() -> None:
    states = _states()
    assert fingerprint(states) == fingerprint(states.astype(np.float32))
    assert fingerprint(states) != fingerprint(states[1:])
    assert fingerprint(np.full((3, 7), np.nan)) is None
