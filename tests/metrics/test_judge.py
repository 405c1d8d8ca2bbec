from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.trajectory import RawTrajectory
from kinebench_drake.geometry import Array, make_pose, rotation_exp, rotation_log, rotation_z
from kinebench_drake.kinematics.manipulability import compute_manipulability
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.judge import TrackJudge, least_turn
from kinebench_drake.metrics.kinematic_result import KinematicResult
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.runs.evaluator import KINEMATIC_METRICS
from kinebench_drake.track import GripperTrack, IkStatus
from kinebench_drake.violation import Violation, ViolationKind
from tests.metrics.motions import gripper

KINDS = [
    *("unreachable", "joint_limit", "self_collision", "table_collision", "obstacle_collision"),
    *("velocity", "acceleration", "jerk", "torque", "discontinuity"),
]


@pytest.fixture(scope="module")
def judge(plant: ArmPlant) -> TrackJudge:
    return TrackJudge(plant)


def _poses(plant: ArmPlant, q: Array, period_s: float = 0.2) -> GripperTrack:
    """Gripper track of joint angles (T, 7)."""
    return gripper(period_s * np.arange(len(q)), plant.forward_path(q))


def _given(judge: TrackJudge, q: Array, period_s: float = 0.2) -> KinematicResult:
    """Joint angles (T, 7) judged as given."""
    return judge.judge_joints(period_s * np.arange(len(q)), q, np.full(len(q), 0.04))


def _gentle(n: int = 40) -> Array:
    """A slow wave of all joints about the rest posture."""
    s = np.linspace(0, 1, n)
    s = 10 * s**3 - 15 * s**4 + 6 * s**5
    return rest_q() + s[:, None] * [0.5, 0.3, -0.2, 0.2, 0.3, -0.2, 0.4]


def _kinds(result: KinematicResult) -> set[ViolationKind]:
    return {v.kind for v in result.violations}


def _number(metrics: Mapping[str, float | bool | None], name: str) -> float:
    value = metrics[name]
    assert isinstance(value, float)
    return value


def test_a_gentle_track_is_feasible_and_has_every_metric(plant: ArmPlant, judge: TrackJudge) -> None:
    track = _poses(plant, _gentle())
    result = judge.judge_poses(track)
    metrics = result.metrics
    q = result.joints.q
    assert result.feasible is True
    assert result.violations == ()
    assert set(KINEMATIC_METRICS) <= set(metrics)
    assert result.joints.ok.all()
    w = compute_manipulability(plant, q)
    assert metrics["manipulability_mean"] == pytest.approx(w.full.mean())
    assert metrics["manipulability_min"] == pytest.approx(w.full.min())
    assert metrics["manipulability_cost_mean"] == pytest.approx(w.cost.mean())
    trapezoid = np.sum(0.5 * (w.full[1:] + w.full[:-1]) * np.diff(track.t_s))
    assert metrics["manipulability_integral"] == pytest.approx(trapezoid)
    assert metrics["ik_success_rate"] == 1.0
    assert _number(metrics, "ik_position_error_max_m") < 1e-6
    for name in ("joint_limit_margin_min", "velocity_ratio_max", "acceleration_ratio_max", "torque_ratio_max"):
        assert 0.0 < _number(metrics, name) < 1.0
    for name in ("jerk_ratio_max", "time_scale", "slowdown_min", "self_distance_min_m", "table_distance_min_m"):
        assert 0.0 < _number(metrics, name) < 1.0
    assert metrics["trajopt_feasible"] is True
    assert _number(metrics, "trajopt_position_tube_m") < 0.001
    assert _number(metrics, "sparc") == pytest.approx(-1.4, abs=0.1)


def test_every_value_is_a_finite_number_or_has_a_reason_why_not(plant: ArmPlant, judge: TrackJudge) -> None:
    X = np.full((6, 4, 4), np.nan)
    far = np.tile(make_pose(np.eye(3), [3.0, 0.0, 0.0]), (6, 1, 1))
    still = np.tile(plant.forward(rest_q()), (40, 1, 1))
    tracks = [
        gripper(0.2 * np.arange(6), X),
        gripper(0.2 * np.arange(6), far),
        gripper(0.2 * np.arange(40), still),
        *(_poses(plant, _gentle(n)) for n in (2, 3, 4, 12)),
    ]
    for track in tracks:
        result = judge.judge_poses(track)
        assert set(KINEMATIC_METRICS) <= set(result.metrics)
        for name, value in result.metrics.items():
            assert (value is None) == (name in result.reasons), name
            assert value is None or np.isfinite(value), name


def test_nothing_tracked_is_not_measurable(judge: TrackJudge) -> None:
    result = judge.judge_poses(gripper(0.2 * np.arange(6), np.full((6, 4, 4), np.nan)))
    assert set(result.metrics.values()) == {None}
    assert result.feasible is None


def test_the_result_cannot_be_changed(judge: TrackJudge) -> None:
    result = _given(judge, _gentle(10))
    with pytest.raises(TypeError):
        result.metrics["sparc"] = 0.0  # type: ignore[index]


@pytest.mark.parametrize(("kept", "verdict"), [(40, True), (20, True), (19, None), (4, None)])
def test_few_tracked_frames_are_no_proof(plant: ArmPlant, judge: TrackJudge, kept: int, verdict: bool | None) -> None:
    X = _poses(plant, _gentle()).X_BG.copy()
    X[kept:] = np.nan
    result = judge.judge_poses(gripper(0.2 * np.arange(40), X))
    assert result.feasible is verdict
    assert result.metrics.get("ik_success_rate_bound", 1.0) == kept / 40
    assert result.metrics["ik_success_rate"] == 1.0


def test_frames_out_of_reach_are_named(plant: ArmPlant, judge: TrackJudge) -> None:
    q = np.array([0.0, 0.6, 0.0, -1.3, 0.0, 2.0, 0.8])
    X = np.tile(plant.forward(q), (40, 1, 1))
    X[:, 0, 3] += 0.5 * np.sin(np.pi * np.arange(40) / 39.0)
    result = judge.judge_poses(gripper(0.5 * np.arange(40), X))
    assert result.feasible is False
    assert _kinds(result) == {ViolationKind.UNREACHABLE}
    [violation] = result.violations
    missed = [i for i, s in enumerate(result.joints.status) if s is IkStatus.UNREACHABLE]
    assert missed == list(range(violation.frame_start, violation.frame_end + 1))
    assert violation.frame_start < 20 <= violation.frame_end
    assert violation.joint is None
    assert _number(result.metrics, "ik_position_error_max_m") > 0.1
    assert violation.value >= _number(result.metrics, "ik_position_error_max_m") > violation.limit
    assert result.metrics["ik_success_rate"] == pytest.approx(1 - len(missed) / 40)
    assert result.metrics["trajopt_feasible"] is False
    assert result.details["trajopt"]["against"]["kind"] == "unreachable"


def test_a_pose_past_a_joint_limit_names_joint_value_and_limit(plant: ArmPlant, judge: TrackJudge) -> None:
    X = np.tile(plant.forward([-0.4, 2.1, -0.4, -0.6, -2.8, 2.7, -0.6]), (8, 1, 1))
    result = judge.judge_poses(gripper(0.2 * np.arange(8), X))
    assert result.feasible is False
    assert _kinds(result) == {ViolationKind.JOINT_LIMIT}
    for violation in result.violations:
        assert (violation.frame_start, violation.frame_end) == (0, 7)
        j = int(str(violation.joint)[-1]) - 1
        assert (
            violation.value > plant.upper[j] == violation.limit or violation.value < plant.lower[j] == violation.limit
        )


def test_given_angles_past_a_limit_are_judged_as_given(plant: ArmPlant, judge: TrackJudge) -> None:
    """The pose may be reached otherwise; the angles asked for break the limit all the same."""
    q = _gentle()
    q[:, 3] += (plant.upper[3] + 0.1 - q[:, 3].max()) * np.sin(np.pi * np.arange(40) / 39.0) ** 2
    past = np.flatnonzero(q[:, 3] > plant.upper[3])
    result = _given(judge, q, period_s=5.0)
    [violation] = [v for v in result.violations if v.kind is ViolationKind.JOINT_LIMIT]
    assert violation == Violation(
        kind=ViolationKind.JOINT_LIMIT,
        frame_start=int(past[0]),
        frame_end=int(past[-1]),
        joint="panda_joint4",
        value=pytest.approx(q[:, 3].max()),
        limit=float(plant.upper[3]),
        unit="rad",
    )
    margin = (plant.upper[3] - q[:, 3].max()) / (0.5 * (plant.upper[3] - plant.lower[3]))
    assert result.metrics["joint_limit_margin_min"] == pytest.approx(margin)
    assert [i for i, s in enumerate(result.joints.status) if s is IkStatus.JOINT_LIMIT] == list(past)


def test_a_lower_joint_limit_is_distinguished_from_an_upper_one(plant: ArmPlant, judge: TrackJudge) -> None:
    q = _gentle()
    q[:, 3] -= 1.8 * np.sin(np.pi * np.arange(40) / 39.0) ** 2
    limits = [v for v in _given(judge, q, period_s=10.0).violations if v.kind is ViolationKind.JOINT_LIMIT]
    assert [(v.joint, v.limit) for v in limits] == [("panda_joint4", plant.lower[3])]
    assert limits[0].value == pytest.approx(q[:, 3].min())


@pytest.mark.parametrize(("factor", "broken"), [(0.99, False), (1.01, True)])
def test_speed_is_judged_against_the_limit(plant: ArmPlant, judge: TrackJudge, factor: float, broken: bool) -> None:
    q = np.tile(rest_q(), (30, 1))
    q[:, 4] += factor * plant.velocity_limits[4] * 0.05 * (np.arange(30) - 15.0)
    result = _given(judge, q, period_s=0.05)
    assert _number(result.metrics, "velocity_ratio_max") == pytest.approx(factor)
    assert _number(result.metrics, "slowdown_min") == pytest.approx(factor)
    assert result.feasible is not broken
    if broken:
        [violation] = result.violations
        assert (violation.kind, violation.joint) == (ViolationKind.VELOCITY, "panda_joint5")
        assert violation.value == pytest.approx(factor * violation.limit)


def test_a_track_played_slower_is_slower_in_proportion(judge: TrackJudge) -> None:
    fast, slow = (_given(judge, _gentle(), period).metrics for period in (0.1, 0.2))
    assert _number(fast, "velocity_ratio_max") == pytest.approx(2 * _number(slow, "velocity_ratio_max"), rel=1e-6)
    assert _number(fast, "acceleration_ratio_max") == pytest.approx(4 * _number(slow, "acceleration_ratio_max"))
    assert _number(fast, "slowdown_min") == pytest.approx(2 * _number(slow, "slowdown_min"), rel=1e-6)
    ratio = _number(slow, "manipulability_integral") / _number(fast, "manipulability_integral")
    assert ratio == pytest.approx(2.0)


def test_a_pose_track_whose_hand_jumps_is_discontinuous_and_too_fast(plant: ArmPlant, judge: TrackJudge) -> None:
    q = _gentle()
    q[20:, 0] += 2.0
    result = judge.judge_poses(_poses(plant, q))
    assert _kinds(result) >= {ViolationKind.VELOCITY, ViolationKind.DISCONTINUITY}
    [jump] = [v for v in result.violations if v.kind is ViolationKind.DISCONTINUITY]
    assert (jump.frame_start, jump.frame_end) == (19, 20)


def test_a_jump_of_a_turn_that_is_not_sure_leaves_the_verdict_open(plant: ArmPlant, judge: TrackJudge) -> None:
    track = _poses(plant, _gentle())
    X = track.X_BG.copy()
    X[20:, :3, :3] = X[20:, :3, :3] @ rotation_z(1.5)
    turned = replace(track, X_BG=X, offset_m=0.01)
    assert judge.judge_poses(turned).feasible is False
    result = judge.judge_poses(replace(turned, turn_is_sure=False))
    assert (result.feasible, result.violations) == (None, ())
    assert "the turn about the gripper's own axis is not sure" in result.reasons["feasible"]


def test_a_jump_of_the_position_counts_however_the_gripper_is_turned(plant: ArmPlant, judge: TrackJudge) -> None:
    q = _gentle()
    q[20:, 0] += 2.0
    result = judge.judge_poses(replace(_poses(plant, q), turn_is_sure=False))
    assert ViolationKind.DISCONTINUITY in _kinds(result)


def test_the_least_turn_keeps_positions_and_axes_and_turns_about_none(plant: ArmPlant) -> None:
    X = plant.forward_path(_gentle())
    X[3] = np.nan
    steady = least_turn(X, 0.7)
    assert np.array_equal(np.isnan(steady), np.isnan(X))
    steady = np.delete(steady, 3, axis=0)
    X = np.delete(X, 3, axis=0)
    assert steady[:, :3, 2:] == pytest.approx(X[:, :3, 2:], abs=1e-9)
    assert steady[0, :3, :3] == pytest.approx(X[0, :3, :3] @ rotation_z(0.7), abs=1e-12)
    turns = rotation_log(steady[1:, :3, :3] @ steady[:-1, :3, :3].swapaxes(1, 2))
    across = np.einsum("ni,ni->n", turns, steady[:-1, :3, 2])
    assert across == pytest.approx(0.0, abs=1e-9)


def test_a_gripper_pushed_into_the_table_collides_by_its_depth(plant: ArmPlant, judge: TrackJudge) -> None:
    X = np.tile(plant.forward(rest_q()), (40, 1, 1))
    X[:, 2, 3] -= 0.19 * np.sin(np.pi * np.arange(40) / 39.0) ** 2
    result = judge.judge_poses(gripper(0.2 * np.arange(40), X))
    assert _kinds(result) == {ViolationKind.TABLE_COLLISION}
    [violation] = result.violations
    assert violation.value == _number(result.metrics, "table_distance_min_m") < violation.limit == -0.002
    higher = TrackJudge(plant, table_height_m=-0.05).judge_poses(gripper(0.2 * np.arange(40), X))
    assert higher.feasible is True
    assert _number(higher.metrics, "table_distance_min_m") == pytest.approx(violation.value + 0.05, abs=1e-9)


def test_where_the_gap_is_unknown_open_fingers_alone_do_not_collide(plant: ArmPlant, judge: TrackJudge) -> None:
    X = np.tile(plant.forward(rest_q()), (40, 1, 1))
    X[:, :3, :3] = X[0, :3, :3] @ rotation_exp(np.array([0.5, 0.0, 0.0]))  # one finger lower than the other
    tilted = replace(gripper(0.2 * np.arange(40), X), finger_width_m=np.full(40, 0.08))
    left_m = _number(judge.judge_poses(tilted).metrics, "table_distance_min_m")
    X = X.copy()
    X[:, 2, 3] -= (left_m + 0.008) * np.sin(np.pi * np.arange(40) / 39.0) ** 2
    low = replace(tilted, X_BG=X)
    assert _kinds(judge.judge_poses(low)) == {ViolationKind.TABLE_COLLISION}
    assert judge.judge_poses(replace(low, finger_width_m=np.full(40, np.nan))).feasible is True
    X = X.copy()
    X[:, 2, 3] -= 0.03 * np.sin(np.pi * np.arange(40) / 39.0) ** 2  # the hand's middle as well
    lower = replace(low, X_BG=X, finger_width_m=np.full(40, np.nan))
    assert _kinds(judge.judge_poses(lower)) == {ViolationKind.TABLE_COLLISION}


def test_given_angles_that_fold_the_arm_into_itself_collide(plant: ArmPlant, judge: TrackJudge) -> None:
    q = np.tile(rest_q(), (40, 1))
    s = np.sin(np.pi * np.arange(40) / 39.0)[:, None] ** 2
    q += s * (np.array([0.0, -0.5, 0.0, -3.05, 0.0, 0.05, 0.785]) - rest_q())
    result = _given(judge, q, period_s=0.5)
    assert ViolationKind.SELF_COLLISION in _kinds(result)
    assert _number(result.metrics, "self_distance_min_m") < -0.002
    assert IkStatus.SELF_COLLISION in result.joints.status


@pytest.mark.parametrize("noise_mm", [1.0, 3.0, 5.0])
def test_noise_alone_condemns_no_good_track(plant: ArmPlant, judge: TrackJudge, noise_mm: float) -> None:
    rng = np.random.default_rng(0)
    for period_s in (0.05, 0.2):
        X = _poses(plant, _gentle(49), period_s).X_BG.copy()
        X[:, :3, 3] += rng.normal(0.0, 1e-3 * noise_mm, size=(49, 3))
        X[:, :3, :3] = X[:, :3, :3] @ rotation_exp(rng.normal(0.0, np.deg2rad(noise_mm / 2), size=(49, 3)))
        result = judge.judge_poses(gripper(period_s * np.arange(49), X))
        assert result.violations == ()
        assert result.details["noise"]["position_m"] == pytest.approx(1e-3 * noise_mm, rel=0.4)
        assert _number(result.metrics, "slowdown_min") <= 1.0
        assert result.metrics["trajopt_feasible"] is True


def test_violations_are_ordered_by_cause_and_within_a_kind_by_frame(plant: ArmPlant, judge: TrackJudge) -> None:
    """The joint jumps past its limit: what follows from that stands after it, though it begins a frame earlier."""
    q = _gentle()
    q[10:13, 3] = q[25:28, 3] = plant.upper[3] + 0.3
    violations = _given(judge, q, period_s=0.2).violations
    kinds = [v.kind for v in violations]
    assert kinds[:2] == [ViolationKind.JOINT_LIMIT] * 2
    assert ViolationKind.DISCONTINUITY in kinds
    assert violations[0].frame_start > min(v.frame_start for v in violations)
    order = [list(ViolationKind).index(kind) for kind in kinds]
    assert order == sorted(order)
    for kind in {*kinds}:
        starts = [v.frame_start for v in violations if v.kind is kind]
        assert starts == sorted(starts)


def test_kinds_are_those_of_the_output_format() -> None:
    assert {kind.value for kind in ViolationKind} == set(KINDS)


def test_times_must_increase(judge: TrackJudge) -> None:
    with pytest.raises(InputError, match="increase"):
        _given(judge, _gentle(5), period_s=0.0)


def test_what_jitters_more_than_any_noise_is_not_excused(plant: ArmPlant, judge: TrackJudge) -> None:
    """The gripper flung 0.3 m aside and back, the joints 0.25 rad, from each frame to the next."""
    aside = (-1.0) ** np.arange(49)
    X = np.tile(plant.forward(rest_q()), (49, 1, 1))
    X[:, 1, 3] += 0.15 * aside
    result = judge.judge_poses(gripper(0.2 * np.arange(49), X))
    assert result.feasible is False
    assert result.details["noise"]["position_m"] == 0.0
    flung = _given(judge, rest_q() + 0.25 * aside[:, None], period_s=0.02)
    assert ViolationKind.VELOCITY in _kinds(flung)
    past = np.tile(rest_q(), (49, 1))
    past[:, 1] = plant.upper[1] + 0.14 + 0.1 * aside
    assert ViolationKind.JOINT_LIMIT in _kinds(_given(judge, past, period_s=0.02))


def test_lost_frames_hide_no_speed(plant: ArmPlant, judge: TrackJudge) -> None:
    q = _gentle(49)
    q[1::2] = np.nan
    assert ViolationKind.VELOCITY in _kinds(_given(judge, q, period_s=0.002))
    jump = np.tile(rest_q(), (49, 1))
    jump[25:, 0] += 1.5
    jump[24] = np.nan
    assert ViolationKind.VELOCITY in _kinds(_given(judge, jump, period_s=0.05))


def test_rounding_at_a_limit_is_within_it(plant: ArmPlant, judge: TrackJudge) -> None:
    q = np.tile(rest_q(), (20, 1))
    q[:, 0] = np.float32(plant.upper[0])
    assert (q[:, 0] != plant.upper[0]).all()
    result = _given(judge, q)
    assert result.feasible is True
    assert result.metrics["ik_success_rate"] == 1.0


@pytest.mark.parametrize(("rate_hz", "decimals"), [(50, 2), (1000, 3), (1000, 2)])
def test_rounding_is_no_motion_and_hides_no_jump(judge: TrackJudge, rate_hz: int, decimals: int) -> None:
    t_s = np.arange(rate_hz) / rate_hz
    q = rest_q() + 0.3 * np.sin(1.5 * t_s)[:, None] * np.linspace(1.0, 0.2, 7)
    width = np.full(rate_hz, 0.04)
    assert judge.judge_joints(t_s, q.round(decimals), width).feasible is True
    q[rate_hz // 2 :, 0] += 0.4
    assert ViolationKind.DISCONTINUITY in _kinds(judge.judge_joints(t_s, q.round(decimals), width))


@pytest.mark.parametrize("seed", [0, 2])
def test_jittering_stamps_make_no_feasible_motion_infeasible(judge: TrackJudge, seed: int) -> None:
    """Stamps of a 250 Hz recording that are off by 0.5 ms: as they are, and as an audit reads them."""
    rng = np.random.default_rng(seed)
    even = np.arange(500) / 250
    q = rest_q() + 0.4 * np.sin(3 * even)[:, None] * np.linspace(1.0, 0.2, 7) + 1e-5 * rng.normal(size=(500, 7))
    stamps = even + np.clip(5e-4 * rng.normal(size=500), -1e-3, 1e-3)
    width = np.full(500, 0.04)
    assert ViolationKind.DISCONTINUITY in _kinds(judge.judge_joints(stamps, q, width))
    t_s = check(RawTrajectory(columns="q", t_s=stamps, q=q)).t_s
    assert judge.judge_joints(t_s, q, width).feasible is True


def test_metrics_of_unreachable_postures_are_null(plant: ArmPlant, judge: TrackJudge) -> None:
    far = np.tile(make_pose(np.eye(3), [3.0, 0.0, 0.0]), (12, 1, 1))
    metrics = judge.judge_poses(gripper(0.2 * np.arange(12), far)).metrics
    names = ("slowdown_min", "self_distance_min_m", "table_distance_min_m", "joint_limit_margin_min")
    assert [metrics[name] for name in names] == [None] * 4


def _lowered(plant: ArmPlant, by_m: float) -> GripperTrack:
    """Track that dips by a depth below the rest pose."""
    X = np.tile(plant.forward(rest_q()), (40, 1, 1))
    X[:, 2, 3] -= by_m * np.sin(np.pi * np.arange(40) / 39.0) ** 2
    return gripper(0.2 * np.arange(40), X)


@pytest.mark.parametrize(("depth_m", "verdict"), [(0.006, True), (0.009, None), (0.011, None), (0.014, False)])
def test_the_verdict_on_estimated_poses_is_open_near_a_limit(
    plant: ArmPlant, judge: TrackJudge, depth_m: float, verdict: bool | None
) -> None:
    left_m = _number(judge.judge_poses(_lowered(plant, 0.15)).metrics, "table_distance_min_m")
    result = judge.judge_poses(replace(_lowered(plant, 0.15 + left_m + depth_m), offset_m=0.01))
    assert result.feasible is verdict
    assert bool(result.violations) is (verdict is False)
    if verdict is None:
        assert "table_collision" in result.reasons["feasible"]


def test_an_open_verdict_says_why(plant: ArmPlant, judge: TrackJudge) -> None:
    result = judge.judge_poses(_poses(plant, _gentle(3)))
    assert result.feasible is None
    assert "3 of 3 frames" in result.reasons["feasible"]


@pytest.mark.parametrize(
    ("depth_m", "offset_m", "collides"), [(0.006, 0.0, True), (0.006, 0.01, False), (0.03, 0.01, True)]
)
def test_poses_that_may_be_off_collide_only_beyond_that(
    plant: ArmPlant, judge: TrackJudge, depth_m: float, offset_m: float, collides: bool
) -> None:
    left_m = _number(judge.judge_poses(_lowered(plant, 0.15)).metrics, "table_distance_min_m")
    found = judge.judge_poses(replace(_lowered(plant, 0.15 + left_m + depth_m), offset_m=offset_m))
    assert _number(found.metrics, "table_distance_min_m") == pytest.approx(-depth_m, abs=1e-3)
    assert (ViolationKind.TABLE_COLLISION in _kinds(found)) is collides
    assert found.details["noise"]["offset_m"] == offset_m
