"""Localization of the robot in large images, with an estimator that recognizes it only in crops that show it large."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.grounding.tracking.localization import find_region, likeliest_gripper, tile_image
from kinebench_drake.grounding.tracking.view import WIDE_SIZE, Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.description import RobotPart
from tests.grounding.conftest import perfect_view

CAMERA = Camera(width=960, height=540, fx=700.0, fy=700.0, cx=480.0, cy=270.0, X_BC=np.eye(4))
R_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
FRAMES = np.zeros((7, 540, 960, 3), np.uint8)


class SharpEyes:
    """An estimator that sees the gripper at `X_CH` where its crop shows it at least `least_px` wide."""

    def __init__(self, cad: GripperCad, X_CH: Array, least_px: float) -> None:
        self._cad = cad
        self._X_CH = X_CH
        self._least_px = least_px
        self.views = 0

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        for i, crop in crops.items():
            self.views += 1
            view = perfect_view(self._cad, self._X_CH, crop=crop)
            large = 0.23 / np.linalg.norm(self._X_CH[:3, 3]) * crop.focal >= self._least_px
            yield i, view if large else replace(view, part=np.zeros_like(view.part))


def located(cad: GripperCad, X_CH: Array, least_px: float) -> tuple[Crop | None, SharpEyes]:
    eyes = SharpEyes(cad, X_CH, least_px)
    whole = dict(eyes.estimate(FRAMES, CAMERA, dict.fromkeys(range(len(FRAMES)), Crop.of_frame(CAMERA))))
    return find_region(eyes, FRAMES, CAMERA, whole), eyes


@pytest.mark.parametrize("place", [[-0.9, -0.3, 2.0], [0.8, 0.4, 2.2], [0.1, 0.0, 1.8]])
def test_tiles_locate_a_small_gripper_and_enlarge_its_region(cad: GripperCad, place: list[float]) -> None:
    X_CH = make_pose(R_DOWN, place)
    region, _ = located(cad, X_CH, least_px=22.0)
    assert region is not None
    assert region.size == WIDE_SIZE
    assert region.focal > 1.5 * Crop.of_frame(CAMERA).focal
    p_V = region.R_CV.T @ X_CH[:3, 3]
    assert (np.abs(p_V[:2] / p_V[2] * region.focal) < WIDE_SIZE / 2).all()


@pytest.mark.parametrize(("fx", "fy"), [(700.0, 700.0), (1400.0, 700.0), (700.0, 1400.0)])
def test_tiles_cover_the_image_for_any_pixel_aspect_ratio(fx: float, fy: float) -> None:
    camera = replace(CAMERA, fx=fx, fy=fy)
    covered = sum(tile.unwarp(np.ones((WIDE_SIZE, WIDE_SIZE), np.uint8), camera) > 0 for tile in tile_image(camera, 2))
    assert (np.asarray(covered) > 0).mean() > 0.99


def test_a_large_gripper_needs_no_search(cad: GripperCad) -> None:
    region, eyes = located(cad, make_pose(R_DOWN, [0.1, 0.0, 0.6]), least_px=20.0)
    assert region is None
    assert eyes.views == len(FRAMES)


def test_an_image_without_a_gripper_has_no_region(cad: GripperCad) -> None:
    assert located(cad, make_pose(R_DOWN, [0.1, 0.0, 2.0]), least_px=1e6)[0] is None


def test_the_likeliest_gripper_is_the_one_at_the_wrist_or_else_the_largest(cad: GripperCad) -> None:
    view = perfect_view(cad, make_pose(R_DOWN, [-0.2, 0.0, 0.8]), crop=Crop.of_frame(CAMERA))
    part = view.part.copy()
    part[10:14, 70:80] = RobotPart.HAND
    part[7:10, 70:80] = RobotPart.LINK7
    assert 40 < view.gripper.sum() < 4 * 40
    both = replace(view, part=part)
    expected = np.zeros_like(view.gripper)
    expected[10:14, 70:80] = True
    np.testing.assert_array_equal(likeliest_gripper(both).gripper, expected)
    without_wrist = replace(both, part=np.where(part == RobotPart.LINK7, 0, part).astype(np.uint8))
    np.testing.assert_array_equal(likeliest_gripper(without_wrist).gripper, view.gripper)
