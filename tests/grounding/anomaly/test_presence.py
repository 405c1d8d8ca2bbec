"""A vanished gripper, and a second one on views rendered from the CAD model."""

from dataclasses import replace

import numpy as np

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.grounding.anomaly.presence import find_duplicates, find_vanishing, second_gripper
from kinebench_drake.grounding.crop import Crop
from tests.grounding.conftest import hand_pose, perfect_view

CAMERA = benchmark_camera()


def spans(p, confidence):
    explained = np.full(len(p), 400.0)  # phantoms apart, as many cells whatever the confidence
    result = find_vanishing(p, confidence, explained, confidence >= 0.1, CAMERA).anomalies
    return [(a.frame_start, a.frame_end) for a in result]


def gone(start, end):
    confidence = np.full(49, 0.8)
    confidence[start:end] = 0.0
    return confidence


def test_a_gripper_that_is_gone_has_vanished(reach):
    for start, end in ((12, 22), (20, 23), (40, 49)):
        p = reach()
        p[start:end] = np.nan
        assert spans(p, gone(start, end)) == [(start, end - 1)]


def test_a_passing_occlusion_is_none(reach):
    assert spans(reach(), gone(12, 14)) == []
    assert spans(reach(), gone(0, 0)) == []


def test_a_gripper_that_leaves_the_image_or_never_appeared_has_not_vanished(reach):
    leaving = np.tile([0.0, 0.0, 0.7], (49, 1))
    leaving[:12, 0] = np.linspace(0.2, 0.42, 12)  # the picture ends at x = 0.404 there
    assert spans(leaving, gone(12, 22)) == []
    assert spans(reach(), gone(0, 5)) == []
    assert spans(np.full((49, 3), np.nan), np.zeros(49)) == []


def test_a_phantom_of_a_few_cells_is_no_gripper(reach):
    explained = np.full(49, 400.0)
    explained[20:24] = 15.0
    confidence = np.full(49, 0.8)
    confidence[20:24] = 0.05
    (result,) = find_vanishing(reach(), confidence, explained, confidence >= 0.1, CAMERA).anomalies
    assert (result.frame_start, result.frame_end) == (20, 23)


def test_a_second_gripper_counts_and_the_first_does_not(cad):
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


def test_a_second_gripper_must_stay_to_be_detected():
    other = np.zeros(49)
    other[5:7] = 0.9
    assert find_duplicates(other).anomalies == ()
    other[20:30] = 0.5
    (result,) = find_duplicates(other).anomalies
    assert (result.frame_start, result.frame_end, result.severity) == (20, 29, 0.5)
