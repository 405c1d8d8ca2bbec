from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.limit_checks import (
    FALSE_ALARM,
    LimitChecks,
    Slowdown,
    check_limits,
    noise_allowance,
    torque_slowdown,
)
from kinebench_drake.models.arm import panda
from kinebench_drake.models.robot import Robot
from kinebench_drake.violation import ViolationKind

EXACT = np.zeros(7)
MOTIONS = [ViolationKind.VELOCITY, ViolationKind.ACCELERATION, ViolationKind.JERK]


def _with_limits(**limits: np.ndarray | None) -> Robot:
    """The Panda with other limits."""
    return replace(panda(), limits=replace(panda().limits, **limits))


@pytest.fixture
def weak() -> ArmPlant:
    """An arm whose joint 2 can hardly carry it."""
    effort = panda().limits.torque.copy()
    effort[1] = 45.0
    return ArmPlant(_with_limits(torque=effort))


def _limit(plant: ArmPlant, kind: ViolationKind) -> Array:
    limits = {
        ViolationKind.VELOCITY: plant.velocity_limits,
        ViolationKind.ACCELERATION: plant.acceleration_limits,
        ViolationKind.JERK: plant.jerk_limits,
    }[kind]
    assert limits is not None
    return limits


def _wave(t_s: Array, plant: ArmPlant, size: float = 0.3) -> Array:
    return plant.robot.rest_q + size * np.sin(t_s[:, None] * np.linspace(1.0, 2.0, 7) + np.arange(7))


@pytest.mark.parametrize("kind", MOTIONS)
@pytest.mark.parametrize(("factor", "broken"), [(0.99, False), (1.01, True)])
def test_a_motion_violates_its_limit_exactly_if_its_ratio_exceeds_one(
    plant: ArmPlant, kind: ViolationKind, factor: float, broken: bool
) -> None:
    order = MOTIONS.index(kind) + 1
    t_s = 0.01 * np.arange(12)
    q = np.tile(plant.robot.rest_q, (12, 1))
    limit = _limit(plant, kind)[4]
    q[:, 4] += factor * limit * (t_s - t_s.mean()) ** order / [1.0, 2.0, 6.0][order - 1]
    check = check_limits(plant, t_s, q, EXACT).checks[kind]
    assert check.ratio_max == pytest.approx(factor, rel=1e-6)
    assert check.joint == "panda_joint5"
    assert check.ratios[4] == pytest.approx(factor, rel=1e-6)
    assert check.margins[4] == pytest.approx((1.0 - factor) * limit, rel=1e-4)
    assert check.margins[0] == pytest.approx(_limit(plant, kind)[0])
    assert bool(check.violations) is broken
    if broken:
        (violation,) = check.violations
        assert (violation.kind, violation.joint) == (kind, "panda_joint5")
        assert (violation.frame_start, violation.frame_end) == (0, 11)
        assert violation.value == pytest.approx(factor * violation.limit)
        assert violation.limit == limit


def test_a_burst_of_speed_is_reported_with_joint_frames_and_time(plant: ArmPlant) -> None:
    t_s = 0.1 * np.arange(40)
    q = np.tile(plant.robot.rest_q, (40, 1))
    q[20:, 0] += 0.3
    q[30, 6] += 0.1
    checks = check_limits(plant, t_s, q, EXACT)
    speed = checks.checks[ViolationKind.VELOCITY]
    assert [(v.joint, v.frame_start, v.frame_end) for v in speed.violations] == [("panda_joint1", 20, 20)]
    assert speed.violations[0].value == pytest.approx(3.0)
    assert (speed.frame, speed.t_worst_s) == (20, pytest.approx(2.0))
    kinds = {v.kind for v in checks.violations}
    assert {ViolationKind.VELOCITY, ViolationKind.ACCELERATION} <= kinds


def test_torque_ratio_is_that_of_inverse_dynamics(plant: ArmPlant) -> None:
    t_s = 0.002 * np.arange(400)
    w = np.linspace(1.0, 2.0, 7)
    phase = np.arange(7)
    check = check_limits(plant, t_s, _wave(t_s, plant), EXACT).checks[ViolationKind.TORQUE]
    ratio = max(
        float(np.abs(tau / plant.effort_limits).max())
        for t in t_s[1:-1]
        for tau in [
            plant.torque(
                _wave(np.array([t]), plant)[0],
                0.3 * w * np.cos(w * t + phase),
                -0.3 * w**2 * np.sin(w * t + phase),
            )
        ]
    )
    assert check.ratio_max == pytest.approx(ratio, rel=1e-3)


def test_the_torque_of_an_arm_at_rest_is_its_weight_alone(plant: ArmPlant) -> None:
    q = np.tile(plant.robot.rest_q, (10, 1))
    checks = check_limits(plant, 0.2 * np.arange(10), q, EXACT)
    weight = np.abs(plant.torque(q[0], np.zeros(7), np.zeros(7))) / plant.effort_limits
    np.testing.assert_allclose(checks.checks[ViolationKind.TORQUE].ratios, weight, atol=1e-9)
    assert checks.slowdown is not None
    assert checks.slowdown.factor < 1e-4
    assert checks.violations == ()


def test_the_slowdown_is_infinite_if_the_arm_cannot_carry_its_weight(weak: ArmPlant) -> None:
    q = np.tile([0.0, 1.5, 0.0, -0.2, 0.0, 1.8, 0.0], (10, 1))
    checks = check_limits(weak, 0.2 * np.arange(10), q, EXACT)
    assert checks.slowdown is not None
    assert checks.slowdown.factor == np.inf
    assert (checks.slowdown.kind, checks.slowdown.joint) == (ViolationKind.TORQUE, "panda_joint2")
    assert [(v.kind, v.joint) for v in checks.violations] == [(ViolationKind.TORQUE, "panda_joint2")]


def _bound_by(kind: ViolationKind) -> ArmPlant:
    """An arm that has this limit alone; of torque, one that must carry its weight, too."""
    limits = panda().limits
    wide = np.full(7, 1e9)
    own = {name: getattr(limits, name) for name in ("velocity", "acceleration", "jerk")}
    own["torque"] = np.array([9.0, 60.0, 60.0, 60.0, 12.0, 12.0, 12.0])
    return ArmPlant(_with_limits(**{name: limit if name == kind.value else wide for name, limit in own.items()}))


@pytest.mark.parametrize("kind", [*MOTIONS, ViolationKind.TORQUE])
def test_a_motion_slowed_by_its_slowdown_just_keeps_the_limit(kind: ViolationKind) -> None:
    arm = _bound_by(kind)
    t_s = 0.01 * np.arange(60)
    q = _wave(10.0 * t_s, arm)

    def judge(k: float) -> tuple[LimitChecks, Slowdown]:
        checks = check_limits(arm, k * t_s, q, EXACT)
        assert checks.slowdown is not None
        return checks, checks.slowdown

    first = judge(1.0)[1]
    assert first.kind is kind
    again, slowdown = judge(1.001 * first.factor)
    assert not again.violations
    assert slowdown.factor == pytest.approx(1.0 / 1.001, rel=1e-5)
    assert {v.kind for v in judge(0.999 * first.factor)[0].violations} == {kind}


def test_the_slowdown_exceeds_one_exactly_if_a_limit_is_violated(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    broken = 0
    for _ in range(60):
        t_s = rng.uniform(0.02, 0.2) * np.arange(30)
        q = _wave(t_s, plant, rng.uniform(0.05, 2.0)) + 0.01 * rng.normal(size=(30, 7))
        checks = check_limits(plant, t_s, q, np.full(7, rng.choice([0.0, 0.003, 0.01])))
        assert checks.slowdown is not None
        assert (checks.slowdown.factor > 1.0) is bool(checks.violations)
        broken += bool(checks.violations)
    assert 10 < broken < 50


def test_torque_slowdown_is_the_least_factor_that_keeps_the_torque_limits() -> None:
    rng = np.random.default_rng(0)
    limits = np.full(7, 10.0)
    gravity = rng.uniform(-9.0, 9.0, (50, 7))
    rest = rng.normal(scale=20.0, size=(50, 7))
    error = rng.uniform(0.0, 5.0, (50, 7))
    k = torque_slowdown(gravity, rest, limits, error)

    def kept(k: Array) -> Array:
        value = gravity + rest / k**2
        room = error / k**2
        return np.asarray((value - room <= limits) & (value + room >= -limits))

    moving = k > 0.0
    assert moving.any()
    assert not moving.all()
    assert kept(np.maximum(1.0001 * k, 1e-6)).all()
    assert not kept(np.maximum(0.9999 * k, 1e-6))[moving].any()
    assert kept(np.full_like(k, 1e-3))[~moving].all()
    assert np.isinf(torque_slowdown(np.full(7, 11.0), np.zeros(7), limits, np.zeros(7))).all()


def test_noise_at_the_limit_rarely_counts_as_violation_and_hides_no_large_one(plant: ArmPlant) -> None:
    """All joints move at their limits of speed all the time: nothing is broken, and the noise must not break it."""
    rng = np.random.default_rng(0)
    t_s = 0.2 * np.arange(49)
    q = plant.robot.rest_q + t_s[:, None] * plant.velocity_limits
    checks = [check_limits(plant, t_s, q + 0.02 * rng.normal(size=(49, 7)), np.full(7, 0.02)) for _ in range(100)]
    assert sum(bool(c.checks[ViolationKind.VELOCITY].violations) for c in checks) <= 2
    # and the room left for it is not so wide that nothing is ever seen
    q = plant.robot.rest_q + 1.5 * t_s[:, None] * plant.velocity_limits
    noisy = check_limits(plant, t_s, q + 0.02 * rng.normal(size=(49, 7)), np.full(7, 0.02))
    assert {v.joint for v in noisy.checks[ViolationKind.VELOCITY].violations} == set(plant.robot.joints)


def test_the_noise_allowance_is_a_quantile_over_all_comparisons() -> None:
    assert noise_allowance(1, 1e9) == pytest.approx(norm.isf(FALSE_ALARM / 2), rel=1e-6)
    assert noise_allowance(1372, 1e9) == pytest.approx(norm.isf(FALSE_ALARM / 2 / 1372), rel=1e-6)
    assert noise_allowance(1372, 30.0) > noise_allowance(1372, 1e9)
    looks = np.abs(np.random.default_rng(0).normal(size=(4000, 1372))).max(axis=-1)
    assert np.mean(looks > noise_allowance(1372, 1e9)) < 1.5 * FALSE_ALARM


def test_frames_with_large_noise_count_neither_as_violation_nor_in_the_peak_ratio(plant: ArmPlant) -> None:
    t_s = 0.05 * np.arange(60)
    rng = np.random.default_rng(0)
    sigma = np.full((60, 7), 1e-4)
    sigma[30:33, 2] = 1.0  # beside a singularity
    q = _wave(t_s, plant) + sigma * rng.normal(size=(60, 7))
    check = check_limits(plant, t_s, q, sigma).checks[ViolationKind.VELOCITY]
    assert check.ratio_max < 0.5
    assert check.violations == ()
    assert check.noise_ratio < 0.1


def test_noise_above_the_limit_in_every_frame_leaves_no_peak_ratio(plant: ArmPlant) -> None:
    t_s = 0.05 * np.arange(60)
    check = check_limits(plant, t_s, _wave(t_s, plant), np.full((60, 7), 10.0)).checks[ViolationKind.VELOCITY]
    assert np.isnan(check.ratio_max)
    assert (check.joint, check.frame, check.t_worst_s) == (None, None, None)
    assert check.violations == ()


def test_unknown_noise_gives_no_violation_and_no_slowdown(plant: ArmPlant) -> None:
    t_s = 0.1 * np.arange(4)
    q = np.tile(plant.robot.rest_q, (4, 1))
    q[2:, 0] += 1.0
    checks = check_limits(plant, t_s, q, np.full(7, np.nan))
    assert checks.violations == ()
    assert checks.slowdown is None
    assert checks.checks[ViolationKind.VELOCITY].ratio_max > 1.0
    assert np.isnan(checks.checks[ViolationKind.VELOCITY].noise_ratio)


def test_unpublished_limits_are_not_checked_and_have_a_reason() -> None:
    arm = ArmPlant(_with_limits(acceleration=None, jerk=None))
    t_s = 0.1 * np.arange(30)
    checks = check_limits(arm, t_s, _wave(t_s, arm), EXACT)
    assert set(checks.checks) == {ViolationKind.VELOCITY, ViolationKind.TORQUE}
    assert "states no jerk limits" in checks.reasons[ViolationKind.JERK]
    assert set(checks.reasons) == {ViolationKind.ACCELERATION, ViolationKind.JERK}


@pytest.mark.parametrize("frames", [0, 1, 2, 3])
def test_limits_unchecked_for_lack_of_frames_have_a_reason(plant: ArmPlant, frames: int) -> None:
    q = np.tile(plant.robot.rest_q, (frames, 1))
    checks = check_limits(plant, 0.1 * np.arange(frames), q, EXACT)
    expected = [ViolationKind.VELOCITY, ViolationKind.ACCELERATION, ViolationKind.JERK][max(frames - 1, 0) :]
    motions = [kind for kind in checks.reasons if kind is not ViolationKind.TORQUE]
    assert motions == expected
    assert (ViolationKind.TORQUE in checks.reasons) is (frames < 3)
    assert all(reason for reason in checks.reasons.values())


def test_a_jump_across_a_gap_violates_the_speed_limit_only_if_the_gap_is_short(plant: ArmPlant) -> None:
    t_s = 0.1 * np.arange(40)
    q = np.tile(plant.robot.rest_q, (40, 1))
    q[20:, 0] += 1.0
    q[19] = np.nan
    broken = check_limits(plant, t_s, q, EXACT).violations
    assert {v.joint for v in broken} == {"panda_joint1"}
    assert ViolationKind.VELOCITY in {v.kind for v in broken}
    q[5:35] = np.nan
    assert check_limits(plant, t_s, q, EXACT).violations == ()


def test_jerk_at_video_rate_is_strongly_underestimated(plant: ArmPlant) -> None:
    t_s = 0.2 * np.arange(49)
    check = check_limits(plant, t_s, _wave(t_s, plant), EXACT).checks[ViolationKind.JERK]
    assert check.ratio_max < 0.001
    assert check.bandwidth_hz < 2.5
    assert check.window_s == pytest.approx(0.6)
