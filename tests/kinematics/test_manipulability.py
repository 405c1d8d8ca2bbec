import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.kinematics.manipulability import cost, manipulability, yoshikawa
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.robot import rest_q


def test_w_is_the_product_of_the_singular_values(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(plant.lower, plant.upper, size=(20, 7))
    result = manipulability(plant, q)
    J = np.array([plant.jacobian(row) for row in q])
    np.testing.assert_allclose(result.full, np.prod(np.linalg.svd(J, compute_uv=False), axis=-1), rtol=1e-6, atol=1e-9)
    linear = np.prod(np.linalg.svd(J[:, 3:], compute_uv=False), axis=-1)
    np.testing.assert_allclose(result.translation, linear, rtol=1e-6, atol=1e-9)
    assert (result.full > 0).any()


def test_w_of_two_links_in_a_plane_is_the_textbook_one() -> None:
    """Yoshikawa's example: w = l1 l2 |sin(theta2)|."""
    l1, l2 = 0.4, 0.3
    for a, b in [(0.3, 0.5), (1.0, -2.0), (0.2, 0.0)]:
        J = [
            [-l1 * np.sin(a) - l2 * np.sin(a + b), -l2 * np.sin(a + b)],
            [l1 * np.cos(a) + l2 * np.cos(a + b), l2 * np.cos(a + b)],
        ]
        assert yoshikawa(J) == pytest.approx(l1 * l2 * abs(np.sin(b)), abs=1e-8)


def test_w_vanishes_where_the_arm_is_stretched_in_its_plane(plant: ArmPlant) -> None:
    """Only joints 2, 4, 6 move the arm in its plane (q3 = q5 = 0); with their axes in line they lose a direction."""
    in_line = np.pi - (np.arctan2(0.384, -0.0825) - np.arctan2(-0.316, -0.0825))
    assert plant.lower[3] < in_line < plant.upper[3]
    singular = np.array([0.3, 0.5, 0.0, in_line, 0.0, 1.7, 0.4])
    bent = np.array([0.3, 0.5, 0.0, in_line - 1.0, 0.0, 1.7, 0.4])
    w_singular, w_bent = manipulability(plant, np.array([singular, bent])).full
    assert w_singular < 1e-6
    assert w_bent > 0.02


def test_turning_the_base_changes_nothing(plant: ArmPlant) -> None:
    turned = np.tile(rest_q(), (3, 1))
    turned[:, 0] = [-1.0, 0.0, 2.0]
    result = manipulability(plant, turned)
    for values in (result.full, result.translation, result.cost):
        np.testing.assert_allclose(values, values[0], rtol=1e-9)


def test_cost_is_the_inverse_and_bounded() -> None:
    np.testing.assert_allclose(cost([0.0, 1.0]), [1e6, 1.0 / 1.000001])


def test_unknown_frames_stay_unknown(plant: ArmPlant) -> None:
    q = np.tile(rest_q(), (3, 1))
    q[1, 4] = np.nan
    result = manipulability(plant, q)
    for values in (result.full, result.translation, result.cost):
        np.testing.assert_array_equal(np.isnan(values), [False, True, False])
    assert len(manipulability(plant, np.empty((0, 7))).full) == 0


def test_wrong_shape_is_refused(plant: ArmPlant) -> None:
    with pytest.raises(UsageError, match="expected"):
        manipulability(plant, rest_q())
