from dataclasses import replace

import numpy as np
import pytest

from benchmarks.feasible import draw_feasible
from benchmarks.motion import CLEARANCE_M, Motion, prove
from benchmarks.moves import SHIPPED_TASKS, Family, trapezoid
from kinebench_drake.suites.families.registry import EXPERTS


def test_motions_are_drawn_from_the_plans_of_all_experts():
    assert sorted(SHIPPED_TASKS) == sorted(EXPERTS)


def swing(arm, joint, size, duration):
    """A half sine of one joint out of the rest posture, sampled so densely that the spline is the sine."""
    t_s = np.linspace(0.0, duration, 201)
    q = np.tile(arm.plant.robot.rest_q, (201, 1))
    q[:, joint] += 0.5 * size * (1.0 - np.cos(np.pi * t_s / duration))
    return Motion.through(t_s, q, np.full(201, 0.04))


def test_limit_ratios_of_a_sine_match_its_derivatives(arm):
    size = 0.8
    duration = 2.0
    proof = prove(arm, swing(arm, 0, size, duration), 0.5, 1.5)  # away from the ends, which are at rest
    rate = np.pi / duration
    assert proof.velocity_ratio == pytest.approx(0.5 * size * rate / 2.175, rel=1e-4)
    assert proof.acceleration_ratio == pytest.approx(0.5 * size * rate**2 * np.cos(0.25 * np.pi) / 15.0, rel=1e-3)
    assert proof.jerk_ratio == pytest.approx(0.5 * size * rate**3 / 7500.0, rel=1e-2)
    assert proof.holds


def test_torque_of_a_resting_arm_is_gravity(arm):
    t_s = np.linspace(0.0, 1.0, 20)
    rest = Motion.through(t_s, np.tile(arm.plant.robot.rest_q, (20, 1)), np.full(20, 0.04))
    gravity = np.abs(arm.plant.torque(arm.plant.robot.rest_q, np.zeros(7), np.zeros(7))) / arm.plant.effort_limits
    assert prove(arm, rest, 0.0, 1.0).torque_ratio == pytest.approx(gravity.max(), rel=1e-6)


@pytest.mark.parametrize(
    ("joint", "size", "duration", "fault"),
    [
        (0, 2.0, 0.5, "velocity_ratio"),
        (1, 0.1, 0.15, "acceleration_ratio"),
        (6, 2.5, 20.0, "position_margin_rad"),
        (1, 0.9, 8.0, "table_distance_m"),
    ],
)
def test_the_proof_fails_for_the_limit_that_is_violated(arm, joint, size, duration, fault):
    proof = prove(arm, swing(arm, joint, size, duration), 0.0, duration)
    value = getattr(proof, fault)
    assert value < 0.0 if fault.endswith(("_m", "_rad")) else value > 1.0
    assert not proof.holds


def test_every_ratio_and_clearance_can_fail_the_proof(arm):
    proof = prove(arm, swing(arm, 0, 0.3, 3.0), 0.0, 3.0)
    assert proof.holds
    for name in ("velocity_ratio", "acceleration_ratio", "jerk_ratio", "torque_ratio"):
        assert not replace(proof, **{name: 1.01}).holds
    assert not replace(proof, self_distance_m=0.5 * CLEARANCE_M).holds
    assert not replace(proof, torque_ratio=np.nan).holds


@pytest.mark.parametrize("family", list(Family))
def test_drawn_motions_are_proven_feasible_and_poses_follow_from_joints(arm, family):
    base = draw_feasible(np.random.default_rng(3), arm, family=family)
    assert base.proof is not None
    assert base.proof.holds
    trajectory = base.trajectory(arm)
    assert len(trajectory.t_s) == base.frames
    np.testing.assert_allclose(np.diff(trajectory.t_s), base.period_s)
    np.testing.assert_allclose(arm.body.forward(trajectory.q), trajectory.X_BG, atol=1e-12)
    assert (arm.body.lowest_of_gripper(trajectory.X_BG, trajectory.finger_width_m) >= 0.0).all()


def test_a_trapezoidal_speed_profile_covers_the_whole_path():
    s = np.linspace(-0.5, 1.5, 4001)
    way = trapezoid(s, 0.25)
    assert way[0] == 0.0
    assert way[-1] == pytest.approx(1.0)
    speed = np.gradient(way, s)
    assert speed.max() == pytest.approx(1.0 / 0.75, rel=1e-6)
    np.testing.assert_allclose(speed[(s > 0.3) & (s < 0.7)], speed.max(), rtol=1e-6)
