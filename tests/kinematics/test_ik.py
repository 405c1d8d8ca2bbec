import numpy as np
import pytest

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, pose_difference
from kinebench_drake.kinematics.ik import find_least_excess, solve_pose
from kinebench_drake.kinematics.newton import solve_newton
from kinebench_drake.kinematics.path import limit_excess
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver
from kinebench_drake.models.arm import load_robot
from kinebench_drake.models.panda.description import rest_q
from kinebench_drake.track import IkStatus

FAR_POSE = make_pose(np.eye(3), [2.0, 0.0, 0.0])


PAST_LIMIT = {
    "panda_joint2": [-0.4, 2.1, -0.4, -0.6, -2.8, 2.7, -0.6],
    "panda_joint4": [-0.6, 0.7, -0.3, -3.4, 2.5, 3.2, -2.2],
    "panda_joint7": [2.7, 0.3, -1.0, -0.5, -0.1, 3.1, 3.2],
}
"""Postures with one joint past its limit whose poses no posture within limits reaches (a dense sweep says so)."""


def test_forward_kinematics_of_ik_is_the_pose_within_joint_limits(plant: ArmPlant) -> None:
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


def test_slightly_scaled_rotations_are_made_orthonormal(plant: ArmPlant) -> None:
    X_BG = plant.forward(rest_q())
    X_BG[:3, :3] *= 0.9997
    assert solve_pose(plant, X_BG, rest_q()).status is IkStatus.OK


def test_a_distant_pose_is_unreachable_and_approached_within_limits(plant: ArmPlant) -> None:
    solution = solve_pose(plant, FAR_POSE, rest_q())
    assert solution.status is IkStatus.UNREACHABLE
    assert limit_excess(plant, solution.q).max() == 0.0
    assert 0.8 < solution.position_error_m < 1.3  # the arm is 0.855 m long from its shoulder, and the hand
    start = float(pose_difference(plant.forward(rest_q()), FAR_POSE)[0])
    assert solution.position_error_m < start


@pytest.mark.parametrize("name", PAST_LIMIT)
def test_a_pose_reached_only_past_a_limit_has_the_status_joint_limit(plant: ArmPlant, name: str) -> None:
    X_BG = plant.forward(PAST_LIMIT[name])
    dense = posture_solver(plant).all(X_BG[None], 5000)[0]
    assert limit_excess(plant, dense).max(axis=-1).min() > 0.1
    solution = solve_pose(plant, X_BG, rest_q())
    assert solution.status is IkStatus.JOINT_LIMIT
    assert limit_excess(plant, solution.q).max() == 0.0
    assert solution.position_error_m > 1e-4
    posture = find_least_excess(plant, X_BG)
    assert posture is not None
    assert max(pose_difference(plant.forward(posture), X_BG)) < 1e-9
    assert limit_excess(plant, posture).max() <= limit_excess(plant, np.array(PAST_LIMIT[name])).max()


def test_ik_finds_solutions_between_the_samples_of_the_sweep(plant: ArmPlant) -> None:
    X_BG = plant.forward([0.6, -2.1, -0.8, -0.5, -0.2, 1.3, -0.9])
    assert limit_excess(plant, posture_solver(plant).all(X_BG[None], 128)[0]).max(axis=-1).min() > 0.02
    assert solve_pose(plant, X_BG, rest_q()).status is IkStatus.OK


@pytest.mark.parametrize("joint", range(7))
def test_a_pose_of_a_joint_exactly_at_its_limit_is_solved(plant: ArmPlant, joint: int) -> None:
    q = np.array([0.3, 0.4, 0.2, -1.9, 0.2, 2.2, 0.6])
    q[joint] = plant.upper[joint]
    assert solve_pose(plant, plant.forward(q), rest_q()).status is IkStatus.OK


def test_newton_exceeds_joint_limits_only_if_unbounded(plant: ArmPlant) -> None:
    q = np.array(PAST_LIMIT["panda_joint2"])
    X_BG = plant.forward(q)
    start = np.clip(q, plant.lower, plant.upper)
    free, free_error = solve_newton(plant, X_BG, start, bounded=False, iterations=100)
    held, held_error = solve_newton(plant, X_BG, start, iterations=100)
    assert free_error < 1e-9
    assert limit_excess(plant, free).max() > 0.1
    assert held_error > 1e-3
    assert limit_excess(plant, held).max() == 0.0


@pytest.mark.parametrize("bad", [np.full((4, 4), np.nan), np.eye(3)])
def test_an_invalid_pose_is_refused(plant: ArmPlant, bad: Array) -> None:
    with pytest.raises(InputError, match="X_BG"):
        solve_pose(plant, bad, rest_q())


@pytest.mark.parametrize("name", ["so100", "xarm7"])
def test_poses_beyond_the_reach_of_other_arms_are_refused_by_a_bound(name: str) -> None:
    arm = ArmPlant(load_robot(name))
    solver = posture_solver(arm)
    q = np.random.default_rng(0).uniform(arm.lower, arm.upper, size=(2000, len(arm.lower)))
    X = arm.forward_path(q)
    assert not solver.out_of_reach_m(X).any()
    far = X[0] @ make_pose(np.eye(3), [2.0, 0.0, 0.0])
    assert solver.out_of_reach_m(far[None])[0] > 0.5
    assert [len(postures) for postures in solver.all(np.stack([X[0], far]), 8)][1] == 0
    assert solve_pose(arm, far, arm.robot.rest_q).status is IkStatus.UNREACHABLE
