"""No number of a track improves because frames are lost or cannot be reached."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from benchmarks.loss import LossWorker
from kinebench_drake.geometry import Array, rotation_exp
from kinebench_drake.kinematics.ik import solve_pose
from kinebench_drake.kinematics.manipulability import compute_manipulability
from kinebench_drake.kinematics.newton import ROTATION_ARM_M
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.completion import least_arc, least_ldlj
from kinebench_drake.metrics.executable import INFEASIBLE, LOST, UNDECIDED, find_obstacles, is_executable
from kinebench_drake.metrics.judge import TrackJudge
from kinebench_drake.metrics.loss import COST_MAX, MISS_M
from kinebench_drake.metrics.result import KinematicResult
from kinebench_drake.metrics.smoothness import MAX_LOST_SHARE, ldlj, measure_smoothness, sparc
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
    few, many = _least(speed, first), _least(speed, first | second)
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
    X_BG[:, :3, 3], X_BG[:, :3, :3] = path[:, :3], rotation_exp(path[:, 3:])
    tracked = np.ones(N, dtype=bool)
    before = measure_smoothness(_gripper(X_BG, tracked)).metrics
    for lost in order[:3]:
        tracked = tracked & (np.arange(N) != lost)
        result = measure_smoothness(_gripper(X_BG, tracked))
        for name, value in result.metrics.items():
            old = before[name]
            assert value is None or old is None or value <= old + 1e-9
        if (~tracked).sum() > MAX_LOST_SHARE * N:
            assert set(result.metrics.values()) == {None}
            assert "frames are lost" in result.reasons["sparc"]
        before = result.metrics


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
    whole, result = judge.judge_poses(reach), _lose(judge, reach, [12])
    assert whole.without_lost == {}
    assert result.metrics["manipulability_min"] == 0.0
    assert result.metrics["ik_success_rate"] == 24 / 25
    assert result.metrics["manipulability_cost_mean"] > COST_MAX / 25
    assert result.metrics["manipulability_mean"] < 24 / 25 * result.without_lost["manipulability_mean"]
    assert result.metrics["sparc"] < result.without_lost["sparc"]
    assert result.metrics["slowdown_min"] is None
    assert result.reasons["slowdown_min"] == "1 of 25 frames are lost"
    assert 0.0 < result.without_lost["slowdown_min"] < 1.0


def test_a_missed_pose_loses_its_manipulability_with_the_distance(plant: ArmPlant, judge: TrackJudge) -> None:
    X = plant.forward(plant.robot.rest_q)
    near, far = X.copy(), X.copy()
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
        assert (result.without_lost == {}) is bool(error_m < MISS_M)
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


def _tracked(n: int, lost: list[int]) -> NDArray[np.bool_]:
    return ~np.isin(np.arange(n), lost)


@pytest.mark.parametrize(
    ("feasible", "lost", "anomalies", "obstacles"),
    [
        (True, [], [], []),
        (True, [], ["camera_motion"], []),
        (True, [4, 5], [], []),  # bridged
        (True, [4, 5, 6], [], [LOST]),
        (True, [0], [], [LOST]),
        (True, [48], [], [LOST]),
        (True, [2, 8, 14, 20, 26], [], [LOST]),  # more than a tenth
        (True, [4], None, [LOST]),  # a trajectory
        (True, [], None, []),
        (False, [], ["teleport", "teleport", "freeze"], [INFEASIBLE, "freeze", "teleport"]),
        (None, [], [], [UNDECIDED]),
        (None, list(range(30)), [], [UNDECIDED, LOST]),
    ],
)
def test_obstacles_to_execution_are_listed_and_determine_executable(
    feasible: bool | None, lost: list[int], anomalies: list[str] | None, obstacles: list[str]
) -> None:
    found = find_obstacles(feasible, _tracked(49, lost), anomalies)
    assert found == obstacles
    assert is_executable(found) is (True if not obstacles else None if obstacles == [UNDECIDED] else False)
