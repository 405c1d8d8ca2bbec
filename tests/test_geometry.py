import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinebench_drake import geometry as g


def random_poses(seed: int, n: int = 20) -> g.Array:
    rng = np.random.default_rng(seed)
    return g.make_pose(g.rotation_exp(rng.normal(0, 1.5, (n, 3))), rng.normal(0, 1, (n, 3)))


def test_cross_products_equal_those_of_numpy() -> None:
    a, b = np.random.default_rng(5).normal(size=(2, 4, 1, 3))
    np.testing.assert_allclose(g.cross(a, b[:, 0]), np.cross(a, b[:, 0]), atol=1e-15)


def test_transform_points_equals_the_homogeneous_product() -> None:
    X = random_poses(1, 3)
    points = np.random.default_rng(2).normal(size=(3, 5, 3))
    homogeneous = np.concatenate([points, np.ones((3, 5, 1))], axis=2)
    np.testing.assert_allclose(g.transform_points(X, points), (homogeneous @ X.transpose(0, 2, 1))[..., :3], atol=1e-12)


@given(st.floats(1e-9, np.pi - 1e-9), st.integers(0, 1000))
def test_rotation_angle_is_the_norm_of_the_rotation_vector(angle: float, seed: int) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    R = g.rotation_exp(angle * axis / np.linalg.norm(axis))
    assert g.rotation_angle(R) == pytest.approx(angle, rel=1e-6, abs=1e-12)


def test_pose_difference_is_distance_and_angle() -> None:
    X = random_poses(4, 1)[0]
    step = g.make_pose(g.rotation_exp([0, 0, 0.3]), [0.03, 0.0, 0.04])
    distance, angle = g.pose_difference(X, X @ step)
    assert distance == pytest.approx(0.05)
    assert angle == pytest.approx(0.3)


def test_orthonormalize_gives_the_nearest_rotation() -> None:
    X = random_poses(5)
    noisy = X[:, :3, :3] + np.random.default_rng(6).normal(0, 1e-3, (20, 3, 3))
    R = g.orthonormalize(noisy)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    assert np.abs(R - X[:, :3, :3]).max() < 5e-3
    assert np.linalg.det(g.orthonormalize(np.diag([1.0, 1.0, -0.5]))) == pytest.approx(1.0)


def test_quaternions_are_wxyz() -> None:
    np.testing.assert_allclose(g.to_quaternion(np.eye(3)), [1, 0, 0, 0], atol=1e-15)
