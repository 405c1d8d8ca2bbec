"""How far a clip follows the commanded actions: obeying, late, still and shortened clips, lost frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import make_pose, pose_difference, rotation_z
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import HAND_LINK, TCP_LINK
from kinebench_drake.suites.closed_loop.following import (
    ActionSource,
    action_curves,
    measure_following,
    summarize_following,
)
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.worldmodels.reference import OracleModel
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request
from kinebench_drake.track import GripperTrack

PERIOD_S = 0.2
T_S = PERIOD_S * np.arange(49)


def actions() -> ActionTrack:
    """A move along x with a turn, during which the fingers close."""
    s = np.clip((np.arange(49) - 5) / 30, 0, 1)
    X_BG = np.stack([make_pose(rotation_z(0.5 * v), [0.4 + 0.3 * v, 0.0, 0.2]) for v in s])
    return ActionTrack(t_s=T_S, X_BG=X_BG, finger_width_m=0.08 * (1 - s), q=np.outer(s, np.ones(7)))


def track(X_BG: np.ndarray, finger_width_m: np.ndarray, t_s: np.ndarray = T_S) -> GripperTrack:
    """A grounded track without losses."""
    n = len(t_s)
    return GripperTrack(
        t_s=t_s,
        X_CH=X_BG,
        X_BG=X_BG,
        tracked=np.ones(n, dtype=bool),
        confidence=np.ones(n),
        finger_width_m=finger_width_m,
    )


def obeying(delay: int = 0) -> GripperTrack:
    frames = np.maximum(np.arange(49) - delay, 0)
    return track(actions().X_BG[frames], actions().finger_width_m[frames])


def summary(clip: GripperTrack) -> dict[str, float | None]:
    return summarize_following([measure_following(clip, actions(), "id", 0)], PERIOD_S)


def test_a_clip_that_follows_the_actions_has_no_error() -> None:
    found = summary(obeying())
    for name in ("action_error_m", "action_error_rad", "action_error_finger_m", "action_lag_s"):
        assert found[name] == pytest.approx(0.0, abs=1e-6)
    assert found["action_shuffled_m"] > 0.05
    assert found["action_following"] == pytest.approx(1.0)


@pytest.mark.parametrize("delay", [1, 2, 5])
def test_the_error_of_a_late_clip_is_the_motion_during_its_lag(delay: int) -> None:
    found = summary(obeying(delay))
    assert found["action_error_m"] == pytest.approx(0.3 * delay / 30)
    assert found["action_error_rad"] == pytest.approx(0.5 * delay / 30)
    assert found["action_error_finger_m"] == pytest.approx(0.08 * delay / 30)
    assert found["action_lag_s"] == pytest.approx(PERIOD_S * delay)


def test_a_still_clip_has_action_following_zero_and_no_lag() -> None:
    """Its error is that against the same commanded frames in another order."""
    found = summary(track(np.repeat(actions().X_BG[:1], 49, axis=0), np.full(49, 0.08)))
    assert found["action_error_m"] == pytest.approx(found["action_shuffled_m"])
    assert found["action_error_finger_m"] == pytest.approx(found["action_shuffled_finger_m"])
    assert found["action_error_m"] > 0.1
    assert (found["action_following"], found["action_lag_s"]) == (pytest.approx(0.0), None)


def test_actions_are_interpolated_at_the_times_of_the_frames() -> None:
    """A clip of 25 frames over the same time, and one that goes on after the last action, have no error."""
    half = np.arange(0, 49, 2)
    for clip in (
        track(actions().X_BG[half], actions().finger_width_m[half], T_S[half]),
        track(
            np.concatenate([actions().X_BG, np.repeat(actions().X_BG[:1], 8, axis=0)]),
            np.append(actions().finger_width_m, np.full(8, 0.08)),
            PERIOD_S * np.arange(57),
        ),
    ):
        assert summary(clip)["action_error_m"] == pytest.approx(0.0, abs=1e-6)


def test_a_clip_that_ends_early_lacks_frames() -> None:
    first = np.arange(30)
    short = track(actions().X_BG[first], actions().finger_width_m[first], T_S[first])
    assert np.isnan(measure_following(short, actions(), "id").commanded.distance_m).sum() == 19
    assert summary(short)["action_error_m"] == pytest.approx(0.0, abs=1e-6)
    first = np.arange(20)
    shorter = track(actions().X_BG[first], actions().finger_width_m[first], T_S[first])
    assert summary(shorter)["action_error_m"] is None


@given(lost=st.sets(st.integers(0, 48), max_size=40), delay=st.integers(0, 4))
def test_lost_frames_never_improve_action_errors(lost: set[int], delay: int) -> None:
    whole = obeying(delay)
    tracked = ~np.isin(np.arange(49), list(lost))
    X_BG = np.where(tracked[:, None, None], whole.X_BG, np.nan)
    fingers = np.where(tracked, whole.finger_width_m, np.nan)
    before = summary(whole)
    after = summary(replace(whole, X_BG=X_BG, tracked=tracked, finger_width_m=fingers))
    for name in ("action_error_m", "action_error_rad", "action_error_finger_m"):
        assert after[name] is None or after[name] >= before[name] - 1e-9
    assert after["action_following"] is None or after["action_following"] <= before["action_following"] + 1e-9
    if (~tracked[1:]).sum() > 24:
        assert after["action_error_m"] is None


def test_clips_of_an_episode_are_summarized_together() -> None:
    clips = [measure_following(obeying(delay), actions(), "id", delay) for delay in (0, 2)]
    joined = summarize_following(clips, PERIOD_S)
    assert 0.0 <= joined["action_error_m"] <= 0.02
    curves = action_curves([obeying(), obeying()], [actions(), actions()])
    assert curves["commanded_q"].shape == (97, 7)
    np.testing.assert_allclose(curves["commanded_finger_width_m"][49:], actions().finger_width_m[1:])
    assert action_curves([obeying()], [None]) == {}


def test_actions_are_serialized_as_json() -> None:
    told = actions().to_json()
    assert list(told) == ["t_s", "base_from_tcp", "finger_width_m", "q"]
    np.testing.assert_allclose(told["base_from_tcp"], actions().X_BG, atol=1e-8)


@pytest.mark.sapien
def test_the_oracle_executes_the_commanded_actions(tmp_path: Path) -> None:
    """The actions are what the oracle shows, and what the late oracle shows two frames later."""
    episode = compose("PullCube-v1", 0)
    with Simulator(episode.task, camera=benchmark_camera().resized(128, 128)) as simulator:
        simulator.reset(episode)
        state = simulator.simulation_state()
        first = simulator.render().rgb
        X_GH = np.linalg.inv(simulator.link_pose(TCP_LINK)) @ simulator.link_pose(HAND_LINK)
    request = Request(
        episode=episode.id, task=episode.task, round=0, prompt="", negative_prompt="", seed=0, first_frame=first,
        num_frames=25, fps=17,
    )  # fmt: skip
    source = ActionSource(ArmPlant(), 128)
    asked = source.track(episode, state, 25, 0.2)
    source.close()
    assert np.ptp(asked.X_BG[:, :3, 3], axis=0).max() > 0.05
    for delay in (0, 2):
        model = OracleModel(delay=delay)
        model.set_state(episode, state)
        model.generate(request, tmp_path / "clip")
        shown = benchmark_camera().X_BC @ model.truth.X_CH[delay:]
        model.close()
        distance, angle = pose_difference(asked.X_BG[: 25 - delay] @ X_GH, shown)
        assert distance.max() < 1e-4
        assert angle.max() < 1e-3
        np.testing.assert_allclose(model.truth.finger_width_m[delay:], asked.finger_width_m[: 25 - delay], atol=1e-5)
