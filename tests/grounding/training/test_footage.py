"""Videos made worse for the calibration."""

from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.grounding.evaluation.clip import load_clips
from kinebench_drake.grounding.training.holdout import Degradations, spoil
from kinebench_drake.io.reader import read_video

CLIP = load_clips(Path(__file__).parents[3] / "examples" / "videos")[0]
FRAMES = read_video(CLIP.path).frames[:6]


@pytest.mark.parametrize("trouble", list(Degradations))
def test_the_same_seed_makes_the_same_frames(trouble: Degradations) -> None:
    worse = spoil(FRAMES, CLIP, trouble, [0, 1])
    np.testing.assert_array_equal(worse, spoil(FRAMES, CLIP, trouble, [0, 1]))
    assert worse.shape == FRAMES.shape
    assert (worse == FRAMES).all() == (trouble is Degradations.NONE)
    if trouble is not Degradations.NONE:
        assert (worse != spoil(FRAMES, CLIP, trouble, [0, 2])).any()


def test_things_stand_still_before_the_frames() -> None:
    worse = spoil(FRAMES, CLIP, Degradations.OCCLUDED, [0, 1])
    changed = (worse != FRAMES).any(axis=(0, 3))
    assert 0.002 < changed.mean() < 0.5
    np.testing.assert_array_equal(worse[0][changed], worse[5][changed])
