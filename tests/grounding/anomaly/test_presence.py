"""A vanished gripper, and a second one on views rendered from the CAD model."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import make_pose
from kinebench_drake.grounding.anomaly.appearance import (
    _inside,
    expect_gripper,
    find_duplicates,
    find_vanishing,
    second_gripper,
)
from kinebench_drake.grounding.tracking.view import Crop
from kinebench_drake.models.panda.description import RobotPart
from tests.grounding.conftest import hand_pose, perfect_view

CAMERA = benchmark_camera()


@pytest.fixture
def background(cad):
    """View of a whole image without a robot."""
    view = perfect_view(cad, hand_pose(0), crop=Crop.of_frame(CAMERA))
    return replace(view, part=np.zeros_like(view.part))


@pytest.fixture
def spans(background):
    """First and last frames of vanished grippers, by centres (T, 3) [m], confidence (T,), views, camera's shift."""

    def find(p, confidence, views=background, shift_m=0.0):
        explained = np.full(len(p), 400.0)  # phantoms apart, as many cells whatever the confidence
        X_SC = np.repeat(make_pose(np.eye(3), [shift_m, 0.0, 0.0])[None], len(p), axis=0)
        wide = views if isinstance(views, list) else [views] * len(p)
        expected = expect_gripper(p, confidence >= 0.1, CAMERA, wide, X_SC)
        result = find_vanishing(confidence, explained, expected).anomalies
        return [(a.frame_start, a.frame_end) for a in result]

    return find


def gone(start, end):
    confidence = np.full(49, 0.8)
    confidence[start:end] = 0.0
    return confidence


def test_a_gripper_missing_for_three_frames_or_more_has_vanished(reach, spans):
    for start, end in ((12, 22), (20, 23), (40, 49)):
        p = reach()
        p[start:end] = np.nan
        assert spans(p, gone(start, end)) == [(start, end - 1)]


def test_an_occlusion_of_two_frames_is_no_vanishing(reach, spans):
    assert spans(reach(), gone(12, 14)) == []
    assert spans(reach(), gone(0, 0)) == []


def test_a_gripper_that_leaves_the_image_or_never_appeared_has_not_vanished(reach, spans):
    leaving = np.tile([0.0, 0.0, 0.7], (49, 1))
    leaving[:12, 0] = np.linspace(0.2, 0.42, 12)  # the picture ends at x = 0.404 there
    assert spans(leaving, gone(12, 22)) == []
    assert spans(reach(), gone(0, 5)) == []
    assert spans(np.full((49, 3), np.nan), np.zeros(49)) == []


def test_a_gripper_lost_at_the_image_border_has_not_vanished(spans):
    p = np.tile([0.36, 0.0, 0.7], (49, 1))  # 21 px from the border
    assert spans(p, gone(12, 22)) == []
    inside = p - [0.05, 0.0, 0.0]
    assert spans(inside, gone(12, 22)) == [(12, 21)]
    assert spans(inside, gone(12, 22), shift_m=0.05) == []  # the camera moved
    fast = inside.copy()
    fast[10, 0] -= 0.05
    assert spans(fast, gone(12, 22)) == []  # it would be at the border in the next frame


def test_the_image_border_is_the_same_for_square_and_stretched_pixels():
    square = replace(CAMERA, fx=CAMERA.fx / 2, fy=CAMERA.fy / 2)
    stretched = replace(square, fx=CAMERA.fx, width=2 * CAMERA.width, cx=2 * CAMERA.cx)
    for x in np.linspace(-0.9, 0.9, 19):
        for y in np.linspace(-0.9, 0.9, 19):
            assert _inside(np.array([x, y, 0.8]), square) is _inside(np.array([x, y, 0.8]), stretched)


def test_a_gripper_hidden_behind_links_of_the_arm_has_not_vanished(background, spans):
    p = np.tile([0.1, 0.0, 0.7], (49, 1))
    part = background.part.copy()
    middle = part.shape[0] // 2
    part[:, middle:] = RobotPart.LINK6

    def behind(depth_m):
        return replace(background, part=part, depth_m=np.full(part.shape, depth_m))

    assert spans(p, gone(12, 22), behind(0.6)) == []
    assert spans(p, gone(12, 22), behind(0.8)) == [(12, 21)]  # the link is behind the gripper
    assert spans(p * [-1.0, 1.0, 1.0], gone(12, 22), behind(0.6)) == [(12, 21)]
    assert spans(p, gone(12, 22), behind(0.6), shift_m=-0.2) == [(12, 21)]  # the camera moved
    assert spans(p, gone(12, 22), [background] * 12 + [behind(0.6)] * 37) == []  # the link came in front just then
    assert spans(p, gone(12, 22), [background] * 13 + [behind(0.6)] * 36) == [(12, 21)]  # it came later


def test_a_gripper_has_vanished_where_only_a_few_cells_remain():
    explained = np.full(49, 400.0)
    explained[20:24] = 15.0
    confidence = np.full(49, 0.8)
    confidence[20:24] = 0.05
    (result,) = find_vanishing(confidence, explained, np.ones(49, dtype=bool)).anomalies
    assert (result.frame_start, result.frame_end) == (20, 23)


def test_the_second_gripper_is_scored_beside_the_tracked_one(cad):
    for seed in range(3):
        X_CH = hand_pose(seed)
        first = perfect_view(cad, X_CH, 0.03, crop=Crop.of_frame(CAMERA))
        beside = X_CH.copy()
        beside[0, 3] -= np.sign(X_CH[0, 3]) * 0.25
        second = perfect_view(cad, beside, 0.03, crop=Crop.of_frame(CAMERA))
        both = replace(first, part=np.where(first.part > 0, first.part, second.part))
        assert second_gripper(first, X_CH, CAMERA) == 0.0
        assert second_gripper(both, X_CH, CAMERA) > 0.3
        assert second_gripper(replace(first, part=np.zeros_like(first.part)), X_CH, CAMERA) == 0.0


def test_a_second_gripper_is_reported_only_if_it_stays_for_several_frames():
    other = np.zeros(49)
    other[5:7] = 0.9
    assert find_duplicates(other).anomalies == ()
    other[20:30] = 0.5
    (result,) = find_duplicates(other).anomalies
    assert (result.frame_start, result.frame_end, result.severity) == (20, 29, 0.5)
