"""A vanished gripper, and a second one on views rendered from the CAD model."""

from dataclasses import replace

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.grounding.anomaly.appearance import (
    find_duplicates,
    find_vanishing,
    second_gripper,
)
from kinebench_drake.grounding.tracking.view import Crop
from kinebench_drake.models.panda.cad import franka_hand
from tests.grounding.conftest import hand_pose, perfect_view

CAMERA = benchmark_camera()


def vanished(confidence, expected=None):
    """First and last frames of vanished grippers, by confidence (T,)."""
    explained = np.full(len(confidence), 400.0)  # phantoms apart, as many cells whatever the confidence
    expected = np.ones(len(confidence), dtype=bool) if expected is None else expected
    return [(a.frame_start, a.frame_end) for a in find_vanishing(confidence, explained, expected).anomalies]


def gone(start, end):
    confidence = np.full(49, 0.8)
    confidence[start:end] = 0.0
    return confidence


def test_a_gripper_missing_for_three_frames_or_more_has_vanished():
    for start, end in ((12, 22), (20, 23), (40, 49)):
        assert vanished(gone(start, end)) == [(start, end - 1)]


def test_an_occlusion_of_two_frames_is_no_vanishing():
    assert vanished(gone(12, 14)) == []
    assert vanished(gone(0, 0)) == []


def test_a_gripper_that_is_not_expected_has_not_vanished():
    expected = np.ones(49, dtype=bool)
    expected[14:18] = False
    assert vanished(gone(12, 22), expected) == [(18, 21)]


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
        assert second_gripper(first, X_CH, CAMERA, franka_hand()) == 0.0
        assert second_gripper(both, X_CH, CAMERA, franka_hand()) > 0.3
        assert second_gripper(replace(first, part=np.zeros_like(first.part)), X_CH, CAMERA, franka_hand()) == 0.0


def test_a_second_gripper_is_reported_only_if_it_stays_for_several_frames():
    other = np.zeros(49)
    other[5:7] = 0.9
    assert find_duplicates(other).anomalies == ()
    other[20:30] = 0.5
    (result,) = find_duplicates(other).anomalies
    assert (result.frame_start, result.frame_end, result.severity) == (20, 29, 0.5)
