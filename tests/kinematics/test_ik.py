import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.ik import (
    branch_jumps,
    follow,
    least_excess,
    postures_of,
    solve_pose,
    solve_track,
)
from kinebench_drake.kinematics.newton import newton, snopt
from kinebench_drake.kinematics.path import excess, speed_ratios
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.robot import rest_q
from kinebench_drake.products import GripperTrack, IkStatus

FAR_POSE = make_pose(np.eye(3), [2.0, 0.0, 0.0])


def _track(X_BG: Array, period_s: float, tracked: Array | None = None) -> GripperTrack:
    n = len(X_BG)
    seen = np.ones(n, dtype=bool) if tracked is None else np.asarray(tracked, dtype=bool)
    X = np.where(seen[:, None, None], X_BG, np.nan)
    return GripperTrack(
        t_s=period_s * np.arange(n),
        X_CH=X,
        X_BG=X,
        tracked=seen,
        confidence=np.ones(n),
        finger_width_m=np.full(n, 0.04),
    )


def _tabletop_track(n: int = 49, seed: int = 0) -> GripperTrack:
    """A path over the table with turns of the gripper, 0.2 s a frame."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, n)
    knots = np.linspace(0, 1, 5)
    p = CubicSpline(knots, rng.uniform([0.4, -0.25, 0.05], [0.65, 0.25, 0.35], size=(5, 3)))(s)
    turn = CubicSpline(knots, rng.uniform(-0.4, 0.4, size=(5, 3)))(s)
    return _track(make_pose(rotation_exp(turn) @ np.diag([1.0, -1.0, -1.0]), p), 0.2)


PAST_LIMIT = {
    "panda_joint2": [-0.4, 2.1, -0.4, -0.6, -2.8, 2.7, -0.6],
    "panda_joint4": [-0.6, 0.7, -0.3, -3.4, 2.5, 3.2, -2.2],
    "panda_joint7": [2.7, 0.3, -1.0, -0.5, -0.1, 3.1, 3.2],
}
"""Postures with one joint past its limit whose poses no posture within limits reaches (a dense sweep says so)."""


def test_forward_of_ik_is_the_pose_within_limits(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    for q in rng.uniform(plant.lower, plant.upper, size=(100, 7)):
        X_BG = plant.forward(q)
        solution = solve_pose(plant, X_BG, rest_q())
        assert solution.status is IkStatus.OK
        distance, angle = pose_difference(plant.forward(solution.q), X_BG)
        assert max(distance, angle, solution.position_error_m, solution.rotation_error_rad) <= 1e-6
        assert (solution.q >= plant.lower).all()
        assert (solution.q <= plant.upper).all()


def test_a_seed_at_the_solution_is_kept(plant: ArmPlant) -> None:
    rng = np.random.default_rng(1)
    for q in rng.uniform(plant.lower, plant.upper, size=(20, 7)):
        np.testing.assert_allclose(solve_pose(plant, plant.forward(q), q).q, q, atol=1e-9)


def test_a_near_seed_leads_to_a_near_solution(plant: ArmPlant) -> None:
    q = np.array([0.3, 0.4, 0.2, -1.9, 0.2, 2.2, 0.6])
    X_BG = plant.forward(q)
    assert np.abs(solve_pose(plant, X_BG, q + 0.02).q - q).max() < 0.1


def test_rotations_that_are_slightly_off_are_made_orthonormal(plant: ArmPlant) -> None:
    X_BG = plant.forward(rest_q())
    X_BG[:3, :3] *= 0.9997
    assert solve_pose(plant, X_BG, rest_q()).status is IkStatus.OK


def test_a_pose_far_away_is_unreachable_and_approached(plant: ArmPlant) -> None:
    solution = solve_pose(plant, FAR_POSE, rest_q())
    assert solution.status is IkStatus.UNREACHABLE
    assert excess(plant, solution.q).max() == 0.0
    assert 0.8 < solution.position_error_m < 1.3  # the arm is 0.855 m long from its shoulder, and the hand
    start = float(pose_difference(plant.forward(rest_q()), FAR_POSE)[0])
    assert solution.position_error_m < start


@pytest.mark.parametrize("name", PAST_LIMIT)
def test_a_pose_only_reached_past_a_limit_is_told_from_one_out_of_reach(plant: ArmPlant, name: str) -> None:
    X_BG = plant.forward(PAST_LIMIT[name])
    dense = postures_of(plant).all(X_BG[None], 5000)[0]
    assert excess(plant, dense).max(axis=-1).min() > 0.1
    solution = solve_pose(plant, X_BG, rest_q())
    assert solution.status is IkStatus.JOINT_LIMIT
    assert excess(plant, solution.q).max() == 0.0
    assert solution.position_error_m > 1e-4
    posture = least_excess(plant, X_BG)
    assert posture is not None
    assert max(pose_difference(plant.forward(posture), X_BG)) < 1e-9
    assert excess(plant, posture).max() <= excess(plant, np.array(PAST_LIMIT[name])).max()


def test_a_window_between_the_samples_of_the_sweep_is_found(plant: ArmPlant) -> None:
    X_BG = plant.forward([0.6, -2.1, -0.8, -0.5, -0.2, 1.3, -0.9])
    assert excess(plant, postures_of(plant).all(X_BG[None], 128)[0]).max(axis=-1).min() > 0.02
    assert solve_pose(plant, X_BG, rest_q()).status is IkStatus.OK


@pytest.mark.parametrize("joint", range(7))
def test_a_joint_at_its_limit_is_no_obstacle(plant: ArmPlant, joint: int) -> None:
    q = np.array([0.3, 0.4, 0.2, -1.9, 0.2, 2.2, 0.6])
    q[joint] = plant.upper[joint]
    assert solve_pose(plant, plant.forward(q), rest_q()).status is IkStatus.OK


def test_newton_without_limits_goes_past_them_and_with_limits_does_not(plant: ArmPlant) -> None:
    q = np.array(PAST_LIMIT["panda_joint2"])
    X_BG, start = plant.forward(q), np.clip(q, plant.lower, plant.upper)
    free, free_error = newton(plant, X_BG, start, bounded=False, iterations=100)
    held, held_error = newton(plant, X_BG, start, iterations=100)
    assert free_error < 1e-9
    assert excess(plant, free).max() > 0.1
    assert held_error > 1e-3
    assert excess(plant, held).max() == 0.0


def test_newton_finishes_what_snopt_begins(plant: ArmPlant) -> None:
    X_BG = plant.forward(rest_q() + 0.2)
    q = snopt(plant, X_BG, rest_q())
    assert max(pose_difference(plant.forward(q), X_BG)) < 2e-3
    assert newton(plant, X_BG, q)[1] < 1e-9


@pytest.mark.parametrize("bad", [np.full((4, 4), np.nan), np.eye(3)])
def test_a_pose_that_is_none_is_refused(plant: ArmPlant, bad: Array) -> None:
    with pytest.raises(InputError, match="X_BG"):
        solve_pose(plant, bad, rest_q())


def test_a_track_is_followed_exactly_and_continuously(plant: ArmPlant) -> None:
    for seed in range(4):
        track = _tabletop_track(seed=seed)
        joints = solve_track(plant, track)
        assert joints.ok.all()
        assert joints.position_error_m.max() <= 1e-6
        assert joints.rotation_error_rad.max() <= 1e-6
        assert excess(plant, joints.q).max() == 0.0
        for q, X_BG in zip(joints.q, track.X_BG, strict=True):
            assert max(pose_difference(plant.forward(q), X_BG)) <= 1e-6
        assert speed_ratios(plant, joints.t_s, joints.q).max() < 1.0


def test_the_first_frame_takes_the_branch_of_the_rest_posture(plant: ArmPlant) -> None:
    X_BG = np.array([plant.forward(rest_q() + 0.02 * k) for k in range(5)])
    joints = solve_track(plant, _track(X_BG, 0.2))
    assert np.abs(joints.q[0] - rest_q()).max() < 0.1


def test_frames_that_are_not_tracked_are_left_out(plant: ArmPlant) -> None:
    track = _tabletop_track(20)
    seen = np.ones(20, dtype=bool)
    seen[[0, 7, 8, 19]] = False
    joints = solve_track(plant, _track(track.X_BG, 0.2, seen))
    np.testing.assert_array_equal(joints.ok, seen)
    assert [s for s, t in zip(joints.status, seen, strict=True) if not t] == [IkStatus.NOT_TRACKED] * 4
    np.testing.assert_array_equal(np.isnan(joints.q).all(axis=-1), ~seen)
    np.testing.assert_array_equal(np.isnan(joints.position_error_m), ~seen)


def test_a_track_of_nothing_is_solved_to_nothing(plant: ArmPlant) -> None:
    joints = solve_track(plant, _track(np.tile(np.eye(4), (3, 1, 1)), 0.2, np.zeros(3)))
    assert set(joints.status) == {IkStatus.NOT_TRACKED}


def test_one_frame_out_of_reach_does_not_spoil_its_neighbours(plant: ArmPlant) -> None:
    X_BG = _tabletop_track().X_BG.copy()
    X_BG[5] = FAR_POSE
    joints = solve_track(plant, _track(X_BG, 0.2))
    assert joints.status[5] is IkStatus.UNREACHABLE
    assert joints.position_error_m[5] > 0.5
    assert np.delete(joints.ok, 5).all()
    assert speed_ratios(plant, np.delete(joints.t_s, 5), np.delete(joints.q, 5, axis=0)).max() < 1.0


def _joint_paths(plant: ArmPlant, count: int, seed: int, share: float) -> list[tuple[Array, float]]:
    """Joint paths (49, 7) all over the joint ranges and the frame period [s] at which they use `share` of limits."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < count:
        knots = rng.uniform(plant.lower, plant.upper, size=(4, 7))
        q = CubicSpline(np.linspace(0, 1, 4), knots)(np.linspace(0, 1, 49))
        if excess(plant, q).max() == 0.0:
            speed = (np.abs(np.diff(q, axis=0)) / plant.velocity_limits).max()
            acceleration = (np.abs(np.diff(q, 2, axis=0)) / plant.acceleration_limits).max()
            found.append((q, max(speed / share, float(np.sqrt(acceleration / share)))))
    return found


@pytest.mark.slow
def test_a_way_within_limits_is_found_where_there_is_one(plant: ArmPlant) -> None:
    """Joint paths at 90 % of the limits, all over the joint space, known by their poses only.

    Some pass singularities, limits and stretched arms, where greedy steps and coarse grids fail.
    """
    for q, period in _joint_paths(plant, 40, seed=7, share=0.9):
        track = _track(np.array([plant.forward(row) for row in q]), period)
        joints = solve_track(plant, track)
        assert joints.ok.all()
        assert speed_ratios(plant, track.t_s, joints.q).max() <= 1.0


def test_a_warm_start_goes_on_from_its_posture(plant: ArmPlant) -> None:
    for q, period in _joint_paths(plant, 5, seed=3, share=0.3):
        X_BG = np.array([plant.forward(row) for row in q])
        joints = follow(plant, period * np.arange(len(q)), X_BG, q[0])
        assert joints.ok.all()
        assert speed_ratios(plant, joints.t_s, joints.q).max() <= 1.0


def test_a_jump_between_branches_is_told_from_motion(plant: ArmPlant) -> None:
    q, _ = _joint_paths(plant, 1, seed=5, share=0.3)[0]
    X_BG = np.array([plant.forward(row) for row in q])
    assert len(branch_jumps(plant, X_BG, q)) == 0
    other = postures_of(plant).all(X_BG[20:21], 64)[0]
    q[20:] = other[np.argmax(np.abs(other - q[20]).max(axis=-1))]
    X_BG[20:] = X_BG[20]
    assert list(branch_jumps(plant, X_BG, q)) == [20]


def test_the_arm_is_bent_around_what_it_would_run_into(plant: ArmPlant) -> None:
    """A table so high that the nearest posture's elbow lies in it: another posture of the same poses clears it."""
    q = np.array([-0.51, 1.66, -1.44, -1.85, 0.96, 2.64, 1.09]) + np.linspace(0.0, 0.1, 9)[:, None]
    X_BG = np.array([plant.forward(row) for row in q])
    track = _track(X_BG, 0.2)
    plain = solve_track(plant, track)
    low = CollisionModel(plant).table_distance(plain.q).distance_m.min()
    highest = max(
        CollisionModel(plant).table_distance(layer).distance_m.max() for layer in postures_of(plant).all(X_BG, 64)
    )
    assert highest > low + 0.02
    model = CollisionModel(plant, table_height_m=low + 0.01)
    joints = solve_track(plant, track, model)
    assert joints.ok.all()
    assert model.table_distance(joints.q).distance_m.min() >= -0.002


def test_a_gripper_in_the_table_collides_whatever_the_posture(plant: ArmPlant) -> None:
    track = _tabletop_track()
    X_BG = track.X_BG.copy()
    X_BG[10:13, 2, 3] = -0.03
    joints = solve_track(plant, _track(X_BG, 0.2), CollisionModel(plant))
    wrong = [i for i, s in enumerate(joints.status) if s is IkStatus.TABLE_COLLISION]
    assert wrong == [10, 11, 12]
    assert np.isfinite(joints.q).all()


def test_times_must_increase(plant: ArmPlant) -> None:
    with pytest.raises(InputError, match="increase"):
        solve_track(plant, _track(_tabletop_track(3).X_BG, 0.0))


def test_the_same_track_gives_the_same_bytes(plant: ArmPlant) -> None:
    track = _tabletop_track(15)
    assert solve_track(plant, track).q.tobytes() == solve_track(ArmPlant(), track).q.tobytes()
