"""Known first frames of benchmark episodes."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.episodes import with_first_frames
from kinebench_drake.grounding.known import FirstFrame
from kinebench_drake.inputs import Sample, find_samples
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.start import start_q


@pytest.fixture
def sample(tmp_path) -> Sample:
    (tmp_path / "a.mp4").touch()
    return find_samples(tmp_path).samples[0]


def test_an_episode_tells_where_its_robot_begins(sample: Sample) -> None:
    (told,) = with_first_frames([replace(sample, task="PullCube-v1", seed=7)])
    assert told.first is not None
    np.testing.assert_allclose(told.first.X_BG, ArmPlant().forward(start_q("PullCube-v1", 7)[:7]), atol=1e-12)
    assert told.first.finger_width_m == 0.0


@pytest.mark.parametrize(("task", "seed"), [("PullCube-v1", None), (None, 3), ("Juggle-v1", 3)])
def test_nothing_is_told_of_what_is_no_episode(sample: Sample, task: str | None, seed: int | None) -> None:
    (told,) = with_first_frames([replace(sample, task=task, seed=seed)])
    assert told.first is None


def test_what_the_manifest_says_goes_before(sample: Sample) -> None:
    own = FirstFrame(X_BG=np.eye(4))
    (told,) = with_first_frames([replace(sample, task="PullCube-v1", seed=7, first=own)])
    assert told.first is own
