import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import make_pose, transform_points
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H, Crop


def test_a_point_of_the_crop_lies_on_the_same_ray_of_the_frame() -> None:
    camera = benchmark_camera()
    crop = Crop.towards([0.2, -0.1, 0.9], 0.2, 128, roll=0.3)
    p_V = np.array([0.03, -0.05, 0.7])
    in_crop = p_V[:2] / p_V[2] * crop.focal + crop.size / 2
    mapped = crop.homography(camera) @ [*in_crop, 1.0]
    np.testing.assert_allclose(mapped[:2] / mapped[2], camera.project(crop.R_CV @ p_V), atol=1e-9)


def test_a_warped_point_lies_where_the_homography_maps_it() -> None:
    camera = benchmark_camera()
    crop = Crop.towards([0.1, 0.1, 1.0], 0.25, 128)
    pixel = camera.project(crop.R_CV @ [0.02, 0.01, 0.5])
    v, u = np.mgrid[0:384, 0:384] + 0.5
    frame = np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / 18).astype(np.float32)
    warped = crop.warp(frame, camera).astype(float)
    v, u = np.mgrid[0:128, 0:128] + 0.5
    result = np.array([(u * warped).sum(), (v * warped).sum()]) / warped.sum()
    np.testing.assert_allclose(result, np.array([0.04, 0.02]) * crop.focal + 64, atol=0.3)


def test_a_crop_of_the_gripper_is_centred_on_it() -> None:
    X_CH = make_pose(np.eye(3), [0.1, -0.2, 0.6])
    crop = Crop.of_gripper(X_CH, 1.3, 128)
    centre = transform_points(X_CH, GRIPPER_CENTRE_H[None])[0] @ crop.R_CV
    np.testing.assert_allclose(centre[:2], 0.0, atol=1e-12)


def test_a_crop_without_roll_keeps_the_vertical_direction() -> None:
    crop = Crop.towards([0.3, 0.0, 1.0], 0.2, 64)
    np.testing.assert_allclose(crop.R_CV[:, 1], [0, 1, 0], atol=1e-12)
    assert np.linalg.det(crop.R_CV) == pytest.approx(1.0)


@pytest.mark.parametrize(("width", "height"), [(384, 384), (832, 480), (480, 832)])
def test_the_whole_image_fits_into_its_crop(width: int, height: int) -> None:
    from dataclasses import replace

    camera = replace(benchmark_camera(), width=width, height=height, cx=width / 2 + 7, cy=height / 2)
    crop = Crop.of_frame(camera)
    to_crop = np.linalg.inv(crop.homography(camera))
    for corner in ((0, 0), (width, 0), (0, height), (width, height)):
        p = to_crop @ [*corner, 1.0]
        assert ((p[:2] / p[2] > -4) & (p[:2] / p[2] < crop.size + 4)).all()


def test_labels_of_a_crop_return_to_their_pixels() -> None:
    camera = benchmark_camera()
    crop = Crop.of_frame(camera)
    frame = np.zeros((384, 384), np.uint8)
    frame[100:220, 60:300] = 1
    cells = np.asarray(crop.warp(frame, camera, 2, nearest=True), dtype=np.uint8)
    assert (crop.unwarp(cells, camera, 2) != frame).mean() < 0.01
