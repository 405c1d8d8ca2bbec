"""Which clips have the camera of a run checked."""

from types import SimpleNamespace

import numpy as np

from kinebench_drake.grounding.camera.watch import CameraWatch


def clip(agreeing: int) -> SimpleNamespace:
    """A clip of 8 frames, every second one measured in full; hand and arm agree in some of these."""
    q = np.full((8, 7), np.nan)
    q[0 : 2 * agreeing : 2] = 0.0
    track = SimpleNamespace(tracked=np.ones(8, dtype=bool))
    return SimpleNamespace(arm_q=q, is_between=np.arange(8) % 2 == 1, track=track)


def checks(watch: CameraWatch, agreeing: list[int], *, passed: list[bool]) -> list[bool]:
    """Return which clips are checked; `passed` are the results of the checks in turn."""
    results = iter(passed)
    due = []
    for count in agreeing:
        due.append(watch.is_due(clip(count)))  # type: ignore[arg-type]
        if due[-1]:
            watch.note(passed=next(results))
    return due


def test_every_clip_is_checked_until_one_passes_then_one_in_three() -> None:
    due = checks(CameraWatch(every=3), [4] * 8, passed=[False, True, True, False, True])
    assert due == [True, True, False, False, True, False, False, True]


def test_a_check_that_fails_has_the_clips_after_it_checked() -> None:
    due = checks(CameraWatch(every=3), [4] * 7, passed=[True, False, False, True])
    assert due == [True, False, False, True, True, True, False]


def test_a_clip_in_which_hand_and_arm_seldom_agree_is_checked_in_any_case() -> None:
    assert checks(CameraWatch(every=5), [4, 4, 1, 0, 4], passed=[True, False, True]) == [True, False, True, True, False]
