"""Cameras that are known by name: their pictures at other shapes, and which one the arm of a clip confirms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.picture_reading import PictureReading
from kinebench_drake.grounding.camera.recognition import RECOGNITION_LEAD, Recognition, cameras_of
from kinebench_drake.grounding.components import GroundingComponents
from kinebench_drake.io.reader import read_video
from kinebench_drake.named_cameras import find_camera, named_cameras

CLIP = Path("tests/gate/benchmark.mp4")
POINT_B = np.array([0.4, 0.1, 0.2])


def pixel(camera):
    X_CB = np.linalg.inv(camera.X_BC)
    return camera.project((X_CB @ [*POINT_B, 1.0])[:3])


def test_the_camera_of_a_scaled_picture_is_the_named_one_scaled():
    named = named_cameras()["libero-tabletop"]
    (camera,) = cameras_of(named, 384, 384)
    np.testing.assert_allclose(pixel(camera), 3 * pixel(named.setting.camera))


def test_the_cameras_of_a_wide_picture_are_rendered_so_or_cut_to_the_middle_or_the_upper_part():
    named = named_cameras()["libero-tabletop"]
    whole = (332 / 128) * pixel(named.setting.camera)
    rendered, middle, upper = cameras_of(named, 332, 270)
    np.testing.assert_allclose(pixel(upper), whole)
    np.testing.assert_allclose(pixel(middle), whole - [0.0, 31.0])
    np.testing.assert_allclose(rendered.fy / 270, named.setting.camera.fy / 128)
    assert upper.cy == 166.0


@pytest.mark.parametrize("name", ["maniskill-base-pull-cube", "rlbench-left-shoulder"])
def test_a_camera_that_does_not_show_the_robots_foot_is_not_tried(name):
    assert not list(cameras_of(named_cameras()[name], 128, 128))


@pytest.mark.parametrize(
    ("changes", "is_clear"),
    [
        ({}, True),
        ({"agreement": bounds.AGREEMENT - 0.01}, False),
        ({"lead": RECOGNITION_LEAD - 0.01}, False),
        ({"freed": 0.6 + RECOGNITION_LEAD + 0.01}, False),
        ({"base_agreement": bounds.BASE_AGREEMENT - 0.01}, False),
    ],
)
def test_a_camera_is_clear_if_arm_and_base_agree_and_neither_another_nor_a_freed_one_nearly_as_well(changes, is_clear):
    named = find_camera("rlbench-front")
    clear = Recognition(
        named=named,
        camera=named.setting.camera,
        reading=None,
        agreement=0.6,
        base_agreement=0.6,
        lead=0.3,
        freed=0.61,
    )
    assert replace(clear, **changes).is_clear is is_clear


@pytest.mark.parametrize("reading", [None, PictureReading.MIRRORED, PictureReading.TURNED_RIGHT])
def test_the_camera_of_a_clip_is_recognized_and_how_its_picture_is_turned(reading):
    turned = {
        None: None,
        PictureReading.MIRRORED: PictureReading.MIRRORED,
        PictureReading.TURNED_RIGHT: PictureReading.TURNED_LEFT,
    }[reading]
    frames = np.asarray(read_video(CLIP).frames)
    recognition = GroundingComponents().recognize(frames if turned is None else turned.frames(frames))
    assert recognition is not None
    assert recognition.named.name == "benchmark"
    assert recognition.reading is reading
    assert recognition.is_usual == (reading is None)
