from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.metrics.smoothness import ldlj, runs, sparc, track_smoothness
from kinebench_drake.products import GripperTrack


def _bell(n: int) -> Array:
    """Speed of a minimum-jerk movement, sampled n times."""
    s = np.linspace(0, 1, n)
    return 30.0 * s**2 * (1 - s) ** 2


def _track(n: int = 50, period_s: float = 0.1, size_m: float = 0.3, size_rad: float = 0.8) -> GripperTrack:
    """One minimum-jerk movement along a line and about an axis."""
    s = np.linspace(0, 1, n)
    s = 10 * s**3 - 15 * s**4 + 6 * s**5
    X = make_pose(rotation_exp(size_rad * s[:, None] * [0.0, 0.6, 0.8]), size_m * s[:, None] * [0.6, 0.0, 0.8])
    return GripperTrack(
        t_s=period_s * np.arange(n),
        X_CH=X,
        X_BG=X,
        tracked=np.ones(n, dtype=bool),
        confidence=np.ones(n),
        finger_width_m=np.full(n, 0.04),
    )


def _with_gap(track: GripperTrack, lost: slice) -> GripperTrack:
    X, tracked = track.X_BG.copy(), track.tracked.copy()
    X[lost], tracked[lost] = np.nan, False
    return replace(track, X_CH=X, X_BG=X, tracked=tracked)


def test_the_references_documented_values() -> None:
    t = np.arange(-1, 1, 0.01)
    move = np.exp(-5 * t**2)
    assert sparc(move, 100.0) == pytest.approx(-1.41403, abs=5e-6)
    assert ldlj(move, 100.0) == pytest.approx(-5.81636, abs=5e-6)


@pytest.mark.parametrize("fs", [5.0, 10.0, 12.0, 17.0, 30.0, 100.0])
def test_sparc_of_a_smooth_movement_is_the_same_at_any_frame_rate(fs: float) -> None:
    assert sparc(_bell(int(4 * fs) + 1), fs) == pytest.approx(-1.40, abs=0.02)


def test_mirrored_bins_would_double_the_arc() -> None:
    """What the clamp at half the sampling rate is for: the reference scores this movement -2.99 at 10 Hz."""
    speed = _bell(21)
    bins = 2 ** (5 + 4)
    magnitude = np.abs(np.fft.fft(speed, bins)) / np.abs(np.fft.fft(speed, bins)).max()
    frequency = np.arange(bins) * 10.0 / bins
    end = np.flatnonzero(magnitude >= 0.05)[-1] + 1
    df = np.diff(frequency[:end]) / frequency[end - 1]
    mirrored = -np.sum(np.hypot(df, np.diff(magnitude[:end])))
    assert mirrored < -2.5
    value = sparc(speed, 10.0)
    assert value is not None
    assert value > -1.5


def test_both_fall_with_every_stop_and_with_noise() -> None:
    one, three = _bell(101), np.concatenate([_bell(34)] * 3)
    noisy = one + 0.4 * np.random.default_rng(0).normal(size=101)
    for metric in (sparc, ldlj):
        smooth, stops, rough = metric(one, 50.0), metric(three, 50.0), metric(noisy, 50.0)
        assert smooth is not None
        assert stops is not None
        assert rough is not None
        assert stops < smooth - 0.3
        assert rough < smooth - 0.05


@pytest.mark.parametrize(("amplitude", "stretch"), [(7.0, 1.0), (0.01, 1.0), (1.0, 4.0), (3.0, 0.25)])
def test_ldlj_ignores_size_and_pace(amplitude: float, stretch: float) -> None:
    speed = _bell(80)
    assert ldlj(amplitude * speed / stretch, 50.0 / stretch) == pytest.approx(ldlj(speed, 50.0), rel=1e-9)


def test_sparc_ignores_size() -> None:
    assert sparc(0.03 * _bell(80), 50.0) == pytest.approx(sparc(_bell(80), 50.0), rel=1e-9)


def test_ldlj_of_a_minimum_jerk_movement_is_the_closed_form() -> None:
    """v = 30 s^2 (1 - s)^2 over unit time: integral of (d2v/ds2)^2 = 720, peak 1.875."""
    assert ldlj(_bell(20001), 20000.0) == pytest.approx(-np.log(720.0 / 1.875**2), rel=1e-3)


@pytest.mark.parametrize("speed", [np.zeros(20), np.array([]), np.array([1.0]), np.full(20, np.nan)])
def test_what_does_not_move_has_no_smoothness(speed: Array) -> None:
    assert sparc(speed, 10.0) is None
    assert ldlj(speed, 10.0) is None


def test_a_track_is_judged_by_its_two_speeds() -> None:
    result = track_smoothness(_track())
    assert result.sparc == pytest.approx(-1.40, abs=0.02)
    assert result.sparc_rotation == pytest.approx(-1.40, abs=0.02)
    fine = track_smoothness(_track(1000, 0.005))
    assert fine.ldlj == pytest.approx(-np.log(720.0 / 1.875**2), abs=0.02)


def test_translation_and_rotation_are_told_apart() -> None:
    slides, turns = track_smoothness(_track(size_rad=0.0)), track_smoothness(_track(size_m=0.0))
    assert slides.sparc is not None
    assert slides.sparc_rotation is None
    assert turns.sparc is None
    assert turns.ldlj is None
    assert turns.sparc_rotation is not None


def test_tracking_noise_of_a_still_gripper_is_not_judged() -> None:
    track = _track(size_m=0.0, size_rad=0.0)
    X = track.X_BG.copy()
    X[:, :3, 3] += np.random.default_rng(0).normal(scale=5e-4, size=(50, 3))
    still = track_smoothness(replace(track, X_BG=X))
    assert (still.sparc, still.sparc_rotation, still.ldlj) == (None, None, None)


def test_the_longest_tracked_run_is_judged_and_nothing_else() -> None:
    whole = _track(60)
    gap = _with_gap(whole, slice(20, 23))
    rest = slice(23, 60)
    cut = GripperTrack(
        t_s=whole.t_s[rest],
        X_CH=whole.X_CH[rest],
        X_BG=whole.X_BG[rest],
        tracked=whole.tracked[rest],
        confidence=whole.confidence[rest],
        finger_width_m=whole.finger_width_m[rest],
    )
    ours, expected = track_smoothness(gap), track_smoothness(cut)
    assert ours.sparc == pytest.approx(expected.sparc, rel=1e-6)
    assert ours.ldlj == pytest.approx(expected.ldlj, rel=1e-6)


@pytest.mark.parametrize("lost", [slice(0, 50), slice(5, 46)])
def test_too_few_tracked_frames_give_none(lost: slice) -> None:
    result = track_smoothness(_with_gap(_track(), lost))
    assert (result.sparc, result.sparc_rotation, result.ldlj) == (None, None, None)


def test_uneven_times_change_little() -> None:
    track = _track(80)
    jitter = 0.02 * np.sin(1.7 * np.arange(80))
    s = np.clip((track.t_s + jitter) / track.t_s[-1], 0, 1)
    s = 10 * s**3 - 15 * s**4 + 6 * s**5
    X = make_pose(np.tile(np.eye(3), (80, 1, 1)), 0.3 * s[:, None] * [1.0, 0.0, 0.0])
    uneven = track_smoothness(replace(track, t_s=track.t_s + jitter, X_BG=X))
    assert uneven.sparc == pytest.approx(-1.40, abs=0.03)


def test_runs_are_the_stretches_of_true() -> None:
    mask = np.array([True, False, True, True, False, True])
    assert runs(mask) == [slice(0, 1), slice(2, 4), slice(5, 6)]
    assert runs(np.zeros(4, dtype=bool)) == []
