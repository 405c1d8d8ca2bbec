import numpy as np
import pytest

from kinebench_drake.kinematics import timing
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.timing import time_scale
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.violation import ViolationKind

SWING = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # joint 1 turns the whole arm about the vertical: no weight


def _rest_to_rest(u: np.ndarray) -> np.ndarray:
    return 0.5 - 0.5 * np.cos(np.pi * u)


def _trapezoid_s(way: float, speed: float, acceleration: float) -> float:
    """Least duration of a move from rest to rest: bang-bang, with a plateau where the speed limit is met."""
    if way < speed**2 / acceleration:
        return 2.0 * float(np.sqrt(way / acceleration))
    return way / speed + speed / acceleration


@pytest.mark.parametrize("way", [1.0, 0.2])
@pytest.mark.parametrize("frames", [25, 49, 150])
def test_a_move_from_rest_to_rest_takes_the_time_of_a_trapezoidal_profile(
    plant: ArmPlant, way: float, frames: int
) -> None:
    t = np.linspace(0.0, 9.6, frames)
    scale = time_scale(plant, t, rest_q() + way * _rest_to_rest(t / 9.6)[:, None] * SWING)
    assert scale.value is not None
    expected = _trapezoid_s(way, plant.velocity_limits[0], 15.0)
    assert scale.value * 9.6 == pytest.approx(expected, rel=5e-3)
    assert scale.joint == "panda_joint1"
    assert scale.constraint is (ViolationKind.VELOCITY if way == 1.0 else ViolationKind.ACCELERATION)


def test_time_scale_keeps_the_speeds_at_both_ends(plant: ArmPlant) -> None:
    """At half the speed limit throughout: accelerate from there, cruise at the limit, brake to there again."""
    v = plant.velocity_limits[0]
    a = 15.0
    way = 1.0
    t = np.linspace(0.0, way / (0.5 * v), 49)
    scale = time_scale(plant, t, rest_q() + (0.5 * v * t)[:, None] * SWING)
    ramp = 0.5 * v / a
    expected = 2.0 * ramp + (way - 2.0 * ramp * 0.75 * v) / v
    assert scale.value == pytest.approx(expected / t[-1], rel=2e-3)


def test_time_scale_of_an_irregularly_sampled_path_is_below_one(plant: ArmPlant) -> None:
    t = np.sort(np.random.default_rng(0).uniform(0.0, 5.0, 60))
    q = rest_q() + 0.2 * np.sin(t)[:, None] * np.array([1.0, 0.5, -1.0, 0.7, 1.0, -0.5, 2.0])
    scale = time_scale(plant, t, q)
    assert scale.value is not None
    assert scale.value < 1.0
    assert scale.frame is not None
    assert 0 <= scale.frame < 60


def test_playing_a_move_slower_lowers_the_time_scale_in_proportion(plant: ArmPlant) -> None:
    u = np.linspace(0.0, 1.0, 49)
    q = rest_q() + 0.8 * _rest_to_rest(u)[:, None] * np.array([1.0, 0.2, 0.3, -0.4, 0.2, 0.1, 0.5])
    fast = time_scale(plant, 2.0 * u, q)
    slow = time_scale(plant, 6.0 * u, q)
    assert fast.value is not None
    assert slow.value == pytest.approx(fast.value / 3.0, rel=5e-3)
    assert (fast.constraint, fast.joint) == (slow.constraint, slow.joint)


def test_a_rest_within_the_path_takes_no_time(plant: ArmPlant) -> None:
    t = np.linspace(0.0, 6.0, 91)
    way = 0.5 * _rest_to_rest(np.clip(t / 2.0, 0.0, 1.0)) + 0.5 * _rest_to_rest(np.clip((t - 4.0) / 2.0, 0.0, 1.0))
    scale = time_scale(plant, t, rest_q() + way[:, None] * SWING)
    assert scale.value is not None
    assert scale.value * 6.0 == pytest.approx(2.0 * _trapezoid_s(0.5, plant.velocity_limits[0], 15.0), rel=0.04)


def test_time_scale_respects_torque_limits(plant: ArmPlant, monkeypatch: pytest.MonkeyPatch) -> None:
    t = np.linspace(0.0, 4.0, 49)
    q = rest_q() + 0.8 * _rest_to_rest(t / 4.0)[:, None] * SWING
    free = time_scale(plant, t, q)
    inertia = plant.mass_matrix(rest_q())[0, 0]
    weak = plant.effort_limits.copy()
    weak[0] = 3.0 * inertia  # 3 rad/s^2, less than the 15 of the acceleration limit
    monkeypatch.setattr(plant, "effort_limits", weak)
    scale = time_scale(plant, t, q)
    assert free.value is not None
    assert scale.value is not None
    assert scale.value * 4.0 == pytest.approx(_trapezoid_s(0.8, plant.velocity_limits[0], 3.0), rel=0.01)
    assert (scale.constraint, scale.joint) == (ViolationKind.TORQUE, "panda_joint1")
    assert scale.value > 1.5 * free.value


@pytest.mark.parametrize("end", [0, 48])
def test_an_end_speed_beyond_its_limit_names_joint_frame_and_ratio(plant: ArmPlant, end: int) -> None:
    t = np.linspace(0.0, 1.0, 49)
    way = 1.5 * t**2 if end else 1.5 * (1.0 - t) ** 2  # 3 rad/s at one end
    scale = time_scale(plant, t, rest_q() + way[:, None] * SWING)
    assert scale.value is None
    assert (scale.constraint, scale.joint, scale.frame) == (ViolationKind.VELOCITY, "panda_joint1", end)
    assert "1.38 x" in (scale.reason or "")


def test_a_speed_that_cannot_be_braked_within_the_path_names_acceleration_and_joint(plant: ArmPlant) -> None:
    t = np.linspace(0.0, 0.1, 20)  # from 2 rad/s to rest in 0.1 rad: 20 rad/s^2 at least
    scale = time_scale(plant, t, rest_q() + (2.0 * t - 10.0 * t**2)[:, None] * SWING)
    assert scale.value is None
    assert (scale.constraint, scale.joint) == (ViolationKind.ACCELERATION, "panda_joint1")


def test_an_arm_too_weak_for_its_weight_names_torque_and_joint(
    plant: ArmPlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.linspace(0.0, 4.0, 20)
    weak = plant.effort_limits.copy()
    weak[1] = 0.5 * abs(plant.torque(rest_q(), np.zeros(7), np.zeros(7))[1])
    monkeypatch.setattr(plant, "effort_limits", weak)
    scale = time_scale(plant, t, rest_q() + _rest_to_rest(t / 4.0)[:, None] * SWING)
    assert scale.value is None
    assert (scale.constraint, scale.joint) == (ViolationKind.TORQUE, "panda_joint2")
    assert "2.00 x" in (scale.reason or "")


@pytest.mark.parametrize("frames", [2, 3, 4])
def test_two_frames_suffice_for_a_time_scale(plant: ArmPlant, frames: int) -> None:
    v = plant.velocity_limits[0]
    t = np.linspace(0.0, 1.0, frames)
    ramp = (v - 1.0) / 15.0  # from the track's 1 rad/s to the limit
    expected = 2.0 * ramp + (1.0 - ramp * (v + 1.0)) / v
    assert time_scale(plant, t, rest_q() + t[:, None] * SWING).value == pytest.approx(expected, rel=2e-3)


def test_frames_without_joint_angles_do_not_change_the_time_scale(plant: ArmPlant) -> None:
    t = np.linspace(0.0, 5.0, 50)
    q = rest_q() + 0.3 * t[:, None] * SWING
    q[[0, 20, 21]] = np.nan
    scale = time_scale(plant, t, q)
    assert scale.value == pytest.approx(time_scale(plant, t[1:], rest_q() + 0.3 * t[1:, None] * SWING).value, rel=1e-3)


def test_a_track_without_a_time_scale_has_a_reason(plant: ArmPlant) -> None:
    t = np.linspace(0.0, 1.0, 10)
    still = np.tile(rest_q(), (10, 1))
    for times, q, word in (
        (t, still, "do not move"),
        (t[:1], still[:1], "fewer than two"),
        (t[:0], still[:0], "fewer than two"),
        (t[::-1], rest_q() + t[:, None] * SWING, "do not increase"),
    ):
        scale = time_scale(plant, times, q)
        assert scale.value is None
        assert word in (scale.reason or "")


def test_the_grid_of_a_very_long_track_is_bounded(plant: ArmPlant) -> None:
    t = np.arange(4000) * 0.02
    q = rest_q() + 0.3 * np.sin(t)[:, None] * SWING
    assert time_scale(plant, t, q).value is not None
    assert len(timing._PathMotion(plant, t, q, np.arange(4000)).grid) < 2000


@pytest.mark.parametrize("seed", range(6))
def test_a_path_whose_joints_reverse_together_is_timed(plant: ArmPlant, seed: int) -> None:
    """Where the whole path turns back, ds/dt drops out of every limit: hard on the linear programs."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0.0, 5.0, 60))
    q = rest_q() + 0.15 * np.sin(t)[:, None] * rng.normal(size=7)
    assert 0.01 < (time_scale(plant, t, q).value or 0.0) < 0.5


def test_a_path_that_rests_at_both_ends_and_midway_takes_the_time_of_its_moves(plant: ArmPlant) -> None:
    t = np.linspace(0.0, 6.0, 91)
    u = np.stack([np.clip(t / 2.0, 0.0, 1.0), np.clip((t - 4.0) / 2.0, 0.0, 1.0)])
    way = 0.5 * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5).sum(axis=0)
    scale = time_scale(plant, t, rest_q() + way[:, None] * SWING)
    assert (scale.value or 0.0) * 6.0 == pytest.approx(
        2.0 * _trapezoid_s(0.5, plant.velocity_limits[0], 15.0), rel=0.03
    )
