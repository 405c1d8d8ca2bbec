import numpy as np

from kinebench_drake.geometry import make_pose, pose_difference
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.kinematics.plant import ArmPlant


def test_every_branch_reaches_the_pose_and_one_is_the_posture_it_came_from(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    branches_seen = set()
    for q in rng.uniform(plant.lower, plant.upper, size=(100, 7)):
        X_BG = plant.forward(q)
        solutions = analytic_ik(X_BG, q[6])[0]
        found = np.isfinite(solutions).all(axis=-1)
        branches_seen |= set(np.flatnonzero(found))
        for solution in solutions[found]:
            assert max(pose_difference(plant.forward(solution), X_BG)) < 1e-9
            assert solution[6] == q[6]
        assert np.nanmin(np.abs(solutions - q).max(axis=-1)) < 1e-6
    assert branches_seen == set(range(8))


def test_branches_differ_from_each_other(plant: ArmPlant) -> None:
    q = np.array([0.3, -0.4, 0.5, -1.9, 0.2, 1.8, -0.6])
    solutions = analytic_ik(plant.forward(q), q[6])[0]
    solutions = solutions[np.isfinite(solutions[:, 0])]
    assert len(solutions) >= 4
    distance = np.abs(solutions[:, None] - solutions[None]).max(axis=-1) + 10 * np.eye(len(solutions))
    assert distance.min() > 0.1


def test_a_pose_out_of_reach_has_no_solution() -> None:
    assert np.isnan(analytic_ik(make_pose(np.eye(3), [2.0, 0.0, 0.0]), np.linspace(-3, 3, 50))).all()
