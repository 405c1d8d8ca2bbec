import numpy as np
import pytest

from kinebench_drake.grounding.anomaly.jumps import MAX_WIDTH_M, find_finger_faults


def grasp(seed, noise_m=0.003):
    """Fingers that close as fast as they can at frame 15 and open at frame 35."""
    frames = np.arange(49.0)
    width = np.interp(frames, [15, 18.5, 35, 38.5], [0.075, 0.01, 0.01, 0.075])
    return np.clip(width + np.random.default_rng(seed).normal(0, noise_m, 49), 0.0, MAX_WIDTH_M)


def test_fingers_as_fast_as_the_makers_limit_are_plausible(t_s):
    for seed in range(60):
        assert find_finger_faults(grasp(seed), t_s).peak < 1.0


@pytest.mark.parametrize("size_m", [0.05, 0.06])
def test_a_jump_is_named_where_it_is(t_s, size_m):
    for seed in range(20):
        width = grasp(seed)
        width[26:30] += size_m
        found = find_finger_faults(width, t_s).anomalies
        assert [abs(a.frame_start - f) <= 1 for a, f in zip(found, (26, 30), strict=True)] == [True, True]


def test_a_flutter_is_named_and_one_wild_frame_is_not(t_s):
    width = grasp(1)
    width[22:30] += 0.02 + 0.02 * (-1.0) ** np.arange(8)
    (found,) = find_finger_faults(width, t_s).anomalies
    assert abs(found.frame_start - 22) <= 1
    assert abs(found.frame_end - 29) <= 1
    wild = grasp(1)
    wild[25] += 0.05
    assert find_finger_faults(wild, t_s).anomalies == ()


def test_a_gap_wider_than_the_gripper_is_impossible(t_s):
    assert find_finger_faults(np.full(49, 0.12), t_s).anomalies
    assert not find_finger_faults(np.full(49, 0.08), t_s).anomalies


def test_unknown_gaps_say_nothing(t_s):
    width = grasp(0)
    width[::2] = np.nan
    assert find_finger_faults(width, t_s).peak < 1.0
    assert find_finger_faults(np.full(49, np.nan), t_s).peak == 0.0
