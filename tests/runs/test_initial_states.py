"""Known first frames of benchmark episodes."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.formats.videos.sample import VideoSample
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.runs.preparation import with_initial_states
from kinebench_drake.suites.start import start_q
from kinebench_drake.track import InitialState


@pytest.fixture
def sample(tmp_path) -> VideoSample:
    (tmp_path / "a.mp4").touch()
    return find_samples(tmp_path).samples[0]


def test_task_and_seed_of_an_episode_determine_its_initial_state(sample: VideoSample) -> None:
    (told,) = with_initial_states([replace(sample, task="PullCube-v1", seed=7)])
    assert told.initial_state is not None
    np.testing.assert_allclose(told.initial_state.X_BG, ArmPlant().forward(start_q("PullCube-v1", 7)[:7]), atol=1e-12)
    assert told.initial_state.finger_width_m == 0.0


@pytest.mark.parametrize(("task", "seed"), [("PullCube-v1", None), (None, 3), ("Juggle-v1", 3)])
def test_a_sample_without_task_or_seed_has_no_initial_state(
    sample: VideoSample, task: str | None, seed: int | None
) -> None:
    (told,) = with_initial_states([replace(sample, task=task, seed=seed)])
    assert told.initial_state is None


def test_the_initial_state_of_a_manifest_has_precedence(sample: VideoSample) -> None:
    own = InitialState(X_BG=np.eye(4))
    (told,) = with_initial_states([replace(sample, task="PullCube-v1", seed=7, initial_state=own)])
    assert told.initial_state is own
