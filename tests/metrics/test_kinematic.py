import numpy as np

from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.kinematic_result import limit_margin


def test_limit_margin_is_one_in_the_middle_and_zero_at_limits(plant: ArmPlant) -> None:
    q = np.array([0.5 * (plant.lower + plant.upper), plant.lower, plant.upper, 2 * plant.upper - plant.lower])
    np.testing.assert_allclose(limit_margin(plant, q), np.tile([[1.0], [0.0], [0.0], [-2.0]], 7), atol=1e-12)
