from typing import cast

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, pose_difference, rotation_exp
from kinebench_drake.kinematics.collision import Clearance, CollisionModel
from kinebench_drake.kinematics.continuation import continue_path
from kinebench_drake.kinematics.path import is_sound, limit_excess, search_path, speed_ratios
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver
from kinebench_drake.kinematics.track_ik import solve_track, verify_path
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.track import GripperTrack, IkStatus
from tests.metrics.motions import gripper

FAR_POSE = make_pose(np.eye(3), [2.0, 0.0, 0.0])


def _track(X_BG: Array, period_s: float, tracked: Array | None = None) -> GripperTrack:
    posed = np.ones(len(X_BG), dtype=bool) if tracked is None else np.asarray(tracked, dtype=bool)
    return gripper(period_s * np.arange(len(X_BG)), np.where(posed[:, None, None], X_BG, np.nan))


def _tabletop_track(n: int = 49, seed: int = 0) -> GripperTrack:
    """A path over the table with turns of the gripper, 0.2 s a frame."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, n)
    knots = np.linspace(0, 1, 5)
    p = CubicSpline(knots, rng.uniform([0.4, -0.25, 0.05], [0.65, 0.25, 0.35], size=(5, 3)))(s)
    turn = CubicSpline(knots, rng.uniform(-0.4, 0.4, size=(5, 3)))(s)
    return _track(make_pose(rotation_exp(turn) @ np.diag([1.0, -1.0, -1.0]), p), 0.2)


def test_a_track_is_followed_exactly_and_continuously(plant: ArmPlant) -> None:
    for seed in range(4):
        track = _tabletop_track(seed=seed)
        joints = solve_track(plant, track)
        assert joints.ok.all()
        assert joints.position_error_m.max() <= 1e-6
        assert joints.rotation_error_rad.max() <= 1e-6
        assert limit_excess(plant, joints.q).max() == 0.0
        for q, X_BG in zip(joints.q, track.X_BG, strict=True):
            assert max(pose_difference(plant.forward(q), X_BG)) <= 1e-6
        assert speed_ratios(plant, joints.t_s, joints.q).max() < 1.0


def test_the_first_frame_is_solved_near_the_rest_posture(plant: ArmPlant) -> None:
    X_BG = np.array([plant.forward(rest_q() + 0.02 * k) for k in range(5)])
    joints = solve_track(plant, _track(X_BG, 0.2))
    assert np.abs(joints.q[0] - rest_q()).max() < 0.1


def test_frames_that_are_not_tracked_have_no_joint_angles(plant: ArmPlant) -> None:
    track = _tabletop_track(20)
    seen = np.ones(20, dtype=bool)
    seen[[0, 7, 8, 19]] = False
    joints = solve_track(plant, _track(track.X_BG, 0.2, seen))
    np.testing.assert_array_equal(joints.ok, seen)
    assert [s for s, t in zip(joints.status, seen, strict=True) if not t] == [IkStatus.NOT_TRACKED] * 4
    np.testing.assert_array_equal(np.isnan(joints.q).all(axis=-1), ~seen)
    np.testing.assert_array_equal(np.isnan(joints.position_error_m), ~seen)


def test_a_track_without_tracked_frames_has_the_status_not_tracked(plant: ArmPlant) -> None:
    joints = solve_track(plant, _track(np.tile(np.eye(4), (3, 1, 1)), 0.2, np.zeros(3)))
    assert set(joints.status) == {IkStatus.NOT_TRACKED}


def test_an_unreachable_frame_leaves_its_neighbours_solved(plant: ArmPlant) -> None:
    X_BG = _tabletop_track().X_BG.copy()
    X_BG[5] = FAR_POSE
    joints = solve_track(plant, _track(X_BG, 0.2))
    assert joints.status[5] is IkStatus.UNREACHABLE
    assert joints.position_error_m[5] > 0.5
    assert np.delete(joints.ok, 5).all()
    assert speed_ratios(plant, np.delete(joints.t_s, 5), np.delete(joints.q, 5, axis=0)).max() < 1.0


class _MovingObstacle:
    """Self-collision of one posture of each path that is tested as a whole: that of its frame 0, 1, 2 and so on."""

    def __init__(self, frames: int, limit: int) -> None:
        self.frames = frames
        self.limit = limit
        self.paths = 0
        self.colliding: list[Array] = []

    def self_distance(self, q: Array, finger_width_m: Array) -> Clearance:
        if len(q) == self.frames:
            if self.paths < self.limit:
                self.colliding.append(q[self.paths])
            self.paths += 1
        meets = [any(np.array_equal(row, posture) for posture in self.colliding) for row in q]
        return Clearance(distance_m=np.where(meets, -0.01, 1.0), pair=(None,) * len(q))

    def table_distance(self, q: Array, finger_width_m: Array) -> Clearance:
        return Clearance(distance_m=np.ones(len(q)), pair=(None,) * len(q))

    obstacle_distance = table_distance


@pytest.mark.parametrize("paths", [1, 2, 100])
def test_a_frame_is_in_collision_only_if_its_own_posture_collides(plant: ArmPlant, paths: int) -> None:
    track = _tabletop_track(12)
    obstacle = _MovingObstacle(12, paths)
    joints = solve_track(plant, track, cast(CollisionModel, obstacle))
    distance_m = obstacle.self_distance(joints.q[:-1], track.finger_width_m[:-1]).distance_m
    colliding = np.array([status is IkStatus.SELF_COLLISION for status in joints.status])
    np.testing.assert_array_equal(colliding[:-1], distance_m < 0.0)
    assert obstacle.paths > 1  # other postures of the frame are free, so the path is searched again
    assert colliding.any() == (paths == 100)


def _joint_paths(plant: ArmPlant, count: int, seed: int, share: float) -> list[tuple[Array, float]]:
    """Joint paths (49, 7) all over the joint ranges and the frame period [s] at which they use `share` of limits."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        knots = rng.uniform(plant.lower, plant.upper, size=(4, 7))
        q = CubicSpline(np.linspace(0, 1, 4), knots)(np.linspace(0, 1, 49))
        if limit_excess(plant, q).max() == 0.0:
            speed = (np.abs(np.diff(q, axis=0)) / plant.velocity_limits).max()
            acceleration = (np.abs(np.diff(q, 2, axis=0)) / plant.acceleration_limits).max()
            found.append((q, max(speed / share, float(np.sqrt(acceleration / share)))))
    return found


@pytest.mark.slow
def test_a_path_within_limits_is_found_if_one_exists(plant: ArmPlant) -> None:
    """Joint paths at 90 % of the limits, all over the joint space, known by their poses only.

    Some pass singularities, limits and stretched arms, where greedy steps and coarse grids fail.
    """
    for q, period in _joint_paths(plant, 40, seed=7, share=0.9):
        track = _track(np.array([plant.forward(row) for row in q]), period)
        joints = solve_track(plant, track)
        assert joints.ok.all()
        assert speed_ratios(plant, track.t_s, joints.q).max() <= 1.0


def test_a_warm_started_path_is_solved_within_speed_limits(plant: ArmPlant) -> None:
    for q, period in _joint_paths(plant, 5, seed=3, share=0.3):
        X_BG = np.array([plant.forward(row) for row in q])
        t_s = period * np.arange(len(q))
        path = continue_path(plant, t_s, X_BG, q[0])
        if not is_sound(plant, t_s, path):
            path = search_path(plant, t_s, X_BG, q[0])
        joints = verify_path(plant, t_s, X_BG, path)
        assert joints.ok.all()
        assert speed_ratios(plant, joints.t_s, joints.q).max() <= 1.0


def test_a_continued_path_is_sound_or_nan(plant: ArmPlant) -> None:
    for q, period in _joint_paths(plant, 10, seed=11, share=0.9):
        X_BG = plant.forward_path(q)
        t_s = period * np.arange(len(q))
        for step_s in (1.0, 0.05):  # at the second no joint is fast enough
            path = continue_path(plant, step_s * t_s, X_BG, q[0])
            assert is_sound(plant, step_s * t_s, path) or np.isnan(path).all()
        X_BG[20, :3, 3] += 2.0  # out of reach
        assert np.isnan(continue_path(plant, t_s, X_BG, q[0])).all()


def test_redundancy_avoids_collision_with_the_table(plant: ArmPlant) -> None:
    """A table so high that the nearest posture's elbow lies in it: another posture of the same poses clears it."""
    q = np.array([-0.51, 1.66, -1.44, -1.85, 0.96, 2.64, 1.09]) + np.linspace(0.0, 0.1, 9)[:, None]
    X_BG = np.array([plant.forward(row) for row in q])
    track = _track(X_BG, 0.2)
    plain = solve_track(plant, track)
    low = CollisionModel(plant).table_distance(plain.q).distance_m.min()
    highest = max(
        CollisionModel(plant).table_distance(layer).distance_m.max() for layer in posture_solver(plant).all(X_BG, 64)
    )
    assert highest > low + 0.02
    model = CollisionModel(plant, table_height_m=low + 0.01)
    joints = solve_track(plant, track, model)
    assert joints.ok.all()
    assert model.table_distance(joints.q).distance_m.min() >= -0.002


def test_frames_with_the_gripper_in_the_table_have_the_status_table_collision(plant: ArmPlant) -> None:
    track = _tabletop_track()
    X_BG = track.X_BG.copy()
    X_BG[10:13, 2, 3] = -0.03
    joints = solve_track(plant, _track(X_BG, 0.2), CollisionModel(plant))
    wrong = [i for i, s in enumerate(joints.status) if s is IkStatus.TABLE_COLLISION]
    assert wrong == [10, 11, 12]
    assert np.isfinite(joints.q).all()


def test_times_that_do_not_increase_are_refused(plant: ArmPlant) -> None:
    with pytest.raises(InputError, match="increase"):
        solve_track(plant, _track(_tabletop_track(3).X_BG, 0.0))


def test_the_same_track_gives_the_same_bytes(plant: ArmPlant) -> None:
    track = _tabletop_track(15)
    assert solve_track(plant, track).q.tobytes() == solve_track(ArmPlant(), track).q.tobytes()
