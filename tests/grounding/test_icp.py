import numpy as np
import pytest

from kinebench_drake.geometry import invert, make_pose, pose_difference, rotation_exp
from kinebench_drake.grounding.registration.icp import IcpRefiner, gripper_cloud
from kinebench_drake.models.panda.cad import GripperCad
from tests.grounding.conftest import hand_pose, perfect_view


@pytest.mark.parametrize("seed", range(5))
def test_icp_pulls_a_fair_start_onto_the_surface(cad: GripperCad, seed: int) -> None:
    rng = np.random.default_rng(seed)
    X_CH = hand_pose(seed)
    view = perfect_view(cad, X_CH)
    start = invert(view.crop.X_CV) @ X_CH @ make_pose(rotation_exp(rng.normal(0, 0.05, 3)), rng.normal(0, 0.006, 3))
    result = IcpRefiner(cad).refine(view, start, 0.02)
    assert result is not None
    distance, angle = pose_difference(view.crop.X_CV @ result, X_CH)
    assert distance < 0.001
    assert np.rad2deg(angle) < 0.5


def test_a_start_far_off_is_not_called_a_fit(cad: GripperCad) -> None:
    X_CH = hand_pose(0)
    view = perfect_view(cad, X_CH)
    start = invert(view.crop.X_CV) @ make_pose(np.eye(3), [0.3, 0.3, 0.0]) @ X_CH
    assert IcpRefiner(cad).refine(view, start, 0.02) is None


def test_the_cloud_lies_on_the_rays_at_the_depth(cad: GripperCad) -> None:
    view = perfect_view(cad, hand_pose(2))
    cloud = gripper_cloud(view)
    assert 0.5 * view.gripper.sum() < len(cloud) <= view.gripper.sum()
    pixel = cloud[:, :2] / cloud[:, 2:] * view.crop.focal + view.crop.size / 2
    cell = (pixel / view.stride).astype(int)
    np.testing.assert_allclose(cloud[:, 2], view.depth_m[cell[:, 1], cell[:, 0]])


def test_rays_meet_the_fingers_where_the_opening_puts_them(cad: GripperCad) -> None:
    tip = 0.1034
    down = make_pose(rotation_exp([np.pi, 0, 0]), [0.0, 0.0, 0.5])  # fingers towards the camera
    for opening in (0.01, 0.03):
        rays = np.array(
            [[0.0, -(opening + 0.008), 0.5 - tip], [0.0, opening + 0.008, 0.5 - tip], [0.0, 0.0, 0.5 - tip]]
        )
        assert cad.cast(down, rays, opening).part.tolist() == [2, 3, 1]
