import numpy as np
import pytest

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.discontinuity import JUMP_M, JUMP_RAD, find_discontinuities
from kinebench_drake.metrics.noise import TrackNoise, estimate_track_noise
from kinebench_drake.suites.expert.motion import minimum_jerk
from kinebench_drake.violation import Violation, ViolationKind
from tests.metrics.motions import reach_and_place, with_noise

CLEAN = TrackNoise(position_m=0.0, rotation_rad=0.0)
NAMES = tuple(f"panda_joint{i}" for i in range(1, 8))


def _find(t_s: Array, X: Array, noise: TrackNoise | None = None) -> tuple[Violation, ...]:
    tracked = np.isfinite(X[:, 0, 0])
    return find_discontinuities(t_s, X, tracked, noise or estimate_track_noise(t_s, X, tracked))


def _line(t_s: Array, p: Array) -> tuple[Array, Array]:
    """Positions (T, 3), orientation constant."""
    return t_s, make_pose(np.tile(np.eye(3), (len(t_s), 1, 1)), p)


def _moved(X: Array, frames: slice, distance_m: float = 0.0, angle_rad: float = 0.0) -> Array:
    """Poses with some frames displaced along and about one slanted axis."""
    axis = np.array([0.6, -0.64, 0.48])
    X = X.copy()
    X[frames, :3, 3] += distance_m * axis
    X[frames, :3, :3] = rotation_exp(angle_rad * axis) @ X[frames, :3, :3]
    return X


@pytest.mark.parametrize("period_s", [0.2, 1 / 17, 0.05, 1 / 60])
@pytest.mark.parametrize("millimetres", [0.0, 1.0, 3.0, 5.0])
def test_a_noisy_continuous_motion_has_no_discontinuity(period_s: float, millimetres: float) -> None:
    t_s, X = reach_and_place(period_s)
    rng = np.random.default_rng(0)
    for _ in range(10):
        assert _find(t_s, with_noise(X, 1e-3 * millimetres, np.deg2rad(0.5 * millimetres), rng)) == ()


@pytest.mark.parametrize("period_s", [0.2, 0.1, 0.05, 1 / 30])
def test_a_very_fast_move_is_no_discontinuity(period_s: float) -> None:
    """25 cm and 2 rad in 0.6 s, sampled at any phase; also when the frames begin or end within it."""
    for phase in np.linspace(0.0, 1.0, 12, endpoint=False):
        t_s = period_s * (np.arange(-8, 20) + phase)
        done = minimum_jerk(t_s / 0.6)
        X = make_pose(rotation_exp(done[:, None] * [0.0, 1.2, 1.6]), done[:, None] * [0.2, 0.15, 0.0])
        for cut in range(len(t_s) - 4):
            assert _find(t_s[cut:], X[cut:], CLEAN) == ()
            assert _find(t_s[: cut + 4], X[: cut + 4], CLEAN) == ()


@pytest.mark.parametrize("period_s", [0.2, 0.05])
@pytest.mark.parametrize("start_s", [0.6, 1.2, 3.0, 6.0])
@pytest.mark.parametrize(("distance_m", "angle_rad"), [(0.1, 0.0), (0.3, 0.0), (0.0, np.deg2rad(30)), (0.2, 1.0)])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_teleport_at_rest_or_in_motion_is_a_discontinuity_at_its_frame(
    period_s: float, start_s: float, distance_m: float, angle_rad: float, noise: float
) -> None:
    t_s, X = reach_and_place(period_s)
    start = int(np.flatnonzero(t_s >= start_s)[0])
    X = with_noise(X, 1e-3 * noise, np.deg2rad(0.5 * noise), np.random.default_rng(0))
    (jump,) = _find(t_s, _moved(X, slice(start, None), distance_m, angle_rad))
    assert jump.kind is ViolationKind.DISCONTINUITY
    assert (jump.frame_start, jump.frame_end, jump.joint) == (start - 1, start, None)
    assert jump.value == pytest.approx(distance_m or angle_rad, rel=0.4)  # less what the motion may explain
    assert jump.value > jump.limit > 0.0
    assert jump.unit == ("m" if distance_m else "rad")


@pytest.mark.parametrize("period_s", [0.2, 0.05])
@pytest.mark.parametrize("length", [1, 2])
@pytest.mark.parametrize(("distance_m", "angle_rad"), [(0.12, 0.0), (0.0, 0.6)])
def test_a_short_jump_there_and_back_is_one_discontinuity(
    period_s: float, length: int, distance_m: float, angle_rad: float
) -> None:
    t_s, X = reach_and_place(period_s)
    start = int(np.flatnonzero(t_s >= 3.0)[0])
    (jump,) = _find(t_s, _moved(X, slice(start, start + length), distance_m, angle_rad))
    assert (jump.frame_start, jump.frame_end) == (start - 1, start + length)
    assert jump.value == pytest.approx(distance_m or angle_rad, rel=0.3)


def test_two_separate_jumps_are_two_discontinuities() -> None:
    t_s, X = reach_and_place(0.2)
    X = _moved(_moved(X, slice(10, None), 0.2), slice(30, None), -0.2)
    assert [(v.frame_start, v.frame_end) for v in _find(t_s, X)] == [(9, 10), (29, 30)]


def test_a_jump_within_known_or_unknown_noise_is_no_discontinuity() -> None:
    t_s, X = reach_and_place(0.2)
    X = _moved(X, slice(20, None), 0.1)
    assert len(_find(t_s, X, CLEAN)) == 1
    assert _find(t_s, X, TrackNoise(position_m=0.02, rotation_rad=0.1)) == ()
    assert _find(t_s, X, TrackNoise(position_m=np.nan, rotation_rad=np.nan)) == ()


def test_a_shorter_frame_period_reveals_smaller_jumps() -> None:
    """3 cm within 1/60 s would take 100 m/s^2; within 0.2 s it is nothing."""
    for period_s, found in ((0.2, 0), (1 / 60, 1)):
        t_s, X = reach_and_place(period_s)
        assert len(_find(t_s, _moved(X, slice(len(t_s) // 2, None), 0.03))) == found


def test_a_displacement_within_a_long_frame_period_is_no_discontinuity() -> None:
    t_s, X = _line(np.arange(12.0), np.zeros((12, 3)))
    X = _moved(X, slice(6, None), 0.2)
    assert _find(t_s, X, CLEAN) == ()
    assert len(_find(0.2 * t_s, X, CLEAN)) == 1


def test_a_displacement_across_a_gap_is_no_discontinuity() -> None:
    t_s, X = reach_and_place(0.2)
    X = _moved(X, slice(20, None), 0.3)
    X[19] = np.nan
    assert _find(t_s, X) == ()
    X[25:, :3, 3] += 0.2
    assert [(v.frame_start, v.frame_end) for v in _find(t_s, X)] == [(24, 25)]


def test_uneven_frame_periods_are_no_discontinuity() -> None:
    t_s = np.cumsum(np.random.default_rng(0).choice([0.05, 0.2], 60))
    t_s, X = _line(t_s, 0.5 * t_s[:, None] * [1.0, 0.0, 0.0])
    assert _find(t_s, X, CLEAN) == ()


@pytest.mark.parametrize("frames", [0, 1, 2, 3])
def test_a_track_of_three_frames_or_fewer_has_no_discontinuity(frames: int) -> None:
    t_s, X = _line(0.2 * np.arange(frames), np.zeros((frames, 3)))
    X[frames // 2 :, 0, 3] += 1.0
    assert _find(t_s, X) == ()


def test_a_jump_of_joint_angles_names_the_joint(plant: ArmPlant) -> None:
    t_s = 0.2 * np.arange(40)
    q = plant.robot.rest_q + 0.3 * np.sin(0.5 * t_s)[:, None] * np.ones(7)
    q[20:, 4] += 0.6
    X = plant.forward_path(q)
    tracked = np.ones(40, dtype=bool)
    found = find_discontinuities(t_s, X, tracked, CLEAN, q, NAMES)
    joint = [v for v in found if v.joint is not None]
    assert [(v.joint, v.frame_start, v.frame_end) for v in joint] == [("panda_joint5", 19, 20)]
    assert joint[0].value == pytest.approx(0.6, rel=0.05)
    assert joint[0].limit == pytest.approx(JUMP_RAD, rel=0.5)
    assert [(v.frame_start, v.frame_end) for v in found if v.joint is None] == [(19, 20)]
    assert all(v.joint is None for v in find_discontinuities(t_s, X, tracked, CLEAN))


def test_a_full_turn_of_joint_7_is_a_discontinuity_of_the_joint_alone(plant: ArmPlant) -> None:
    t_s = 0.2 * np.arange(40)
    q = np.tile(plant.robot.rest_q, (40, 1))
    q[20:, 6] -= 2.0 * np.pi
    X = plant.forward_path(q)
    (jump,) = find_discontinuities(t_s, X, np.ones(40, dtype=bool), CLEAN, q, NAMES)
    assert jump.joint == "panda_joint7"
    assert jump.value == pytest.approx(2.0 * np.pi)


def test_a_discontinuity_reports_its_threshold() -> None:
    t_s, X = reach_and_place(0.2)
    (shift,) = _find(t_s, _moved(X, slice(24, None), 0.2), CLEAN)
    assert shift.limit == pytest.approx(JUMP_M)
    (turn,) = _find(t_s, _moved(X, slice(24, None), 0.0, 1.0), CLEAN)
    assert turn.limit == pytest.approx(JUMP_RAD)


@pytest.mark.parametrize(("start", "needed_m"), [(1, 0.24), (2, 0.12), (3, 0.06), (45, 0.06), (47, 0.12), (48, 0.24)])
def test_the_threshold_is_higher_near_both_ends_of_a_track(start: int, needed_m: float) -> None:
    t_s, X = _line(0.2 * np.arange(49), np.zeros((49, 3)))
    assert _find(t_s, _moved(X, slice(start, None), 0.98 * needed_m), CLEAN) == ()
    assert len(_find(t_s, _moved(X, slice(start, None), 1.02 * needed_m), CLEAN)) == 1


def test_a_second_jump_nearby_does_not_hide_the_first() -> None:
    t_s, X = _line(0.06 * np.arange(66), np.zeros((66, 3)))
    X = _moved(_moved(X, slice(61, 64), 0.0, 1.0), slice(65, None), 0.0, 1.0)
    first = _find(t_s, X)[0]
    assert (first.frame_start, first.frame_end) == (60, 61)
