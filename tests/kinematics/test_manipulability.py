import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.kinematics.manipulability import (
    compute_manipulability,
    cost,
    time_integral,
)
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import rest_q


def test_w_is_the_product_of_the_singular_values(plant: ArmPlant) -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(plant.lower, plant.upper, size=(20, 7))
    result = compute_manipulability(plant, q)
    J = np.array([plant.jacobian(row) for row in q])
    np.testing.assert_allclose(result.full, np.prod(np.linalg.svd(J, compute_uv=False), axis=-1), rtol=1e-6, atol=1e-9)
    linear = np.prod(np.linalg.svd(J[:, 3:], compute_uv=False), axis=-1)
    np.testing.assert_allclose(result.translation, linear, rtol=1e-6, atol=1e-9)
    assert (result.full > 0).any()


def test_w_is_the_root_of_the_gram_determinant(plant: ArmPlant) -> None:
    q = np.random.default_rng(4).uniform(plant.lower, plant.upper, size=(20, 7))
    J = plant.chain.jacobians(q)
    result = compute_manipulability(plant, q)
    for w, rows in ((result.full, J), (result.translation, J[:, 3:])):
        np.testing.assert_allclose(w**2, np.linalg.det(rows @ np.swapaxes(rows, -1, -2)), rtol=1e-7)


def test_w_scales_with_the_cube_of_the_length_unit(plant: ArmPlant) -> None:
    q = rest_q()[None]
    J = plant.chain.jacobians(q)
    metres, millimetres = (compute_manipulability(plant, q, J * np.repeat([1.0, k], 3)[:, None]) for k in (1.0, 1e3))
    assert millimetres.full == pytest.approx(1e9 * metres.full)
    assert millimetres.translation == pytest.approx(1e9 * metres.translation)


def test_precomputed_jacobians_give_the_same_manipulability(plant: ArmPlant) -> None:
    q = np.random.default_rng(6).uniform(plant.lower, plant.upper, size=(5, 7))
    given = compute_manipulability(plant, q, [plant.jacobian(row) for row in q])
    computed = compute_manipulability(plant, q)
    for name in ("full", "translation", "cost"):
        np.testing.assert_allclose(getattr(given, name), getattr(computed, name), rtol=1e-6)
    with pytest.raises(UsageError, match="expected"):
        compute_manipulability(plant, q, np.zeros((4, 6, 7)))


def test_time_integral_interpolates_across_gaps() -> None:
    t_s = np.array([0.0, 0.1, 0.4, 1.0])
    assert time_integral(t_s, 2 * t_s) == pytest.approx(1.0)
    assert time_integral(t_s, np.array([0.0, np.nan, 0.8, 2.0])) == pytest.approx(1.0)
    assert time_integral(t_s, np.array([np.nan, np.nan, 1.0, np.nan])) is None


def test_w_vanishes_where_the_arm_is_stretched_in_its_plane(plant: ArmPlant) -> None:
    """Only joints 2, 4, 6 move the arm in its plane (q3 = q5 = 0); with their axes in line they lose a direction."""
    in_line = np.pi - (np.arctan2(0.384, -0.0825) - np.arctan2(-0.316, -0.0825))
    assert plant.lower[3] < in_line < plant.upper[3]
    singular = np.array([0.3, 0.5, 0.0, in_line, 0.0, 1.7, 0.4])
    bent = np.array([0.3, 0.5, 0.0, in_line - 1.0, 0.0, 1.7, 0.4])
    w_singular, w_bent = compute_manipulability(plant, np.array([singular, bent])).full
    assert w_singular < 1e-6
    assert w_bent > 0.02


def test_manipulability_does_not_depend_on_joint_1(plant: ArmPlant) -> None:
    turned = np.tile(rest_q(), (3, 1))
    turned[:, 0] = [-1.0, 0.0, 2.0]
    result = compute_manipulability(plant, turned)
    for values in (result.full, result.translation, result.cost):
        np.testing.assert_allclose(values, values[0], rtol=1e-9)


def test_manipulability_cost_is_its_bounded_inverse() -> None:
    np.testing.assert_allclose(cost(np.array([0.0, 1.0])), [1e6, 1.0 / 1.000001])


def test_manipulability_of_unknown_frames_is_unknown(plant: ArmPlant) -> None:
    q = np.tile(rest_q(), (3, 1))
    q[1, 4] = np.nan
    result = compute_manipulability(plant, q)
    for values in (result.full, result.translation, result.cost):
        np.testing.assert_array_equal(np.isnan(values), [False, True, False])
    assert len(compute_manipulability(plant, np.empty((0, 7))).full) == 0


def test_joint_angles_of_wrong_shape_are_refused(plant: ArmPlant) -> None:
    with pytest.raises(UsageError, match="expected"):
        compute_manipulability(plant, rest_q())
