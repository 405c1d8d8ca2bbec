import numpy as np
import pytest

from kinebench_drake.kinematics.collision import CollisionModel
from kinebench_drake.kinematics.joint_trajectory import JointTrajectory, TubeProblem
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.spline import SplineBasis
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.violation import ViolationKind

T_S = np.linspace(0.0, 3.0, 25)


def _problem(plant: ArmPlant, widths: np.ndarray | None = None) -> TubeProblem:
    q = rest_q() + np.sin(2.0 * T_S)[:, None] * np.array([0.5, 0.3, 0.2, 0.2, -0.4, 0.3, 0.8])
    return TubeProblem(
        plant=plant,
        collision=CollisionModel(plant),
        frames=np.arange(10, 35),
        t_s=T_S,
        origin_s=2.0,
        X_BG=np.array([plant.forward(row) for row in q]),
        q=q,
        finger_width_m=widths,
        table_tolerance_m=0.002,
    )


@pytest.fixture
def problem(plant: ArmPlant) -> TubeProblem:
    return _problem(plant)


def _through(problem: TubeProblem) -> JointTrajectory:
    basis = SplineBasis.through(problem.t_s)
    return JointTrajectory(problem, basis, basis.fit(problem.t_s, problem.q))


def test_linearised_pose_errors_are_exact_to_first_order(problem: TubeProblem) -> None:
    rng = np.random.default_rng(0)
    q = problem.q + rng.normal(0.0, 0.02, problem.q.shape)
    dq = rng.normal(0.0, 1e-5, q.shape)
    poses = problem.linearise(q)
    predicted = poses.e - np.einsum("tij,tj->ti", poses.J, dq)
    # Exact to first order where nothing is left over, else but for the curvature of rotations.
    np.testing.assert_allclose(problem.errors(q + dq), predicted, atol=5e-7)
    near = problem.linearise(problem.q)
    np.testing.assert_allclose(problem.errors(problem.q + dq), -np.einsum("tij,tj->ti", near.J, dq), atol=2e-9)
    np.testing.assert_allclose(problem.errors(problem.q), 0.0, atol=1e-12)


def test_least_distances_are_the_minimum_over_all_samples(problem: TubeProblem) -> None:
    trajectory = _through(problem)
    assert problem.collision is not None
    q = trajectory.motion[0]
    distances = {
        ViolationKind.SELF_COLLISION: problem.collision.self_distance(q).distance_m,
        ViolationKind.TABLE_COLLISION: problem.collision.table_distance(q).distance_m,
    }
    assert trajectory.least_distances.keys() == distances.keys()
    for kind, (least, sample) in trajectory.least_distances.items():
        assert least == pytest.approx(distances[kind].min())
        assert distances[kind][sample] == pytest.approx(least)


def test_obstacles_predict_the_distances_of_a_moved_trajectory(problem: TubeProblem) -> None:
    trajectory = _through(problem)
    lowering = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    lowered = trajectory
    while min(lowered.least_distances.values())[0] > 0.005:
        lowered = JointTrajectory(problem, lowered.basis, lowered.control + lowering)
    shift = 1e-4 * np.random.default_rng(1).normal(size=7)
    moved = JointTrajectory(problem, lowered.basis, lowered.control + shift)
    obstacles = lowered.obstacles()
    assert obstacles
    assert min(moved.least_distances, key=moved.least_distances.__getitem__) is ViolationKind.TABLE_COLLISION
    nearest = min(
        obstacles,
        key=lambda o: o.offset_m + o.gradient @ moved.basis.evaluate(moved.control, np.array([o.t_s]))[0] - o.least_m,
    )
    q = moved.basis.evaluate(moved.control, np.array([nearest.t_s]))[0]
    assert problem.collision is not None
    actual = problem.collision.near_pairs(q, 0.02)[0].distance_m
    assert nearest.offset_m + nearest.gradient @ q == pytest.approx(actual, abs=1e-7)


def test_limit_usage_bounds_the_motion_from_above(problem: TubeProblem) -> None:
    trajectory = _through(problem)
    speed, acceleration, _ = trajectory.usage
    assert speed is not None
    assert acceleration is not None
    assert problem.plant.acceleration_limits is not None
    _, v, a = trajectory.motion
    assert np.abs(v / problem.plant.velocity_limits).max() <= speed.max()
    assert np.abs(a / problem.plant.acceleration_limits).max() == pytest.approx(acceleration.max(), rel=1e-9)
    assert speed.max() <= 1.05 * np.abs(v / problem.plant.velocity_limits).max()
    assert trajectory.keeps_limits
    fast = JointTrajectory(problem, trajectory.basis, 10.0 * (trajectory.control - rest_q()) + rest_q())
    assert not fast.keeps_limits


def test_the_nearest_frame_has_its_number_in_the_track(problem: TubeProblem) -> None:
    assert problem.nearest_frame(0.0) == 10
    assert problem.nearest_frame(3.0) == 34
    assert problem.nearest_frame(0.13) == 11


def test_finger_widths_are_interpolated_and_none_if_all_are_unknown(plant: ArmPlant) -> None:
    widths = np.linspace(0.0, 0.08, 25)
    widths[3:6] = np.nan
    np.testing.assert_allclose(_problem(plant, widths).widths(np.array([0.0, 0.5, 3.0])), [0.0, 0.08 / 6, 0.08])
    assert _problem(plant, np.full(25, np.nan)).widths(T_S) is None
    assert _problem(plant).widths(T_S) is None
    closed, wide = (_through(_problem(plant, np.full(25, w))).least_distances for w in (0.0, 0.08))
    assert closed != wide
