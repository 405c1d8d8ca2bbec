from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.metrics import smoothness
from kinebench_drake.metrics.noise import TrackNoise, estimate_track_noise
from kinebench_drake.metrics.smoothness import METRICS, measure_smoothness
from kinebench_drake.track import GripperTrack
from tests.metrics.motions import gripper, reach_and_place, with_noise


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
    X = track.X_BG.copy()
    tracked = track.tracked.copy()
    X[lost] = np.nan
    tracked[lost] = False
    return replace(track, X_CH=X, X_BG=X, tracked=tracked)


def sparc(speed: Array, fs: float) -> float:
    return float(smoothness.sparc(speed[None], fs)[0])


def ldlj(speed: Array, fs: float) -> float:
    return float(smoothness.ldlj(speed[None], fs)[0])


def filtered_sparc(t_s: Array, p: Array) -> float:
    return float(smoothness.filtered_sparc(t_s, p[:, None])[0])


def test_the_references_documented_values() -> None:
    t = np.arange(-1, 1, 0.01)
    move = np.exp(-5 * t**2)
    assert sparc(move, 100.0) == pytest.approx(-1.41403, abs=5e-6)
    assert ldlj(move, 100.0) == pytest.approx(-5.81636, abs=5e-6)


def _published_sparc(speed: Array, fs: float) -> float:
    """SPARC as the 2015 paper defines it, step by step: the spectrum, its cut at 10 Hz, at 5 %, the arc's length."""
    bins = 2 ** (int(np.ceil(np.log2(len(speed)))) + 4)
    spectrum = [abs(np.sum(speed * np.exp(-2j * np.pi * k * np.arange(len(speed)) / bins))) for k in range(bins)]
    hz = [k * fs / bins for k in range(bins)]
    peak = max(spectrum)
    selected = [(f, v / peak) for f, v in zip(hz, spectrum, strict=True) if f <= 10.0]
    strong = [i for i, (_, v) in enumerate(selected) if v >= 0.05]
    selected = selected[strong[0] : strong[-1] + 1]
    width = selected[-1][0] - selected[0][0]
    return -sum(float(np.sqrt(((f2 - f1) / width) ** 2 + (v2 - v1) ** 2)) for (f1, v1), (f2, v2) in pairwise(selected))


def _published_ldlj(speed: Array, fs: float) -> float:
    """LDLJ of a speed profile as published: the squared second derivative integrated, times duration^3 / peak^2."""
    jerk = [(speed[i + 2] - 2 * speed[i + 1] + speed[i]) * fs**2 for i in range(len(speed) - 2)]
    return -float(np.log((len(speed) / fs) ** 3 / max(speed) ** 2 * sum(j**2 for j in jerk) / fs))


@pytest.mark.parametrize("fs", [20.0, 30.0, 100.0])
@pytest.mark.parametrize("n", [17, 64, 101])
def test_sparc_and_ldlj_equal_the_published_code(fs: float, n: int) -> None:
    rng = np.random.default_rng(n)
    for speed in (_bell(n), _bell(n) + 0.3 * rng.random(n), rng.random(n)):
        assert sparc(speed, fs) == pytest.approx(_published_sparc(speed, fs), abs=1e-12)
        assert ldlj(speed, fs) == pytest.approx(_published_ldlj(speed, fs), abs=1e-12)


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
    assert sparc(speed, 10.0) > -1.5


def test_both_fall_with_every_stop_and_with_noise() -> None:
    one = _bell(101)
    three = np.concatenate([_bell(34)] * 3)
    noisy = one + 0.4 * np.random.default_rng(0).normal(size=101)
    for metric in (sparc, ldlj):
        smooth = metric(one, 50.0)
        stops = metric(three, 50.0)
        rough = metric(noisy, 50.0)
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


def test_a_track_is_judged_by_its_two_speeds() -> None:
    result = measure_smoothness(_track())
    assert result.metrics["sparc"] == pytest.approx(-1.40, abs=0.02)
    assert result.metrics["sparc_rotation"] == pytest.approx(-1.40, abs=0.02)
    fine = measure_smoothness(_track(1000, 0.005))
    assert fine.metrics["ldlj"] == pytest.approx(-np.log(720.0 / 1.875**2), abs=0.02)


def test_translation_and_rotation_are_measured_separately() -> None:
    slides = measure_smoothness(_track(size_rad=0.0))
    turns = measure_smoothness(_track(size_m=0.0))
    assert slides.metrics["sparc"] is not None
    assert slides.metrics["sparc_rotation"] is None
    assert turns.metrics["sparc"] is None
    assert turns.metrics["ldlj"] is None
    assert turns.metrics["sparc_rotation"] is not None


def test_tracking_noise_of_a_still_gripper_is_not_judged() -> None:
    track = _track(size_m=0.0, size_rad=0.0)
    X = track.X_BG.copy()
    X[:, :3, 3] += np.random.default_rng(0).normal(scale=5e-4, size=(50, 3))
    still = measure_smoothness(replace(track, X_BG=X))
    assert (still.metrics["sparc"], still.metrics["sparc_rotation"], still.metrics["ldlj"]) == (None, None, None)


def test_the_value_is_that_of_the_run_that_holds_nearly_all_frames() -> None:
    whole = _track(60)
    gap = _with_gap(whole, slice(0, 3))
    rest = whole.at(np.arange(3, 60))
    ours = measure_smoothness(gap)
    expected = measure_smoothness(rest).metrics
    for name in ("sparc", "ldlj"):
        assert ours.metrics[name] == pytest.approx(expected[name], rel=1e-6)
        assert ours.bounds[name] < ours.metrics[name]
    assert measure_smoothness(_with_gap(whole, slice(20, 23))).metrics["sparc"] is None


@pytest.mark.parametrize("lost", [slice(0, 50), slice(5, 46)])
def test_too_few_tracked_frames_give_none(lost: slice) -> None:
    result = measure_smoothness(_with_gap(_track(), lost))
    assert (result.metrics["sparc"], result.metrics["sparc_rotation"], result.metrics["ldlj"]) == (None, None, None)


def test_uneven_times_change_little() -> None:
    track = _track(80)
    jitter = 0.02 * np.sin(1.7 * np.arange(80))
    s = np.clip((track.t_s + jitter) / track.t_s[-1], 0, 1)
    s = 10 * s**3 - 15 * s**4 + 6 * s**5
    X = make_pose(np.tile(np.eye(3), (80, 1, 1)), 0.3 * s[:, None] * [1.0, 0.0, 0.0])
    uneven = measure_smoothness(replace(track, t_s=track.t_s + jitter, X_BG=X))
    assert uneven.metrics["sparc"] == pytest.approx(-1.40, abs=0.03)


@pytest.mark.parametrize("fs", [5.0, 8.0, 12.0, 17.0, 20.0, 30.0, 60.0])
def test_filtered_sparc_is_the_same_at_any_frame_rate(fs: float) -> None:
    t_s, X = reach_and_place(1.0 / fs)
    fine_s, fine = reach_and_place(0.005)
    reference = filtered_sparc(fine_s, fine[:, :3, 3])
    assert filtered_sparc(t_s, X[:, :3, 3]) == pytest.approx(reference, abs=0.03)


def test_filtered_sparc_bears_noise_at_high_frame_rates() -> None:
    """Noise that changes the plain SPARC beyond recognition leaves the filtered one nearly as it was."""
    t_s, X = reach_and_place(1.0 / 30.0)
    noisy = with_noise(X, 0.002, 0.0, np.random.default_rng(0))
    clean = measure_smoothness(gripper(t_s, X))
    rough = measure_smoothness(gripper(t_s, noisy))
    assert clean.metrics["sparc"] is not None
    assert clean.metrics["sparc_filtered"] is not None
    assert rough.metrics["sparc"] is not None
    assert abs(rough.metrics["sparc"] - clean.metrics["sparc"]) > 1.0
    assert rough.metrics["sparc_filtered"] == pytest.approx(clean.metrics["sparc_filtered"], abs=0.15)


def test_filtered_sparc_tells_stops_from_one_move() -> None:
    t_s, X = reach_and_place(0.2)
    one = filtered_sparc(t_s, np.outer(np.cumsum(_bell(len(t_s))), [1.0, 0.0, 0.0]))
    four = filtered_sparc(t_s, X[:, :3, 3])
    assert four < one - 0.5
    assert filtered_sparc(t_s, 3.0 * X[:, :3, 3]) == pytest.approx(four, rel=1e-9)


def test_filtered_sparc_needs_the_frames() -> None:
    t_s, X = reach_and_place(0.3)
    result = measure_smoothness(gripper(t_s, X))
    assert result.metrics["sparc_filtered"] is None
    assert "3.33 frames a second" in result.reasons["sparc_filtered"]
    assert result.metrics["sparc"] is not None


@pytest.mark.parametrize("millimetres", [1.0, 3.0])
def test_a_smooth_motion_with_noise_lies_on_its_noise_floor(millimetres: float) -> None:
    t_s, X = reach_and_place(0.05)
    rng = np.random.default_rng(0)
    inside = dict.fromkeys(("sparc", "sparc_rotation", "ldlj"), 0)
    for _ in range(20):
        track = gripper(t_s, with_noise(X, 1e-3 * millimetres, np.deg2rad(0.5 * millimetres), rng))
        metrics = measure_smoothness(track).metrics
        for name in inside:
            value, low, high = (metrics[f"{name}{part}"] for part in ("", "_floor_low", "_floor_high"))
            assert value is not None
            assert low is not None
            assert high is not None
            inside[name] += low <= value <= high
    assert min(inside.values()) >= 13  # of the 18 that nine in ten would be


def test_quick_moves_at_few_frames_lie_near_their_noise_floor() -> None:
    """Six frames a move: the smoothed motion is a little smoother than the true one."""
    t_s, X = reach_and_place(0.2)
    rng = np.random.default_rng(0)
    for _ in range(10):
        result = measure_smoothness(gripper(t_s, with_noise(X, 0.003, np.deg2rad(1.5), rng)))
        for name in METRICS:
            assert result.metrics[name] == pytest.approx(result.metrics[f"{name}_floor_median"], abs=0.7)


def test_a_rough_motion_lies_below_its_noise_floor() -> None:
    t_s, X = reach_and_place(0.02)
    X[:, 0, 3] += 0.004 * np.sin(2 * np.pi * 3.0 * t_s)
    result = measure_smoothness(gripper(t_s, X), TrackNoise(position_m=2e-4, rotation_rad=1e-3))
    assert result.metrics["ldlj"] is not None
    low, median, high = (result.metrics[f"ldlj_floor_{part}"] for part in ("low", "median", "high"))
    assert low <= median <= high
    calm = measure_smoothness(gripper(*reach_and_place(0.02)), TrackNoise(position_m=2e-4, rotation_rad=1e-3))
    assert result.metrics["sparc"] is not None
    assert result.metrics["sparc"] < calm.metrics["sparc_floor_low"]


def test_the_floor_falls_with_the_noise_and_is_narrow_without() -> None:
    t_s, X = reach_and_place(0.05)
    floors = []
    for size in (0.0, 1e-3, 4e-3):
        result = measure_smoothness(gripper(t_s, X), TrackNoise(position_m=size, rotation_rad=size))
        floors.append({part: result.metrics[f"ldlj_floor_{part}"] for part in ("low", "median", "high")})
        if size == 0.0:
            assert result.metrics["ldlj"] == pytest.approx(floors[0]["median"], abs=1e-9)
            assert floors[0]["high"] - floors[0]["low"] < 1e-9
    assert floors[0]["median"] > floors[1]["high"] > floors[1]["low"] > floors[2]["median"]


def test_the_same_track_gives_the_same_floor() -> None:
    t_s, X = reach_and_place(0.2)
    track = gripper(t_s, with_noise(X, 0.003, 0.02, np.random.default_rng(0)))
    first = measure_smoothness(track)
    assert first == measure_smoothness(track, estimate_track_noise(track.t_s, track.X_BG, track.tracked))
    assert first.metrics != measure_smoothness(track, seed=1).metrics


def test_metrics_have_flat_names_and_nulls_have_a_reason() -> None:
    result = measure_smoothness(_track(size_rad=0.0))
    names = {f"{name}{part}" for name in METRICS for part in ("", "_floor_low", "_floor_median", "_floor_high")}
    assert set(result.metrics) == names
    assert set(result.reasons) == {"sparc_rotation", "sparc_rotation_filtered"}
    assert "0.05 rad" in result.reasons["sparc_rotation"]
    short = measure_smoothness(_with_gap(_track(), slice(5, 50)))
    assert set(short.reasons) == set(METRICS)
    assert set(short.metrics.values()) == {None}
    assert "45 of 50 frames are lost or apart, more than 5%" in short.reasons["sparc"]
    assert measure_smoothness(_track()).reasons == {}
    still = measure_smoothness(_with_gap(_track(size_m=0.0), slice(0, 1)))
    assert still.reasons["sparc"] == "the gripper stays within 0.005 m"
    assert still.bounds["sparc"] is None
