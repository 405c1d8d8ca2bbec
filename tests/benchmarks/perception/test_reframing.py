"""Reframed clips: the ground truth stays valid for the camera of the estimated framing."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.perception.clip import TruthClip
from benchmarks.perception.reframing import Reframing, reframe, reframings
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import make_pose

POINT_C = np.array([0.05, 0.03, 0.7])


@pytest.fixture
def clip():
    poses = np.stack([make_pose(np.eye(3), POINT_C)] * 2)
    return TruthClip(
        id="a",
        task="",
        path=Path("a.mp4"),
        camera=benchmark_camera(),
        t_s=np.arange(2.0),
        X_CH=poses,
        finger_width_m=np.zeros(2),
        depth_m=None,
        mask=None,
        faults=(),
    )


@pytest.fixture
def frames():
    """Blobs of many sizes, and one white dot where the camera sees the point."""
    rng = np.random.default_rng(0)
    noise = [cv2.GaussianBlur(rng.normal(0, 40 * s, (384, 384, 3)), (0, 0), s) for s in (3, 9, 25)]
    image = np.clip(110 + sum(noise), 0, 200).astype(np.uint8)
    u, v = benchmark_camera().project(POINT_C)
    cv2.circle(image, (round(u - 0.5), round(v - 0.5)), 5, (255, 255, 255), -1)
    return np.stack([image] * 2)


@pytest.mark.parametrize("reframing", reframings(), ids=lambda r: r.label)
def test_the_reframed_camera_projects_onto_the_reframed_images(clip, frames, reframing):
    mask = np.zeros(frames.shape[:3], bool)
    mask[:, :, 150:250] = True
    other, images, share = reframe(reframing, clip, frames, mask)
    assert images.shape[1:3] == (other.camera.height, other.camera.width)
    bright = (images[0].min(axis=-1) > 245).nonzero()
    centre = np.array([bright[1].mean(), bright[0].mean()]) + 0.5
    assert np.abs(centre - other.camera.project(POINT_C)).max() < 1.5
    expected = {"crop": reframing.size[1] / reframing.size[0]}.get(reframing.way, 1.0)
    assert share == pytest.approx(expected, abs=0.01)


def test_a_gripper_outside_the_crop_has_visible_share_zero(clip, frames):
    mask = np.zeros(frames.shape[:3], bool)
    mask[:, :60] = True
    camera = replace(clip, camera=benchmark_camera().resized(192, 192))  # of any size
    assert (reframe(Reframing(size=(832, 480), way="crop"), camera, frames, mask)[2] == 0).all()
