from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from kinebench_drake.geometry import pose_difference, rotation_exp
from kinebench_drake.kinematics import trajopt
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.joint_trajectory import JointTrajectory
from kinebench_drake.kinematics.newton import solve_newton
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.trajopt import (
    LARGEST_M,
    RATIO,
    SMALLEST_M,
    TubeResult,
    describe_violation,
    optimize_in_tube,
)
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.violation import ViolationKind


@pytest.fixture(scope="module")
def collision(plant: ArmPlant) -> CollisionModel:
    return CollisionModel(plant)


def _poses(plant: ArmPlant, q: np.ndarray) -> np.ndarray:
    return np.array([plant.forward(row) for row in q])


def _follow(plant: ArmPlant, X_BG: np.ndarray, q: np.ndarray) -> np.ndarray:
    path = []
    for X in X_BG:
        q, _ = solve_newton(plant, X, q)
        path.append(q)
    return np.array(path)


def _sway(plant: ArmPlant, period_s: float = 0.2, frames: int = 49) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, poses and joint angles of a gentle motion above the table."""
    t = np.arange(frames) * period_s
    u = t / (48 * period_s)
    q = rest_q() + np.sin(2 * np.pi * u)[:, None] * np.array([0.4, -0.2, 0.2, 0.1, 0.3, -0.2, 0.5])
    return t, _poses(plant, q), q


def _shaken(X_BG: np.ndarray, noise_m: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    X = X_BG.copy()
    X[:, :3, 3] += rng.normal(0.0, noise_m, (len(X), 3))
    X[:, :3, :3] = rotation_exp(rng.normal(0.0, 5.0 * noise_m, (len(X), 3))) @ X[:, :3, :3]
    return X


def _verify(
    plant: ArmPlant, result: TubeResult, t_s: np.ndarray, X_BG: np.ndarray
) -> tuple[JointTrajectory, np.ndarray]:
    """The certificate, held against SciPy's B-spline and Drake: tube at the frames, limits all along."""
    certificate = result.certificate
    assert certificate is not None
    assert result.radius_m is not None
    curve = BSpline(certificate.basis.knots + certificate.problem.origin_s, certificate.control, 3)
    position, rotation = pose_difference(_poses(plant, curve(t_s)), X_BG)
    assert position.max() == pytest.approx(certificate.figures()["position_error_max_m"], abs=1e-9)
    assert rotation.max() == pytest.approx(certificate.figures()["rotation_error_max_rad"], abs=1e-8)
    assert max(position.max(), 0.1 * rotation.max()) <= result.radius_m + 1e-9
    t = np.linspace(t_s[0], t_s[-1], 20 * len(t_s))
    assert ((curve(t) >= plant.lower) & (curve(t) <= plant.upper)).all()
    assert plant.acceleration_limits is not None
    assert plant.jerk_limits is not None
    for order, limits in ((1, plant.velocity_limits), (2, plant.acceleration_limits), (3, plant.jerk_limits)):
        assert (np.abs(curve(t, order)) <= 1.00001 * limits).all()
    return certificate, curve(t)


def test_a_clean_track_has_the_smallest_tube_without_optimization(
    plant: ArmPlant, collision: CollisionModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(trajopt, "solve_tube")
    t, X, q = _sway(plant)
    result = optimize_in_tube(plant, collision, t, X, q)
    assert (result.radius_m, result.feasible, result.reason) == (SMALLEST_M, True, None)
    certificate, path = _verify(plant, result, t, X)
    # The certificate's own figures, from denser samples than it took.
    assert certificate.figures()["self_distance_min_m"] == pytest.approx(
        collision.self_distance(path).distance_m.min(), abs=1e-4
    )
    assert certificate.figures()["table_distance_min_m"] == pytest.approx(
        collision.table_distance(path).distance_m.min(), abs=1e-4
    )
    margin = np.minimum(path - plant.lower, plant.upper - path) / (0.5 * (plant.upper - plant.lower))
    assert certificate.figures()["joint_limit_margin_min"] == pytest.approx(margin.min(), abs=1e-4)
    torque = [plant.torque(row, np.zeros(7), np.zeros(7)) for row in path]
    assert certificate.figures()["torque_ratio_max"] == pytest.approx(
        np.abs(torque / plant.effort_limits).max(), rel=0.05
    )


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_smoothed_within_a_tube_of_its_own_size(plant: ArmPlant, collision: CollisionModel, seed: int) -> None:
    t, X_true, q = _sway(plant, period_s=1 / 17)
    X = _shaken(X_true, 0.003, seed)
    result = optimize_in_tube(plant, collision, t, X, _follow(plant, X, q[0]), tube_limit_m=0.009)
    assert result.feasible
    assert result.radius_m is not None
    assert 0.001 < result.radius_m < 0.007
    assert result.infeasible_radius_m is not None
    assert result.infeasible_radius_m < result.radius_m <= RATIO * result.infeasible_radius_m
    _verify(plant, result, t, X)


def test_a_zigzag_too_fast_for_the_arm_needs_a_tube_of_half_its_width(plant: ArmPlant) -> None:
    """At 1 kHz the arm cannot move 3 mm to and fro: the best is to stay midway, on a tube of that radius."""
    t = np.arange(40) * 1e-3
    X = np.tile(plant.forward(rest_q()), (40, 1, 1))
    X[:, 1, 3] += 0.003 * (-1.0) ** np.arange(40)
    result = optimize_in_tube(plant, None, t, X, _follow(plant, X, rest_q()), tube_limit_m=0.001)
    assert result.radius_m == pytest.approx(0.003, rel=0.05)
    assert result.feasible is False
    assert result.violation is not None
    assert result.violation.kind in (ViolationKind.ACCELERATION, ViolationKind.JERK)


def test_the_tube_radius_is_the_smallest_feasible_and_grows_with_the_pace(plant: ArmPlant) -> None:
    _, X, q = _sway(plant)
    radii = []
    for duration in (1.3, 1.0, 0.8):
        t = np.linspace(0.0, duration, 49)
        result = optimize_in_tube(plant, None, t, X, q)
        assert result.radius_m is not None
        _verify(plant, result, t, X)
        radii.append(result.radius_m)
        if result.radius_m > SMALLEST_M:
            # A tube somewhat wider is feasible as well; one much narrower is refused, though it is searched for harder.
            wider = optimize_in_tube(plant, None, t, X, q, tube_limit_m=1.3 * result.radius_m)
            narrower = optimize_in_tube(plant, None, t, X, q, tube_limit_m=result.radius_m / 4.0)
            assert (wider.feasible, narrower.feasible) == (True, False)
    assert radii == sorted(radii)
    assert radii[-1] > 2.0 * radii[0]


def test_a_teleport_is_a_violation_at_its_frame(plant: ArmPlant) -> None:
    t, X, q = _sway(plant, period_s=1 / 17)
    X = X.copy()
    X[30:, 2, 3] += 0.15
    result = optimize_in_tube(plant, None, t, X, _follow(plant, X, q[0]))
    assert result.feasible is False
    assert result.violation is not None
    assert result.violation.kind in (ViolationKind.VELOCITY, ViolationKind.ACCELERATION)
    assert 28 <= result.violation.frame_start <= 31
    assert result.violation.value > result.violation.limit
    assert result.violation.joint in plant.robot.joints
    assert result.violation.joint in (result.reason or "")


def test_a_pose_out_of_reach_is_an_unreachable_violation_at_its_frame(plant: ArmPlant) -> None:
    t, X, q = _sway(plant)
    X = X.copy()
    X[20, :2, 3] *= 1.1 / np.linalg.norm(X[20, :2, 3])
    result = optimize_in_tube(plant, None, t, X, _follow(plant, X, q[0]))
    assert result.feasible is False
    assert result.violation is not None
    assert (result.violation.kind, result.violation.frame_start) == (ViolationKind.UNREACHABLE, 20)
    assert result.violation.joint is None
    assert result.violation.limit == 0.005  # the tube's, though only what is far beyond it counts for sure
    assert describe_violation(result.violation).endswith(
        f"near frame 20: {result.violation.value:.4g} m, limit 0.005 m"
    )


def test_joint_angles_past_a_limit_are_a_violation_of_that_joint(plant: ArmPlant) -> None:
    """With the arm stretched up but for joint 4, nothing stands in for that joint."""
    t = np.arange(30) * 0.2
    q = np.tile([0.0, -0.5, 0.0, -0.3, 0.0, 1.6, 0.0], (30, 1))
    q[:, 3] += 0.7 * np.sin(np.pi * np.arange(30) / 29)  # past -0.07
    result = optimize_in_tube(plant, None, t, _poses(plant, q), q)
    assert result.feasible is False
    assert result.violation is not None
    assert (result.violation.kind, result.violation.joint) == (ViolationKind.JOINT_LIMIT, "panda_joint4")
    assert result.violation.value > result.violation.limit == pytest.approx(-0.0698)
    assert describe_violation(result.violation).endswith(" rad, limit -0.0698 rad")


def test_a_track_into_the_table_needs_a_tube_of_its_depth(plant: ArmPlant, collision: CollisionModel) -> None:
    t, X, q = _sway(plant)
    X = X.copy()
    X[:, 2, 3] -= collision.table_distance(q).distance_m.min() + 0.02
    path = _follow(plant, X, q[0])
    depth = -collision.table_distance(path).distance_m.min()
    result = optimize_in_tube(plant, collision, t, X, path, table_tolerance_m=0.002)
    assert result.violation is not None
    assert result.violation.kind is ViolationKind.TABLE_COLLISION
    assert result.violation.value == pytest.approx(-depth, abs=1e-3)
    assert result.radius_m is not None
    # Tilting the hand within the tube saves a little.
    assert 0.75 * (depth - 0.002) < result.radius_m < 1.05 * (depth - 0.002)
    certificate, q_safe = _verify(plant, result, t, X)
    assert certificate.figures()["table_distance_min_m"] is not None
    assert certificate.figures()["table_distance_min_m"] >= -0.002
    assert collision.table_distance(q_safe).distance_m.min() >= -0.0021
    assert optimize_in_tube(plant, collision, t, X, path, table_tolerance_m=depth + 1e-3).feasible
    assert optimize_in_tube(plant, None, t, X, path).feasible


@pytest.mark.parametrize(
    ("folded", "escapes"),
    [([0.0, -1.1, -1.2, -1.3, -2.1, 0.0, -0.4], True), ([0.2, -0.2, 2.5, -3.0, 1.3, 2.3, -2.7], False)],
)
def test_a_self_colliding_path_is_pushed_out_or_refused(plant: ArmPlant, folded: list[float], escapes: bool) -> None:
    t = np.arange(30) * 0.3
    q = rest_q() + np.sin(np.pi * np.arange(30) / 29)[:, None] * (np.array(folded) - rest_q())
    X = _poses(plant, q)
    nowhere = CollisionModel(plant, table_height_m=-1.0)
    assert nowhere.self_distance(q).distance_m.min() < -0.01
    result = optimize_in_tube(plant, nowhere, t, X, q)
    assert result.feasible is escapes
    certificate, path = _verify(plant, result, t, X)
    assert (certificate.figures()["self_distance_min_m"] or -1.0) >= 0.0
    assert nowhere.self_distance(path).distance_m.min() > -2e-4
    if result.violation is not None:
        assert result.violation.kind is ViolationKind.SELF_COLLISION
        assert result.violation.frame_start in (14, 15)
    assert result.feasible is (result.violation is None)
    assert optimize_in_tube(plant, None, t, X, q).radius_m == SMALLEST_M


def test_an_arm_too_weak_for_its_weight_is_infeasible_for_torque(
    plant: ArmPlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    t, X, q = _sway(plant)
    weak = plant.effort_limits.copy()
    weak[1] = 0.8 * abs(plant.torque(rest_q(), np.zeros(7), np.zeros(7))[1])
    monkeypatch.setattr(plant, "effort_limits", weak)
    result = optimize_in_tube(plant, None, t, X, q)
    assert (result.radius_m, result.feasible) == (None, False)
    assert result.violation is not None
    assert (result.violation.kind, result.violation.joint) == (ViolationKind.TORQUE, "panda_joint2")


def test_the_tube_lowers_torque_by_lower_accelerations(plant: ArmPlant, monkeypatch: pytest.MonkeyPatch) -> None:
    """Jitter asks for torque that the tube can do without."""
    t, X, q = _sway(plant, period_s=0.1)
    X = _shaken(X, 0.002, 0)
    path = _follow(plant, X, q[0])
    strong = optimize_in_tube(plant, None, t, X, path, tube_limit_m=0.02)
    assert strong.certificate is not None
    weight = max(abs(plant.torque(row, np.zeros(7), np.zeros(7))[0]) for row in q)
    weak = plant.effort_limits.copy()
    weak[0] = max(0.7 * strong.certificate.figures()["torque_ratio_max"] * weak[0], 2.0 * weight)
    monkeypatch.setattr(plant, "effort_limits", weak)
    result = optimize_in_tube(plant, None, t, X, path, tube_limit_m=0.02)
    assert result.feasible
    assert result.certificate is not None
    assert result.certificate.figures()["torque_ratio_max"] <= 1.0


def test_uneven_times_are_feasible_and_absent_frames_change_nothing(plant: ArmPlant, collision: CollisionModel) -> None:
    rng = np.random.default_rng(0)
    t, X, q = _sway(plant)
    kept = np.sort(rng.choice(49, 25, replace=False))
    result = optimize_in_tube(plant, collision, t[kept], X[kept], q[kept])
    assert result.feasible
    _verify(plant, result, t[kept], X[kept])
    holes = q.copy()
    holes[np.setdiff1d(np.arange(49), kept)] = np.nan
    same = optimize_in_tube(plant, collision, t, X, holes)
    np.testing.assert_array_equal(same.certificate.control, result.certificate.control)  # type: ignore[union-attr]


def test_the_result_is_reproducible_and_independent_of_the_start_time(
    plant: ArmPlant, collision: CollisionModel
) -> None:
    t, X, q = _sway(plant, period_s=1 / 17)
    X = _shaken(X, 0.004, 1)
    path = _follow(plant, X, q[0])
    first, again = (optimize_in_tube(plant, collision, t, X, path) for _ in range(2))
    shifted = optimize_in_tube(plant, collision, t + 64.0, X, path)
    assert first.certificate is not None
    assert again.certificate is not None
    assert shifted.certificate is not None
    np.testing.assert_array_equal(again.certificate.control, first.certificate.control)
    assert replace(again, certificate=None) == replace(first, certificate=None)
    assert shifted.radius_m == pytest.approx(first.radius_m, rel=1e-3)
    np.testing.assert_allclose(shifted.certificate.basis.knots, first.certificate.basis.knots)


@pytest.mark.parametrize("frames", [2, 3, 4])
def test_two_frames_suffice_for_a_trajectory(plant: ArmPlant, collision: CollisionModel, frames: int) -> None:
    t, X, q = _sway(plant)
    result = optimize_in_tube(plant, collision, t[:frames], X[:frames], q[:frames])
    assert result.feasible
    _verify(plant, result, t[:frames], X[:frames])


def test_a_gripper_at_rest_is_feasible(plant: ArmPlant, collision: CollisionModel) -> None:
    t, X, q = _sway(plant)
    result = optimize_in_tube(plant, collision, t, np.tile(X[:1], (49, 1, 1)), np.tile(q[:1], (49, 1)))
    assert result.feasible
    assert result.certificate is not None
    assert result.certificate.figures()["velocity_ratio_max"] < 1e-6


def test_a_track_without_a_verdict_has_a_reason(plant: ArmPlant) -> None:
    t, X, q = _sway(plant)
    for result, word in (
        (optimize_in_tube(plant, None, t[:1], X[:1], q[:1]), "fewer than two"),
        (optimize_in_tube(plant, None, t, np.full_like(X, np.nan), q), "fewer than two"),
        (optimize_in_tube(plant, None, t[::-1], X, q), "do not increase"),
    ):
        assert (result.radius_m, result.feasible, result.certificate) == (None, None, None)
        assert word in (result.reason or "")


def test_a_track_far_too_fast_has_no_tube_and_names_a_violation(plant: ArmPlant) -> None:
    _, X, q = _sway(plant)
    for duration in (0.2, 1e-2):
        result = optimize_in_tube(plant, None, np.linspace(0.0, duration, 49), X, q)
        assert (result.radius_m, result.feasible, result.certificate) == (None, False, None)
        assert result.violation is not None
        assert f"{LARGEST_M:g} m" in (result.reason or "")


def test_the_control_points_of_a_long_track_are_bounded(plant: ArmPlant) -> None:
    t = np.arange(2500) * 0.01
    q = rest_q() + 0.3 * np.sin(0.5 * t)[:, None]
    X = _poses(plant, q)
    result = optimize_in_tube(plant, None, t, X, q)
    assert result.feasible
    assert result.certificate is not None
    assert len(result.certificate.control) < 1000
    assert result.certificate.basis.knots[-1] + result.certificate.problem.origin_s == pytest.approx(t[-1])


def test_an_arm_without_acceleration_and_jerk_limits_keeps_the_velocity_limit(
    plant: ArmPlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    t, X, q = _sway(plant)
    monkeypatch.setattr(plant, "acceleration_limits", None)
    monkeypatch.setattr(plant, "jerk_limits", None)
    result = optimize_in_tube(plant, None, t, X, q)
    assert result.certificate is not None
    assert (result.certificate.figures()["acceleration_ratio_max"], result.certificate.figures()["jerk_ratio_max"]) == (
        None,
        None,
    )
    fast = optimize_in_tube(plant, None, t / 20.0, X, q)
    assert fast.feasible is False
    assert fast.violation is not None
    assert fast.violation.kind is ViolationKind.VELOCITY


def test_joint_angles_past_a_limit_are_replaced_if_redundancy_allows(plant: ArmPlant) -> None:
    """With joint 4 free, the arm's redundancy takes joint 7 back within its limit."""
    t, X, q = _sway(plant)
    q = q.copy()
    q[:, 6] += plant.upper[6] - q[:, 6].max() + 0.2
    X = _poses(plant, q)
    result = optimize_in_tube(plant, None, t, X, q)
    assert result.feasible
    _verify(plant, result, t, X)
