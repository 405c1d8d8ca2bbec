"""No number of a track improves because frames are lost or cannot be reached."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from benchmarks.loss import LossWorker
from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array, rotation_exp
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.manipulability import compute_manipulability
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.coverage import COST_MAX, MISS_M
from kinebench_drake.metrics.executable import judge_evidence, reason_kind
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.metrics.kinematic_result import KinematicResult
from kinebench_drake.metrics.smoothness import MAX_LOST_SHARE, ldlj, least_arc, least_ldlj, measure_smoothness, sparc
from kinebench_drake.track import GripperTrack, IkStatus

N = 40
SPEEDS = arrays(np.float64, N, elements=st.floats(0.0, 5.0, width=32))
FRAMES = st.sets(st.integers(0, N - 1), max_size=N - 1)


def _least(speed: Array, unknown: set[int]) -> tuple[float, float]:
    """SPARC and LDLJ with some speeds unknown."""
    hidden = speed.copy()
    hidden[sorted(unknown)] = np.nan
    return least_arc(hidden, 5.0, 1024, 2.5), least_ldlj(hidden, 5.0)


@given(speed=SPEEDS, first=FRAMES, second=FRAMES)
def test_unknown_speeds_never_raise_smoothness(speed: Array, first: set[int], second: set[int]) -> None:
    few = _least(speed, first)
    many = _least(speed, first | second)
    assert many[0] <= few[0] + 1e-9
    assert many[1] <= few[1] + 1e-9


@given(speed=SPEEDS, unknown=FRAMES)
def test_no_motion_is_below_the_bounds(speed: Array, unknown: set[int]) -> None:
    if np.ptp(speed) == 0.0:
        return
    arc, jerk = (float(measure(speed[None], 5.0)[0]) for measure in (sparc, ldlj))
    least = _least(speed, unknown)
    assert not arc < least[0] - 1e-9
    assert jerk >= least[1] - 1e-9


def test_the_bound_of_jerk_is_taken() -> None:
    speed = np.sin(np.linspace(0.0, np.pi, N))
    speed[[10, 11]] = np.nan
    completions = []
    for a, b in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)):
        for size in (np.nanmax(speed), 1e9):  # as fast as the known motion, or so fast that it vanishes beside it
            whole = speed.copy()
            whole[[10, 11]] = size * np.array([a, b])
            completions.append(float(ldlj(whole[None], 5.0)[0]))
    assert least_ldlj(speed, 5.0) == pytest.approx(min(completions))


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(steps=arrays(np.float64, (N, 6), elements=st.floats(-0.125, 0.125, width=32)), order=st.permutations(range(N)))
def test_losing_frames_never_improves_smoothness(steps: Array, order: list[int]) -> None:
    path = np.cumsum(steps, axis=0)
    X_BG = np.tile(np.eye(4), (N, 1, 1))
    X_BG[:, :3, 3] = path[:, :3]
    X_BG[:, :3, :3] = rotation_exp(path[:, 3:])
    tracked = np.ones(N, dtype=bool)
    before = measure_smoothness(_gripper(X_BG, tracked)).metrics
    for lost in order[:3]:
        tracked = tracked & (np.arange(N) != lost)
        result = measure_smoothness(_gripper(X_BG, tracked))
        for name, value in result.bounds.items():
            old = before[name]
            assert value is None or old is None or value <= old + 1e-9
        if (~tracked).sum() > MAX_LOST_SHARE * N:
            assert set(result.bounds.values()) == {None}
        before = result.bounds


def _gripper(X_BG: Array, tracked: NDArray[np.bool_]) -> GripperTrack:
    n = len(tracked)
    return GripperTrack(
        t_s=0.2 * np.arange(n),
        X_CH=np.full_like(X_BG, np.nan),
        X_BG=np.where(tracked[:, None, None], X_BG, np.nan),
        tracked=tracked,
        confidence=tracked.astype(np.float64),
        finger_width_m=np.full(n, 0.04),
    )


@pytest.mark.parametrize("index", [0, 1, *(pytest.param(index, marks=pytest.mark.exhaustive) for index in range(2, 6))])
def test_no_number_of_a_random_track_improves(index: int) -> None:
    assert LossWorker(2024)(index).improved == {}


@pytest.fixture(scope="module")
def judge(plant: ArmPlant) -> TrackJudge:
    return TrackJudge(plant)


@pytest.fixture(scope="module")
def reach(plant: ArmPlant) -> GripperTrack:
    """A feasible track."""
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 25))
    q = plant.robot.rest_q + share[:, None] * np.array([0.6, 0.3, -0.2, 0.4, 0.2, -0.3, 0.5])
    return _gripper(plant.forward_path(q), np.ones(25, dtype=bool))


def _lose(judge: TrackJudge, track: GripperTrack, frames: list[int]) -> KinematicResult:
    tracked = track.tracked.copy()
    tracked[frames] = False
    return judge.judge_poses(_gripper(track.X_BG, tracked))


def test_a_lost_frame_has_no_manipulability(judge: TrackJudge, reach: GripperTrack) -> None:
    whole = judge.judge_poses(reach).metrics
    result = _lose(judge, reach, [12])
    metrics = result.metrics
    assert not any(name.endswith("_bound") for name in whole)
    assert metrics["manipulability_min_bound"] == 0.0
    assert metrics["ik_success_rate_bound"] == 24 / 25
    assert metrics["manipulability_cost_mean_bound"] > COST_MAX / 25
    assert metrics["manipulability_mean_bound"] < 24 / 25 * metrics["manipulability_mean"]
    assert metrics["sparc_bound"] < metrics["sparc"]
    assert metrics["slowdown_min_bound"] is None
    assert result.reasons["slowdown_min_bound"] == "1 of 25 frames are lost"
    assert 0.0 < metrics["slowdown_min"] < 1.0


@pytest.mark.parametrize("lost", [[12], [3, 17], [9, 10], [4, 12, 20]])
def test_bridged_frames_leave_the_values_where_they_are(
    judge: TrackJudge, reach: GripperTrack, lost: list[int]
) -> None:
    whole = judge.judge_poses(reach).metrics
    result = _lose(judge, reach, lost)
    assert np.flatnonzero(result.curves["bridged"]).tolist() == lost
    for name in ("sparc", "ldlj", "sparc_rotation", "manipulability_mean", "manipulability_min"):
        assert result.metrics[name] == pytest.approx(whole[name], rel=0.05)


def test_gaps_at_the_ends_and_long_ones_stay_open(judge: TrackJudge, reach: GripperTrack) -> None:
    assert not _lose(judge, reach, [0, 24]).curves["bridged"].any()
    result = _lose(judge, reach, list(range(6, 15)))
    assert not result.curves["bridged"].any()
    assert result.metrics["sparc"] is None
    assert "lost or apart" in result.reasons["sparc"]


def test_a_missed_pose_loses_its_manipulability_with_the_distance(plant: ArmPlant, judge: TrackJudge) -> None:
    X = plant.forward(plant.robot.rest_q)
    near = X.copy()
    far = X.copy()
    far[0, 3] += 1.0
    while far[0, 3] - near[0, 3] > 1e-6:  # the end of reach along x
        middle = 0.5 * (near + far)
        if solve_pose(plant, middle, plant.robot.rest_q).status is IkStatus.OK:
            near = middle
        else:
            far = middle
    for distance_m in (0.25 * MISS_M, 0.5 * MISS_M, 5.0 * MISS_M):
        poses = np.tile(near, (12, 1, 1))
        poses[6, 0, 3] += distance_m
        result = judge.judge_poses(_gripper(poses, np.ones(12, dtype=bool)))
        nearest = solve_pose(plant, poses[6], plant.robot.rest_q)
        error_m = np.hypot(nearest.position_error_m, ROTATION_ARM_M * nearest.rotation_error_rad)
        [w] = compute_manipulability(plant, nearest.q[None]).full * max(0.0, 1.0 - error_m / MISS_M)
        assert result.curves["manipulability"][6] == pytest.approx(w, abs=1e-9)
        assert ("manipulability_min_bound" in result.metrics) is bool(error_m >= MISS_M)
        assert (result.metrics["manipulability_min"] == 0.0) is bool(error_m >= MISS_M)


def test_joints_past_their_limits_are_unreachable(plant: ArmPlant, judge: TrackJudge) -> None:
    q = np.tile(plant.robot.rest_q, (20, 1)) + 0.01 * np.sin(np.arange(20.0))[:, None]
    q[5:8, 3] = plant.upper[3] + 0.2
    result = judge.judge_joints(0.2 * np.arange(20), q, np.full(20, 0.04))
    w = compute_manipulability(plant, q).full
    np.testing.assert_array_equal(result.curves["manipulability"][5:8], 0.0)
    np.testing.assert_allclose(result.curves["manipulability"][:5], w[:5])
    assert result.metrics["manipulability_mean"] == pytest.approx(np.delete(w, [5, 6, 7]).sum() / 20)
    assert result.metrics["joint_limit_margin_min"] < 0.0
    assert result.metrics["ik_position_error_max_m"] > 0.01  # from where the arm would be within its limits


def test_a_track_without_a_reached_frame_has_no_manipulability(judge: TrackJudge, reach: GripperTrack) -> None:
    X_BG = reach.X_BG.copy()
    X_BG[:, 2, 3] += 3.0
    result = judge.judge_poses(replace(reach, X_BG=X_BG))
    assert result.metrics["manipulability_mean"] is None
    assert result.metrics["ik_success_rate"] == 0.0
    assert result.metrics["trajopt_feasible"] in (None, False)


def _anomaly(kind: AnomalyKind, first: int, last: int) -> Anomaly:
    return Anomaly(kind=kind, frame_start=first, frame_end=last, severity=1.0)


@pytest.mark.parametrize(
    ("feasible", "lost", "anomalies", "executable", "reasons"),
    [
        (True, 0, [], True, []),
        (True, 0, [_anomaly(AnomalyKind.CAMERA, 0, 9)], True, []),
        (True, 3, [], None, ["lost: 3 frames"]),
        (None, 0, [], None, ["undecided"]),
        (None, 30, [], None, ["undecided", "lost: 30 frames"]),
        (False, 1, [], False, ["infeasible", "lost: 1 frame"]),
        (True, 2, [_anomaly(AnomalyKind.VANISH, 4, 8)], False, ["vanish: 5 frames", "lost: 2 frames"]),
        (
            False,
            0,
            [
                _anomaly(AnomalyKind.TELEPORT, 3, 3),
                _anomaly(AnomalyKind.TELEPORT, 9, 9),
                _anomaly(AnomalyKind.FREEZE, 1, 6),
            ],
            False,
            ["infeasible", "freeze: 6 frames", "teleport: 2 frames"],
        ),
    ],
)
def test_only_evidence_against_a_video_makes_it_not_executable(
    feasible: bool | None, lost: int, anomalies: list[dict[str, Any]], executable: bool | None, reasons: list[str]
) -> None:
    assert judge_evidence(feasible, lost, anomalies) == (executable, tuple(reasons))
    assert all(reason_kind(reason).isidentifier() for reason in reasons)


def test_an_open_kind_of_anomaly_leaves_a_video_undecided() -> None:
    assert judge_evidence(True, 0, open_kinds=["teleport"]) == (None, ("open: teleport",))
    assert judge_evidence(True, 0, open_kinds=["camera_motion"]) == (True, ())
    against = judge_evidence(True, 0, [_anomaly(AnomalyKind.FREEZE, 1, 6)], open_kinds=["teleport"])
    assert against == (False, ("freeze: 6 frames", "open: teleport"))
