import numpy as np
import pytest

from kinebench_drake.grounding.anomaly.jumps import find_freezes, still_frames


@pytest.mark.parametrize("length", [5, 8])
def test_a_freeze_begins_in_motion_and_ends_with_a_jump(reach, seen, t_s, length):
    p = reach(noise_m=0.001)
    p[20 : 20 + length] = p[19]
    still = np.zeros(49, dtype=bool)
    still[20 : 20 + length] = True
    (found,) = find_freezes(p, seen, still, t_s).anomalies
    assert (found.frame_start, found.frame_end, found.severity) == (20, 19 + length, length)


def test_a_dwell_is_no_freeze(seen, t_s):
    s = np.concatenate([np.sin(np.linspace(0, np.pi / 2, 20)), np.ones(10), np.cos(np.linspace(0, np.pi / 2, 19))])
    p = np.stack([0.3 * s, 0 * s, 0 * s + 0.6], axis=1)
    still = np.zeros(49, dtype=bool)
    still[20:30] = True
    assert find_freezes(p, seen, still, t_s).peak < 1.0


def test_a_pause_of_a_moving_picture_is_no_freeze(reach, seen, t_s):
    assert find_freezes(reach(), seen, np.zeros(49, dtype=bool), t_s).peak == 0.0


def test_repeated_pictures_are_still_and_moving_ones_are_not():
    rng = np.random.default_rng(0)
    frames = np.zeros((6, 96, 96, 3), np.uint8)
    for i, x in enumerate((10, 16, 22, 22, 22, 28)):
        frames[i, 30:60, x : x + 30] = 200
    noisy = np.clip(frames + rng.normal(0, 2, frames.shape), 0, 255).astype(np.uint8)
    assert still_frames(noisy).tolist() == [False, False, False, True, True, False]
