import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.kinematics.plant import ArmPlant


@pytest.fixture(scope="module")
def postures(plant: ArmPlant) -> np.ndarray:
    return np.random.default_rng(0).uniform(plant.lower, plant.upper, size=(12, 7))


def test_poses_of_every_link_equal_drakes(plant: ArmPlant, postures: np.ndarray) -> None:
    chain = plant.chain
    expected = [plant.link_poses(q) for q in postures]
    for link in plant.robot.links:
        np.testing.assert_allclose(chain.poses(postures, link), [poses[link] for poses in expected], atol=1e-13)


def test_jacobians_equal_drakes(plant: ArmPlant, postures: np.ndarray) -> None:
    expected = [plant.jacobian(q) for q in postures]
    np.testing.assert_allclose(plant.chain.jacobians(postures), expected, atol=1e-13)
    assert plant.chain.jacobians(postures[:0]).shape == (0, 6, 7)


def test_torques_equal_drakes(plant: ArmPlant, postures: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    v = rng.normal(0.0, 2.0, postures.shape)
    a = rng.normal(0.0, 8.0, postures.shape)
    expected = [plant.torque(*row) for row in zip(postures, v, a, strict=True)]
    np.testing.assert_allclose(plant.chain.torques(postures, v, a), expected, atol=1e-11)
    at_rest = np.zeros_like(v)
    mass = [plant.mass_matrix(q)[:, 2] for q in postures]
    third = plant.chain.torques(postures, at_rest, at_rest + np.eye(7)[2])
    np.testing.assert_allclose(third - plant.chain.torques(postures, at_rest, at_rest), mass, atol=1e-11)
    assert plant.chain.torques(*np.zeros((3, 0, 7))).shape == (0, 7)


@pytest.mark.parametrize("width", [0.0, 0.03, 0.08])
def test_motions_of_one_posture_equal_drakes(plant: ArmPlant, postures: np.ndarray, width: float) -> None:
    chain = plant.chain
    plant.set_posture(postures[0], width)
    np.testing.assert_allclose(chain.motions(postures[:1], [width])[0], chain.current(plant.context), atol=1e-13)


def test_finger_distance_is_the_width_clipped_to_the_stroke(plant: ArmPlant, postures: np.ndarray) -> None:
    chain = plant.chain
    q = np.tile(postures[:1], (5, 1))
    widths = [0.0, 0.05, 0.3, -0.01, np.nan]
    M = chain.motions(q, widths)
    left, right = ((M[:, chain.stage[link]] @ chain.home[link])[:, :3, 3] for link in plant.robot.links[-2:])
    expected = [0.0, 0.05, 0.08, 0.0, plant.finger_width_m]
    np.testing.assert_allclose(np.linalg.norm(left - right, axis=-1), expected, atol=1e-12)


def test_a_link_is_moved_by_the_joints_before_it_alone(plant: ArmPlant) -> None:
    chain = plant.chain
    for i in range(8):
        np.testing.assert_array_equal(chain.carries(f"panda_link{i}"), np.arange(7) < i)
    assert chain.carries("panda_leftfinger").all()


def test_joint_angles_of_wrong_shape_are_refused(plant: ArmPlant) -> None:
    with pytest.raises(UsageError, match="expected"):
        plant.chain.motions(np.zeros(7))
