import numpy as np
import pytest

from kinebench_drake.grounding.anomaly.jumps import find_teleports, jump_lengths


def test_a_smooth_noisy_path_has_no_jump(reach, seen):
    for seed in range(60):
        assert find_teleports(reach(seed), seen, seen).peak < 1.0


@pytest.mark.parametrize("size_m", [0.05, 0.15])
def test_a_jump_is_named_at_its_frame_with_its_length(reach, seen, size_m):
    lengths = []
    for seed in range(20):
        frame = (3, 20, 45)[seed % 3]
        p = reach(seed, noise_m=0.003, wild=0.0)
        p[frame:] += [0.0, size_m, 0.0]
        (found,) = find_teleports(p, seen, seen).anomalies
        assert found.frame_start == found.frame_end
        assert abs(found.frame_start - frame) <= 1
        lengths.append(found.severity)
    assert np.median(lengths) == pytest.approx(size_m, abs=0.008)


def test_a_jump_there_and_back_is_two(reach, seen):
    p = reach()
    p[20:30] += [0.0, 0.15, 0.0]
    assert [a.frame_start for a in find_teleports(p, seen, seen).anomalies] == [20, 30]


def test_one_wild_frame_is_no_jump(reach, seen):
    for frame in (5, 24, 40):
        p = reach(noise_m=0.002)
        p[frame] += [0.0, 0.2, 0.0]
        assert find_teleports(p, seen, seen).anomalies == ()


def test_even_motion_is_no_jump():
    p = np.arange(20.0)[:, None] * [0.03, 0.01, 0.0]
    assert jump_lengths(p, np.ones(20, dtype=bool)).max() < 1e-12


def test_the_score_grows_with_the_jump(reach, seen):
    def peak(size_m):
        p = reach(3)
        p[25:] += [size_m, 0.0, 0.0]
        return find_teleports(p, seen, seen).peak

    peaks = [peak(size) for size in (0.0, 0.02, 0.05, 0.1)]
    assert peaks == sorted(peaks)


def test_nothing_known_is_no_jump(seen):
    assert find_teleports(np.full((49, 3), np.nan), seen, seen).peak == 0.0
    assert find_teleports(np.zeros((1, 3)), seen[:1], seen[:1]).peak == 0.0


def test_a_jump_to_a_doubtful_frame_is_none(reach, seen):
    p = reach(3)
    p[20] += [0.0, 0.12, 0.0]
    p[21:] += [0.0, 0.06, 0.0]
    assert find_teleports(p, seen, seen).peak > 1.0
    doubtful = seen & (np.arange(len(seen)) != 20)
    assert find_teleports(p, seen, doubtful).peak < 1.0
