import numpy as np

from kinebench_drake.geometry import pose_difference
from kinebench_drake.kinematics.path import limit_excess, peak_ratio, relax, speed_ratios
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.postures import posture_solver
from kinebench_drake.models.panda.description import rest_q
from tests.kinematics.motions import poses_of, random_path


def test_relaxing_keeps_the_poses_and_lowers_joint_speeds(plant: ArmPlant) -> None:
    """A path that wags along the redundancy, straightened."""
    q = random_path(30)
    X_BG = poses_of(plant, q)
    t_s = 0.1 * np.arange(30)
    wagging = q.copy()
    wagging[:, 6] += 0.15 * (-1.0) ** np.arange(30)
    wagging = posture_solver(plant).nearest(X_BG, wagging)
    straight = relax(plant, t_s, X_BG, wagging)
    assert max(d.max() for d in pose_difference(poses_of(plant, straight), X_BG)) < 1e-9
    before, after = (np.sum(speed_ratios(plant, t_s, path) ** 2) for path in (wagging, straight))
    assert after < 0.1 * before
    assert after <= 1.01 * np.sum(speed_ratios(plant, t_s, q) ** 2)


def test_relaxing_brings_a_path_back_within_joint_limits(plant: ArmPlant) -> None:
    q = random_path(20, seed=1)
    q[:, 6] += plant.upper[6] - 0.02 - q[:, 6].max()
    X_BG = poses_of(plant, q)
    t_s = 0.2 * np.arange(20)
    past = posture_solver(plant).nearest(X_BG, q + 0.06 * np.eye(7)[6])
    assert limit_excess(plant, past).max() > 0.01
    assert limit_excess(plant, relax(plant, t_s, X_BG, past)).max() == 0.0


def test_the_peak_ratio_is_the_largest_speed_or_acceleration_over_its_limit(plant: ArmPlant) -> None:
    q = np.tile(rest_q(), (5, 1))
    q[:, 2] += 0.5 * 0.3 * plant.velocity_limits[2] * np.arange(5)
    assert abs(peak_ratio(plant, 0.3 * np.arange(5), q) - 0.5) < 1e-12
    q = np.tile(rest_q(), (5, 1))
    q[2:, 4] += 0.7 * 0.1**2 * plant.acceleration_limits[4]
    assert abs(peak_ratio(plant, 0.1 * np.arange(5), q) - 0.7) < 1e-9
    assert peak_ratio(plant, np.zeros(1), q[:1]) == 0.0
