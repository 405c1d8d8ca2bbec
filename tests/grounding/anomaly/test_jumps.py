import numpy as np
import pytest

from kinebench_drake.grounding.anomaly.jumps import (
    MAX_WIDTH_M,
    find_finger_faults,
    find_freezes,
    find_teleports,
    is_mixed,
    jump_lengths,
    still_frames,
)


def teleports(p, good, *, covariance=None, mixed=(), period_s=0.2):
    exact = np.zeros((len(p), 3, 3))
    t_s = period_s * np.arange(len(p))
    return find_teleports(p, exact if covariance is None else covariance, good, lambda i: i in mixed, t_s)


def without(visible, *frames):
    return visible & ~np.isin(np.arange(len(visible)), frames)


def test_a_smooth_noisy_path_has_no_teleport(reach, visible):
    for seed in range(60):
        assert teleports(reach(seed), visible).peak < 1.0


@pytest.mark.parametrize("size_m", [0.05, 0.15])
def test_a_teleport_is_reported_at_its_frame_with_its_length(reach, visible, size_m):
    lengths = []
    for seed in range(20):
        frame = (3, 20, 45)[seed % 3]
        p = reach(seed, noise_m=0.003, wild=0.0)
        p[frame:] += [0.0, size_m, 0.0]
        (result,) = teleports(p, visible).anomalies
        assert result.frame_start == result.frame_end
        assert abs(result.frame_start - frame) <= 1
        lengths.append(result.severity)
    assert np.median(lengths) == pytest.approx(size_m, abs=0.008)


@pytest.mark.parametrize("dropped", [1, 2, 3])
def test_dropped_frames_of_a_video_with_time_stamps_are_no_teleport(dropped):
    t_s = np.delete(np.arange(60) / 15.0, np.arange(28, 28 + dropped))
    p = np.outer(0.25 * (1.0 - np.cos(np.pi * t_s / 4.0)), [1.0, 0.5, 0.0])
    fair = np.ones(len(t_s), dtype=bool)
    assert find_teleports(p, np.zeros((len(p), 3, 3)), fair, lambda i: False, t_s).peak < 0.01


def test_a_jump_there_and_back_is_two_teleports(reach, visible):
    p = reach()
    p[20:30] += [0.0, 0.15, 0.0]
    assert [a.frame_start for a in teleports(p, visible).anomalies] == [20, 30]


def test_a_single_outlier_frame_is_no_teleport(reach, visible):
    for frame in (5, 24, 40):
        p = reach(noise_m=0.002)
        p[frame] += [0.0, 0.2, 0.0]
        assert teleports(p, visible).anomalies == ()


def test_the_jump_length_of_uniform_motion_is_zero():
    p = np.arange(20.0)[:, None] * [0.03, 0.01, 0.0]
    lengths, unexplained = jump_lengths(p, np.zeros((20, 3, 3)), np.ones(20, dtype=bool), np.arange(20.0))
    assert lengths.max() < 1e-12
    assert unexplained.max() < 1e-12


def test_the_teleport_score_grows_with_the_length_of_the_jump(reach, visible):
    def peak(size_m):
        p = reach(3)
        p[25:] += [size_m, 0.0, 0.0]
        return teleports(p, visible).peak

    peaks = [peak(size) for size in (0.0, 0.02, 0.05, 0.1)]
    assert peaks == sorted(peaks)


def test_unknown_positions_and_single_frames_are_no_teleport(visible):
    assert teleports(np.full((49, 3), np.nan), visible).peak == 0.0
    assert teleports(np.zeros((1, 3)), visible[:1]).peak == 0.0


def test_a_doubtful_frame_beside_the_path_is_no_teleport_and_hides_none(reach, visible):
    p = reach(3)
    p[20] += [0.0, 0.12, 0.0]
    doubtful = without(visible, 20)
    assert teleports(p, doubtful).peak < 1.0
    p[21:] += [0.0, 0.08, 0.0]
    (result,) = teleports(p, doubtful).anomalies
    assert (result.frame_start, result.severity) == (21, pytest.approx(0.08, abs=0.02))


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_jump_over_lost_frames_is_decided_from_both_sides(reach, visible, missing):
    p = reach(noise_m=0.001, wild=0.0)
    lost = range(20, 20 + missing)
    p[20:] += [0.0, 0.12, 0.0]
    p[lost] = np.nan
    (result,) = teleports(p, visible).anomalies
    assert (result.frame_start, result.severity) == (20 + missing, pytest.approx(0.12, abs=0.03))


@pytest.mark.parametrize("doubtful", [range(20, 26), (18, 19, 21, 22), range(18)])
def test_the_edge_of_a_stretch_of_low_confidence_is_no_teleport(reach, visible, doubtful):
    p = reach(noise_m=0.001, wild=0.0)
    p[20:] += [0.0, 0.15, 0.0]
    assert teleports(p, visible).anomalies
    assert teleports(p, without(visible, *doubtful)).peak < 1.0


@pytest.mark.parametrize("frame", [1, 2, 47, 48])
def test_a_side_of_less_than_three_frames_makes_no_teleport(reach, visible, frame):
    p = reach(noise_m=0.001, wild=0.0)
    p[frame:] += [0.0, 0.15, 0.0]
    assert teleports(p, visible).peak < 1.0


def test_a_jump_across_the_line_of_sight_counts_and_one_that_the_error_in_depth_explains_does_not(reach, visible):
    covariance = np.tile(np.diag([0.0005, 0.0005, 0.005]) ** 2, (len(visible), 1, 1))

    def peak(*jump_m):
        p = reach(noise_m=0.001, wild=0.0)
        p[20:] += jump_m
        return teleports(p, visible, covariance=covariance).peak

    assert peak(0.05, 0.0, 0.0) > 1.0
    assert peak(0.0, 0.05, 0.0) > 1.0
    assert peak(0.0, 0.0, 0.05) < 1.0
    assert peak(0.0, 0.0, 0.15) > 1.0


def test_a_shorter_jump_is_a_teleport_where_the_image_is_a_mixture(reach, visible):
    p = reach(noise_m=0.001, wild=0.0)
    p[20:] += [0.0, 0.026, 0.0]
    assert teleports(p, visible).peak < 1.0
    assert [a.frame_start for a in teleports(p, visible, mixed=[20]).anomalies] == [20]
    assert teleports(p, visible, mixed=[30]).peak < 1.0


def bars(places, shares=None):
    """Return images of a bright bar at each place; with shares, each the mixture of the first and the last one."""
    frames = np.full((len(places), 96, 128, 3), 40, np.uint8)
    for frame, x in zip(frames, places, strict=True):
        frame[20:80, x : x + 30] = 200
    if shares is not None:
        weights = np.array(shares)[:, None, None, None]
        frames = ((1.0 - weights) * frames[0] + weights * frames[-1]).astype(np.uint8)
    return frames


def test_cross_faded_frames_are_mixtures_and_those_of_a_motion_are_none():
    def mixed(frames):
        return [i for i in range(len(frames)) if is_mixed(frames, i)]

    assert mixed(bars([10, 50, 50, 50], [0.0, 0.33, 0.67, 1.0])) == [1, 2]
    assert mixed(bars([10, 22, 34, 46, 58])) == []
    assert mixed(bars([10, 10, 50, 50])) == []
    assert mixed(bars([10, 10, 10, 10])) == []


@pytest.mark.parametrize("length", [5, 8])
def test_a_freeze_begins_in_motion_ends_with_a_jump_and_has_its_length_as_severity(reach, visible, t_s, length):
    p = reach(noise_m=0.001)
    p[20 : 20 + length] = p[19]
    still = np.zeros(49, dtype=bool)
    still[20 : 20 + length] = True
    (result,) = find_freezes(p, visible, still, t_s).anomalies
    assert (result.frame_start, result.frame_end, result.severity) == (20, 19 + length, length)


def test_a_gripper_at_rest_without_a_jump_is_no_freeze(visible, t_s):
    s = np.concatenate([np.sin(np.linspace(0, np.pi / 2, 20)), np.ones(10), np.cos(np.linspace(0, np.pi / 2, 19))])
    p = np.stack([0.3 * s, 0 * s, 0 * s + 0.6], axis=1)
    still = np.zeros(49, dtype=bool)
    still[20:30] = True
    assert find_freezes(p, visible, still, t_s).peak < 1.0


def test_motion_without_repeated_images_is_no_freeze(reach, visible, t_s):
    assert find_freezes(reach(), visible, np.zeros(49, dtype=bool), t_s).peak == 0.0


def test_repeated_images_are_still_despite_noise_and_moving_images_are_not():
    rng = np.random.default_rng(0)
    frames = np.zeros((6, 96, 96, 3), np.uint8)
    for i, x in enumerate((10, 16, 22, 22, 22, 28)):
        frames[i, 30:60, x : x + 30] = 200
    noisy = np.clip(frames + rng.normal(0, 2, frames.shape), 0, 255).astype(np.uint8)
    assert still_frames(noisy).tolist() == [False, False, False, True, True, False]


def grasp(seed, noise_m=0.003):
    """Fingers that close from one frame to the next at frame 16 and open so at frame 36."""
    width = np.where((np.arange(49) >= 16) & (np.arange(49) < 36), 0.01, 0.075)
    return np.clip(width + np.random.default_rng(seed).normal(0, noise_m, 49), 0.0, MAX_WIDTH_M)


def test_fingers_that_close_and_open_within_a_frame_are_no_anomaly():
    for seed in range(60):
        assert find_finger_faults(grasp(seed)).peak < 1.0


def test_fluttering_fingers_are_an_anomaly_and_a_single_outlier_frame_is_none():
    width = grasp(1)
    width[22:30] += 0.02 + 0.02 * (-1.0) ** np.arange(8)
    (result,) = find_finger_faults(width).anomalies
    assert abs(result.frame_start - 22) <= 1
    assert abs(result.frame_end - 29) <= 1
    wild = grasp(1)
    wild[25] += 0.05
    assert find_finger_faults(wild).anomalies == ()


def test_a_finger_width_above_the_grippers_maximum_is_an_anomaly():
    assert find_finger_faults(np.full(49, 0.12)).anomalies
    assert not find_finger_faults(np.full(49, 0.08)).anomalies


def test_unknown_finger_widths_are_no_anomaly():
    width = grasp(0)
    width[::2] = np.nan
    assert find_finger_faults(width).peak < 1.0
    assert find_finger_faults(np.full(49, np.nan)).peak == 0.0


def test_in_longer_steps_a_motion_may_bend_more(visible):
    p = np.zeros((49, 3))
    p[20:, 1] = 0.06
    assert teleports(p, visible).anomalies
    assert not teleports(p, visible, period_s=0.6).anomalies
