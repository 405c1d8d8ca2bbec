import numpy as np

from kinebench_drake.geometry import make_pose, pose_difference
from kinebench_drake.kinematics.analytic import analytic_ik, branch_of, flange_pose, reach_window
from kinebench_drake.kinematics.plant import ArmPlant


def test_every_branch_reaches_the_pose_and_one_is_the_original_posture(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    branches_seen = set()
    for q in rng.uniform(plant.lower, plant.upper, size=(100, 7)):
        X_BF = flange_pose(q)
        solutions = analytic_ik(X_BF, q[6])
        found = np.isfinite(solutions).all(axis=-1)
        branches_seen |= set(np.flatnonzero(found))
        for solution in solutions[found]:
            assert max(pose_difference(flange_pose(solution), X_BF)) < 1e-9
            assert solution[6] == q[6]
        assert np.nanmin(np.abs(solutions - q).max(axis=-1)) < 1e-6
    assert branches_seen == set(range(8))


def test_the_branch_of_a_posture_is_its_row_of_all_branches(plant: ArmPlant) -> None:
    rng = np.random.default_rng(3)
    branches = set()
    for q in rng.uniform(plant.lower, plant.upper, size=(200, 7)):
        branch = branch_of(q)
        branches.add(branch)
        np.testing.assert_allclose(analytic_ik(flange_pose(q), q[6])[branch], q, atol=1e-6)
    assert branches == set(range(8))


def test_the_flange_pose_equals_drakes(plant: ArmPlant) -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(plant.lower, plant.upper, size=(50, 7))
    X_BF = np.array([plant.link_poses(row)["panda_link8"] for row in q])
    np.testing.assert_allclose(flange_pose(q), X_BF, atol=1e-12)


def test_a_batch_of_poses_and_angles_equals_single_solutions(plant: ArmPlant) -> None:
    rng = np.random.default_rng(2)
    X_BF = flange_pose(rng.uniform(plant.lower, plant.upper, size=(5, 7)))
    q7 = np.linspace(-2.5, 2.5, 4)
    together = analytic_ik(X_BF[:, None], q7)
    assert together.shape == (5, 4, 8, 7)
    for i, X in enumerate(X_BF):
        for k, angle in enumerate(q7):
            np.testing.assert_allclose(together[i, k], analytic_ik(X, angle), atol=1e-12)


def test_solutions_exist_only_within_the_reach_window_of_joint_7(plant: ArmPlant) -> None:
    """An arm all but stretched: joint 7 reaches the pose in a window a few degrees wide, and only there."""
    q = np.array([-2.094, 0.3465, -2.358, -0.4744, 0.0167, 2.7625, 2.0332])
    centre, half_width, beyond = reach_window(flange_pose(q))
    assert beyond == 0.0
    assert 0.0 < half_width < 0.2
    assert abs(centre - q[6]) < half_width
    for share, reached in ((-1.01, False), (-0.99, True), (0.0, True), (0.99, True), (1.01, False)):
        found = analytic_ik(flange_pose(q), centre + share * half_width)
        assert np.isfinite(found).any() == reached


def test_the_reach_window_states_by_how_much_a_pose_is_out_of_reach() -> None:
    X_BF = make_pose(np.diag([1.0, -1.0, -1.0]), [2.0, 0.0, 0.333])  # the flange points down, 0.107 m under the wrist
    _, half_width, beyond = reach_window(X_BF)
    assert half_width == 0.0
    stretched = np.hypot(0.316, 0.0825) + np.hypot(0.384, 0.0825)
    np.testing.assert_allclose(beyond, np.hypot(2.0 - 0.088, 0.107) - stretched, atol=1e-12)


def test_branches_differ_from_each_other() -> None:
    q = np.array([0.3, -0.4, 0.5, -1.9, 0.2, 1.8, -0.6])
    solutions = analytic_ik(flange_pose(q), q[6])
    solutions = solutions[np.isfinite(solutions[:, 0])]
    assert len(solutions) >= 4
    distance = np.abs(solutions[:, None] - solutions[None]).max(axis=-1) + 10 * np.eye(len(solutions))
    assert distance.min() > 0.1


def test_a_pose_out_of_reach_has_no_solution() -> None:
    assert np.isnan(analytic_ik(make_pose(np.eye(3), [2.0, 0.0, 0.0]), np.linspace(-3, 3, 50))).all()
