"""One demonstration: its clips and its truth."""

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.formats.demo import FRAME_CHOICES, Demo, RenderOptions
from tests.suites.formats.records import doubled


def test_clips_are_filmed_at_control_steps() -> None:
    assert {25, 49, 97, 193} <= set(FRAME_CHOICES)
    for frames in FRAME_CHOICES:
        shots = RenderOptions(frames=frames)
        assert shots.every * (frames - 1) == 192
        assert shots.frame_period_s * (frames - 1) == pytest.approx(9.6)
    with pytest.raises(UsageError, match="25, 33, 49"):
        RenderOptions(frames=50)


@pytest.mark.sapien
def test_truth_holds_things_where_the_scene_had_them(demo: Demo) -> None:
    truth = demo.truth()
    placements = demo.rollout.episode.layout().placements
    for k, name in enumerate(truth["objects"]):
        assert np.allclose(truth["base_from_object"][0, k], placements[name].X_BM, atol=1e-3)
    assert np.allclose(truth["control_q"][-1], truth["q"][-1], atol=0.01)  # the servos have caught up
    assert truth["t_s"][-1] == pytest.approx(9.6)


@pytest.mark.sapien
def test_clips_of_a_long_demonstration_meet(demo: Demo) -> None:
    long = doubled(demo)
    assert long.clips == 2
    first, second = long.clip(0), long.clip(1)
    for clip in (first, second):
        assert len(clip.rollout.snapshots) == 49
        assert len(clip.rollout.controls) == 192
        assert clip.truth()["t_s"][0] == 0.0
    assert first.video is not None
    assert second.video is not None
    assert np.array_equal(first.video.rgb[-1], second.video.rgb[0])
