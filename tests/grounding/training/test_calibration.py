"""Degradation of held-out videos."""

from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.grounding.evaluation.clip import find_clips
from kinebench_drake.grounding.training.calibration import VideoDegradation, degrade_video
from kinebench_drake.io.reader import read_video

CLIP = find_clips(Path(__file__).parents[3] / "examples" / "videos")[0].load()
FRAMES = read_video(CLIP.path).frames[:6]


@pytest.mark.parametrize("degradation", list(VideoDegradation))
def test_the_same_seed_makes_the_same_frames(degradation: VideoDegradation) -> None:
    worse = degrade_video(FRAMES, CLIP, degradation, [0, 1])
    np.testing.assert_array_equal(worse, degrade_video(FRAMES, CLIP, degradation, [0, 1]))
    assert worse.shape == FRAMES.shape
    assert (worse == FRAMES).all() == (degradation is VideoDegradation.NONE)
    if degradation is not VideoDegradation.NONE:
        assert (worse != degrade_video(FRAMES, CLIP, degradation, [0, 2])).any()


def test_occluders_are_static() -> None:
    worse = degrade_video(FRAMES, CLIP, VideoDegradation.OCCLUDED, [0, 1])
    changed = (worse != FRAMES).any(axis=(0, 3))
    assert 0.002 < changed.mean() < 0.5
    np.testing.assert_array_equal(worse[0][changed], worse[5][changed])
