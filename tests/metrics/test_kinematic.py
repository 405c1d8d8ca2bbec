from collections.abc import Mapping

import numpy as np
import pytest
from scipy.signal import savgol_filter

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.kinematics.ik import solve_track
from kinebench_drake.kinematics.manipulability import manipulability
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.kinematic import (
    KinematicResult,
    Violation,
    ViolationKind,
    evaluate_track,
    joint_speed,
    limit_margin,
)
from kinebench_drake.models.panda.robot import rest_q
from kinebench_drake.products import GripperTrack, IkStatus, JointTrack

NAMES = {
    *("sparc", "sparc_rotation", "ldlj", "manipulability_mean", "manipulability_min", "manipulability_integral"),
    *("manipulability_cost_mean", "ik_success_rate", "ik_position_error_max_m", "joint_limit_margin_min"),
    *("velocity_ratio_max", "acceleration_ratio_max", "jerk_ratio_max", "torque_ratio_max", "time_scale"),
    *("slowdown_min", "trajopt_feasible", "trajopt_position_tube_m", "self_distance_min_m", "table_distance_min_m"),
}
KINDS = [
    *("unreachable", "joint_limit", "self_collision", "table_collision"),
    *("velocity", "acceleration", "jerk", "torque", "discontinuity"),
]


def _gripper(t_s: Array, X_BG: Array) -> GripperTrack:
    n = len(t_s)
    return GripperTrack(
        t_s=t_s,
        X_CH=X_BG,
        X_BG=X_BG,
        tracked=np.isfinite(X_BG[:, 0, 0]),
        confidence=np.ones(n),
        finger_width_m=np.full(n, 0.04),
    )


def _along(plant: ArmPlant, q: Array, period_s: float = 0.2) -> tuple[GripperTrack, JointTrack]:
    """Gripper track of joint angles (T, 7), and those angles as given."""
    n = len(q)
    track = _gripper(period_s * np.arange(n), np.array([plant.forward(row) for row in q]))
    zero = np.zeros(n)
    joints = JointTrack(t_s=track.t_s, q=q, status=(IkStatus.OK,) * n, position_error_m=zero, rotation_error_rad=zero)
    return track, joints


def _gentle(n: int = 40) -> Array:
    """A slow wave of all joints about the rest posture."""
    s = np.linspace(0, 1, n)
    s = 10 * s**3 - 15 * s**4 + 6 * s**5
    return rest_q() + s[:, None] * [0.5, 0.3, -0.2, 0.2, 0.3, -0.2, 0.4]


def _kinds(result: KinematicResult) -> list[ViolationKind]:
    return [v.kind for v in result.violations]


def _number(metrics: Mapping[str, float | bool | None], name: str) -> float:
    value = metrics[name]
    assert isinstance(value, float)
    return value


def test_a_gentle_track_is_feasible_and_has_every_metric(plant: ArmPlant) -> None:
    track, _ = _along(plant, _gentle())
    joints = solve_track(plant, track)
    result = evaluate_track(plant, track, joints)
    metrics = result.metrics
    assert result.feasible is True
    assert result.violations == ()
    assert set(metrics) == NAMES
    w = manipulability(plant, joints.q)
    assert metrics["manipulability_mean"] == pytest.approx(w.full.mean())
    assert metrics["manipulability_min"] == pytest.approx(w.full.min())
    assert metrics["manipulability_cost_mean"] == pytest.approx(w.cost.mean())
    trapezoid = np.sum(0.5 * (w.full[1:] + w.full[:-1]) * np.diff(track.t_s))
    assert metrics["manipulability_integral"] == pytest.approx(trapezoid)
    assert metrics["ik_success_rate"] == 1.0
    assert _number(metrics, "ik_position_error_max_m") < 1e-6
    assert 0.0 < _number(metrics, "joint_limit_margin_min") < 1.0
    assert 0.0 < _number(metrics, "velocity_ratio_max") < 1.0
    assert _number(metrics, "sparc") == pytest.approx(-1.4, abs=0.1)


def test_every_value_is_a_finite_number_or_none(plant: ArmPlant) -> None:
    X = np.full((6, 4, 4), np.nan)
    far = np.tile(make_pose(np.eye(3), [3.0, 0.0, 0.0]), (6, 1, 1))
    for track in (_gripper(0.2 * np.arange(6), X), _gripper(0.2 * np.arange(6), far), _along(plant, _gentle(2))[0]):
        result = evaluate_track(plant, track, solve_track(plant, track))
        assert set(result.metrics) == NAMES
        for value in result.metrics.values():
            assert value is None or np.isfinite(value)


def test_nothing_tracked_is_not_measurable(plant: ArmPlant) -> None:
    track = _gripper(0.2 * np.arange(6), np.full((6, 4, 4), np.nan))
    result = evaluate_track(plant, track, solve_track(plant, track))
    assert set(result.metrics.values()) == {None}
    assert result.feasible is None


def test_the_result_cannot_be_changed(plant: ArmPlant) -> None:
    result = evaluate_track(plant, *_along(plant, _gentle(10)))
    with pytest.raises(TypeError):
        result.metrics["sparc"] = 0.0  # type: ignore[index]


@pytest.mark.parametrize(("kept", "verdict"), [(40, True), (20, True), (19, None), (4, None)])
def test_few_tracked_frames_are_no_proof(plant: ArmPlant, kept: int, verdict: bool | None) -> None:
    X = _along(plant, _gentle())[0].X_BG.copy()
    X[kept:] = np.nan
    track = _gripper(0.2 * np.arange(40), X)
    result = evaluate_track(plant, track, solve_track(plant, track))
    assert result.feasible is verdict
    assert result.metrics["ik_success_rate"] == 1.0  # over tracked frames


def test_frames_out_of_reach_are_named(plant: ArmPlant) -> None:
    X = _along(plant, _gentle())[0].X_BG.copy()
    X[10:13, :3, 3] = [1.2, 0.0, 0.3]
    track = _gripper(0.2 * np.arange(40), X)
    result = evaluate_track(plant, track, solve_track(plant, track))
    assert result.feasible is False
    assert [(v.kind, v.frame_start, v.frame_end, v.joint) for v in result.violations] == [
        (ViolationKind.UNREACHABLE, 10, 12, None)
    ]
    assert result.metrics["ik_success_rate"] == pytest.approx(37 / 40)
    assert result.metrics["ik_position_error_max_m"] == result.violations[0].value > 0.1


def test_a_pose_past_a_joint_limit_names_joint_value_and_limit(plant: ArmPlant) -> None:
    X = np.tile(plant.forward([-0.4, 2.1, -0.4, -0.6, -2.8, 2.7, -0.6]), (6, 1, 1))
    track = _gripper(0.2 * np.arange(6), X)
    result = evaluate_track(plant, track, solve_track(plant, track))
    assert result.feasible is False
    assert set(_kinds(result)) == {ViolationKind.JOINT_LIMIT}
    for violation in result.violations:
        assert (violation.frame_start, violation.frame_end) == (0, 5)
        j = int(str(violation.joint)[-1]) - 1
        assert (
            violation.value > plant.upper[j] == violation.limit or violation.value < plant.lower[j] == violation.limit
        )


def test_given_angles_past_a_limit_are_judged_as_given(plant: ArmPlant) -> None:
    """The pose may be reached otherwise; the angles asked for break the limit all the same."""
    q = _gentle()
    q[15:20, 3] = plant.upper[3] + 0.1
    q[15:20] += np.linspace(0, 0.01, 5)[:, None]
    track, joints = _along(plant, q, period_s=5.0)
    result = evaluate_track(plant, track, joints)
    assert result.violations == (
        Violation(
            kind=ViolationKind.JOINT_LIMIT,
            frame_start=15,
            frame_end=19,
            joint="panda_joint4",
            value=pytest.approx(plant.upper[3] + 0.11),
            limit=float(plant.upper[3]),
        ),
    )
    margin = -0.11 / (0.5 * (plant.upper[3] - plant.lower[3]))
    assert result.metrics["joint_limit_margin_min"] == pytest.approx(margin)


def test_a_lower_limit_is_told_from_an_upper_one(plant: ArmPlant) -> None:
    q = _gentle()
    q[3, 3] = plant.lower[3] - 0.2
    violation = evaluate_track(plant, *_along(plant, q, period_s=10.0)).violations[0]
    assert (violation.joint, violation.limit) == ("panda_joint4", plant.lower[3])
    assert violation.value == pytest.approx(plant.lower[3] - 0.2)


@pytest.mark.parametrize(("factor", "broken"), [(0.99, False), (1.01, True)])
def test_speed_is_judged_against_the_limit(plant: ArmPlant, factor: float, broken: bool) -> None:
    q = np.tile(rest_q(), (30, 1))
    q[:, 4] += factor * plant.velocity_limits[4] * 0.05 * (np.arange(30) - 15.0)
    result = evaluate_track(plant, *_along(plant, q, period_s=0.05))
    assert _number(result.metrics, "velocity_ratio_max") == pytest.approx(factor)
    assert result.feasible is not broken
    if broken:
        violation = result.violations[0]
        assert (violation.kind, violation.joint) == (ViolationKind.VELOCITY, "panda_joint5")
        assert (violation.frame_start, violation.frame_end) == (0, 29)
        assert violation.value == pytest.approx(factor * violation.limit)


def test_a_track_played_slower_is_slower_in_proportion(plant: ArmPlant) -> None:
    fast, slow = (evaluate_track(plant, *_along(plant, _gentle(), period)).metrics for period in (0.3, 0.6))
    assert _number(fast, "velocity_ratio_max") == pytest.approx(2 * _number(slow, "velocity_ratio_max"), rel=1e-9)
    ratio = _number(slow, "manipulability_integral") / _number(fast, "manipulability_integral")
    assert ratio == pytest.approx(2.0)


def test_a_pose_track_is_too_fast_when_the_hand_jumps(plant: ArmPlant) -> None:
    q = _gentle()
    q[20:, 0] += 2.0
    track, _ = _along(plant, q)
    result = evaluate_track(plant, track, solve_track(plant, track))
    assert ViolationKind.VELOCITY in _kinds(result)
    assert all(19 <= v.frame_start <= v.frame_end <= 20 for v in result.violations)


@pytest.mark.parametrize(("period_s", "window"), [(0.2, 3), (0.05, 5), (1 / 30, 9)])
def test_joint_speed_is_the_savitzky_golay_derivative(period_s: float, window: int) -> None:
    q = np.random.default_rng(0).normal(size=(40, 7))
    expected = savgol_filter(q, window, 2, deriv=1, delta=period_s, axis=0)
    inner = slice(window // 2, -(window // 2))
    np.testing.assert_allclose(joint_speed(period_s * np.arange(40), q)[inner], expected[inner], atol=1e-9)


def test_joint_speed_of_steady_motion_is_exact_also_at_ends_and_gaps() -> None:
    t_s = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.6, 0.7, 0.9])
    rate = np.arange(1.0, 8.0)
    q = t_s[:, None] * rate
    q[4] = np.nan
    speed = joint_speed(t_s, q)
    assert np.isnan(speed[4]).all()
    np.testing.assert_allclose(np.delete(speed, 4, axis=0), np.tile(rate, (7, 1)))
    assert np.isnan(joint_speed(t_s[:1], q[:1])).all()


def test_limit_margin_is_one_in_the_middle_and_zero_at_limits(plant: ArmPlant) -> None:
    q = np.array([0.5 * (plant.lower + plant.upper), plant.lower, plant.upper, 2 * plant.upper - plant.lower])
    np.testing.assert_allclose(limit_margin(plant, q), np.tile([[1.0], [0.0], [0.0], [-2.0]], 7), atol=1e-12)


def test_kinds_are_those_of_the_output_format() -> None:
    assert [kind.value for kind in ViolationKind] == KINDS


def test_tracks_of_different_length_are_refused(plant: ArmPlant) -> None:
    track, _ = _along(plant, _gentle(5))
    _, longer = _along(plant, _gentle(6))
    with pytest.raises(InputError, match="5 frames"):
        evaluate_track(plant, track, longer)
