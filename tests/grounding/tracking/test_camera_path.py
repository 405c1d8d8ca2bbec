from dataclasses import replace

import cv2
import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import invert, make_pose, rotation_angle, rotation_exp
from kinebench_drake.grounding.tracking.camera_path import CameraPath, CameraWay, follow_camera

CAMERA = benchmark_camera()
FRAMES = 12
ROBOT = np.zeros((384, 384), dtype=bool)
ROBOT[150:250, 150:250] = True


def texture(seed, size=600):
    rng = np.random.default_rng(seed)
    noise = rng.integers(0, 255, (size // 10, size // 10, 3), dtype=np.uint8)
    return cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)


def view(camera, table=True):
    """A textured table at z = 0 in front of a textured wall, as the camera sees them, by homographies."""
    image = np.zeros((384, 384, 3), np.uint8)
    half = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    X_CB = invert(camera.X_BC)
    wall = make_pose([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [-0.8, 0.0, 1.0])
    planes = [(wall, 0, 3.0)] + ([(make_pose(np.eye(3), [0.4, 0.0, 0.0]), 1, 2.4)] if table else [])
    for X_BP, seed, size_m in planes:
        pattern = texture(seed)
        scale = size_m / len(pattern)
        P = np.array([[scale, 0.0, -size_m / 2], [0.0, scale, -size_m / 2], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        H = half @ camera.K @ (X_CB @ X_BP)[:3] @ P
        mask = cv2.warpPerspective(np.full(pattern.shape[:2], 255, np.uint8), H, (384, 384)) > 0
        image[mask] = cv2.warpPerspective(pattern, H, (384, 384))[mask]
    return image


def path(turn_rad=0.0, move_m=0.0, zoom=1.0, direction=(0.6, 0.8, 0.0)):
    """Cameras and images of a slow motion."""
    cameras = []
    images = []
    for s in np.linspace(0.0, 1.0, FRAMES):
        X = make_pose(rotation_exp(s * turn_rad * np.array(direction)), s * move_m * np.array(direction))
        factor = 1.0 + s * (zoom - 1.0)
        cameras.append(replace(CAMERA, X_BC=CAMERA.X_BC @ X, fx=CAMERA.fx * factor, fy=CAMERA.fy * factor))
        images.append(view(cameras[-1]))
    return cameras, np.stack(images)


def test_a_fixed_camera_has_no_path_while_the_robot_moves():
    images = np.repeat(view(CAMERA)[None], 4, axis=0)
    for i, image in enumerate(images):
        image[170:230, 160 + 6 * i : 220 + 6 * i] = texture(7, 60)
    followed = follow_camera(images, images[0], ROBOT, CAMERA)
    assert np.nanmax(followed.px) < 0.1
    assert np.linalg.norm(followed.p_AC, axis=1).max() < 1e-6


def test_a_turning_camera_is_followed_as_a_rotation():
    cameras, images = path(turn_rad=np.deg2rad(10.0))
    followed = follow_camera(images, images[0], ROBOT, CAMERA)
    assert followed.way is CameraWay.ROTATION
    assert followed.followed.all()
    R_true = invert(CAMERA.X_BC) @ cameras[-1].X_BC
    assert np.rad2deg(rotation_angle(followed.R_AC[-1].T @ R_true[:3, :3])) < 0.1


def test_a_zoom_is_followed_as_a_change_of_focal_length():
    _, images = path(zoom=1.05)
    followed = follow_camera(images, images[0], ROBOT, CAMERA)
    assert followed.way is CameraWay.ZOOM
    assert followed.zoom[-1] == pytest.approx(1.05, abs=0.002)
    assert np.rad2deg(rotation_angle(followed.R_AC[-1])) < 0.1


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (-0.5, -0.5, -0.7)])
def test_a_moving_camera_is_followed_in_metres_by_the_table(direction):
    cameras, images = path(move_m=0.1, direction=direction)
    followed = follow_camera(images, images[0], ROBOT, CAMERA)
    assert followed.way is CameraWay.PLACE
    assert followed.followed.all()
    p_true = (invert(CAMERA.X_BC) @ cameras[-1].X_BC)[:3, 3]
    np.testing.assert_allclose(followed.p_AC[-1], p_true, atol=0.005)


def test_a_turn_from_the_reference_image_to_the_first_frame_is_measured():
    cameras, images = path(turn_rad=np.deg2rad(5.0))
    followed = follow_camera(images[-1:], images[0], ROBOT, CAMERA)
    R_true = invert(CAMERA.X_BC) @ cameras[-1].X_BC
    assert np.rad2deg(rotation_angle(followed.R_AC[0].T @ R_true[:3, :3])) < 0.1


def test_a_camera_without_image_features_is_not_followed():
    grey = np.full((3, 384, 384, 3), 90, np.uint8)
    followed = follow_camera(grey, grey[0], ROBOT, CAMERA)
    assert not followed.followed.any()
    assert (np.eye(4) == followed.X_AC).all()


def test_stabilized_frames_match_the_first_frame():
    _, images = path(turn_rad=np.deg2rad(6.0), zoom=1.03)
    followed = follow_camera(images, images[0], ROBOT, CAMERA)
    steady, wide = followed.stabilize(images, CAMERA)
    margin = (wide.width - CAMERA.width) // 2
    assert margin > 20
    assert wide.cx == CAMERA.cx + margin
    inner = np.s_[130:250, 130:250]
    first = images[0][inner].astype(int)
    cropped = steady[-1][margin:-margin, margin:-margin]
    assert np.abs(cropped[inner] - first).mean() < 0.3 * np.abs(images[-1][inner] - first).mean()


def test_stabilization_undoes_a_zoom_along_both_image_axes():
    rng = np.random.default_rng(0)
    camera = benchmark_camera().resized(128, 128)
    image = cv2.GaussianBlur(rng.uniform(0, 255, (128, 128, 3)).astype(np.float32), (0, 0), 4.0)
    image = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)
    centre = np.array([camera.cx, camera.cy]) - 0.5  # OpenCV's pixel centres are integers
    M = np.column_stack([1.2 * np.eye(2), -0.2 * centre])
    frames = np.stack([image, cv2.warpAffine(image, M, (128, 128))]).astype(np.uint8)
    path = CameraPath(
        way=CameraWay.ZOOM,
        R_AC=np.tile(np.eye(3), (2, 1, 1)),
        p_AC=np.zeros((2, 3)),
        zoom=np.array([1.0, 1.2]),
        followed=np.ones(2, dtype=bool),
        px=np.zeros(2),
    )
    steady, _ = path.stabilize(frames, camera)
    inside = np.abs(steady[1, 20:-20, 20:-20].astype(float) - steady[0, 20:-20, 20:-20])
    assert inside.mean() < 3.0
