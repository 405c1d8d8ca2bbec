"""Clips of the rate of the reward, their faults, and the time by stage."""

import threading
import time

import numpy as np
import pytest

from benchmarks.options import EXAMPLES
from benchmarks.rate import FAULTS, FRAMES, Stopwatch, cut_clips
from benchmarks.reward import Clip


@pytest.fixture(scope="module")
def clips() -> list[Clip]:
    return cut_clips(EXAMPLES)


def test_clips_are_different_and_have_a_pose_in_each_of_25_frames_of_256_px(clips: list[Clip]) -> None:
    assert len({clip.frames.tobytes() for clip in clips}) == len(clips) == 12
    for clip in clips:
        assert clip.frames.shape == (FRAMES, 256, 256, 3)
        assert np.isfinite(clip.p_C).all()
        assert ((clip.hand_px > 0) & (clip.hand_px < 256)).all()


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_begins_in_its_frame_and_all_but_a_teleport_are_over_in_the_next(clips: list[Clip], name: str) -> None:
    clip = clips[0]
    changed = [i for i in range(FRAMES) if (FAULTS[name](clip, 9)[i] != clip.frames[i]).any()]
    assert changed == (list(range(9, FRAMES - 1)) if name.startswith("teleport") else [9])


def test_the_time_of_a_stage_is_without_that_of_stages_in_it() -> None:
    watch = Stopwatch()

    def busy() -> None:
        end = time.thread_time() + 0.02
        while time.thread_time() < end:
            pass

    inner = watch.timed("inner", busy)

    def both() -> None:
        busy()
        inner()

    watch.timed("outer", both)()
    thread = threading.Thread(target=inner)
    thread.start()
    thread.join()
    assert watch.seconds["outer"] == pytest.approx(0.02, abs=0.008)
    assert watch.seconds["inner"] == pytest.approx(0.04, abs=0.016)
