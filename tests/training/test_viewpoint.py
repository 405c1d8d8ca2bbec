"""Random training cameras."""

import numpy as np
import pytest

from kinebench_drake.geometry import invert, transform_points
from training.viewpoint import ViewBounds, random_camera

CENTRE_B = np.array([0.5, 0.1, 0.3])
LINKS_B = np.array([[0.0, 0.0, 0.3], [0.3, 0.0, 0.6]])
BOUNDS = ViewBounds((-2.0, -2.0, 0.03), (2.5, 2.5, 2.5))


@pytest.mark.parametrize("seed", range(40))
def test_a_random_camera_sees_the_gripper_and_is_clear_of_the_links(seed: int) -> None:
    camera = random_camera(np.random.default_rng(seed), CENTRE_B, LINKS_B, BOUNDS, (384, 384))
    (target,) = transform_points(invert(camera.X_BC), CENTRE_B[None])
    pixel = camera.project(target)
    assert target[2] > 0
    assert (np.abs(pixel - 192) <= 0.55 * 384 + 1e-6).all()
    assert 0.4 <= np.linalg.norm(target) <= 2.5
    fov = np.rad2deg(2 * np.arctan(192 / camera.fx))
    assert 20 - 1e-6 <= fov <= 100 + 1e-6
    assert BOUNDS.contains(camera.X_BC[:3, 3])
    assert np.linalg.norm(LINKS_B - camera.X_BC[:3, 3], axis=1).min() > 0.2
    np.testing.assert_allclose(camera.X_BC[:3, :3] @ camera.X_BC[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(camera.X_BC[:3, :3]) > 0


def test_cameras_come_from_all_sides_and_most_stand_upright() -> None:
    rng = np.random.default_rng(0)
    cameras = [random_camera(rng, CENTRE_B, LINKS_B, BOUNDS, (384, 384)) for _ in range(300)]
    offset = np.array([c.X_BC[:3, 3] - CENTRE_B for c in cameras])
    azimuth = np.rad2deg(np.arctan2(offset[:, 1], offset[:, 0]))
    assert (np.histogram(azimuth, bins=8, range=(-180, 180))[0] > 5).all()
    down_C = np.array([c.X_BC[:3, :3].T @ [0.0, 0.0, -1.0] for c in cameras])
    assert (down_C[:, 1] > 0).mean() > 0.95


def test_bounds_without_a_free_camera_position_are_refused() -> None:
    with pytest.raises(RuntimeError, match="no free camera position"):
        random_camera(np.random.default_rng(0), CENTRE_B, LINKS_B, ViewBounds((5, 5, 5), (6, 6, 6)), (384, 384))
