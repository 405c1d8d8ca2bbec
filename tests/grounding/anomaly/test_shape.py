"""Deformation and size on views rendered from the CAD model."""

from dataclasses import replace

import numpy as np
import pytest

from kinebench_drake.grounding.anomaly.appearance import (
    find_deformations,
    find_misshapen,
    measure_size,
    shape_misfit,
)
from kinebench_drake.grounding.registration.fit import fit
from kinebench_drake.grounding.registration.hand_contour import HandShape
from tests.grounding.conftest import hand_pose, perfect_view

NOISE_M = 0.004


def misfit_of(view):
    fitted = fit(view)
    assert fitted is not None
    return shape_misfit(view, fitted.X_CH, fitted.finger_m)


def test_the_shape_misfit_of_a_stretched_gripper_exceeds_that_of_noise(cad):
    for seed in range(4):
        X_CH = hand_pose(seed)
        view = perfect_view(cad, X_CH, 0.03, noise_m=NOISE_M, seed=seed)
        stretched = replace(view, coordinates_P=view.coordinates_P / [1.0, 1.0, 1.25])
        assert misfit_of(view) < 0.03 < 0.06 < misfit_of(stretched)


def test_the_shape_misfit_of_a_mostly_hidden_gripper_is_unknown(cad):
    X_CH = hand_pose(0)
    view = perfect_view(cad, X_CH, 0.03, noise_m=NOISE_M)
    hidden = replace(view, part=np.where(np.arange(64) < 54, 0, view.part).astype(np.uint8))
    assert np.isnan(shape_misfit(hidden, X_CH, 0.03))


def test_a_lasting_misfit_is_a_deformation_and_a_misfit_of_one_frame_is_none():
    misfit = np.full(49, 0.01)
    residual = np.full(49, 0.5)
    misfit[12] = 0.3
    residual[12] = 2.0
    misfit[30:42] = 0.15
    residual[30:42] = 1.0
    (result,) = find_deformations(misfit, residual).anomalies
    assert (result.frame_start, result.frame_end, result.severity) == (30, 41, 0.15)


def test_a_deformation_needs_both_a_misfit_and_a_residual():
    """As when the gripper is visible edge-on; and residuals without a common misfit are noise."""
    n = np.ones(49)
    assert find_deformations(0.2 * n, 0.55 * n).anomalies == ()
    assert find_deformations(0.01 * n, np.r_[0.5 * n[:30], 1.5 * n[30:]]).anomalies == ()


def test_a_gripper_deformed_in_every_frame_is_reported():
    (result,) = find_deformations(np.full(49, 0.04), np.full(49, 1.0)).anomalies
    assert (result.frame_start, result.frame_end) == (0, 48)


@pytest.mark.parametrize("error", [0.05, -0.1])
def test_the_size_of_a_hand_is_measured_within_its_standard_error(error):
    noise = np.random.default_rng(0).normal(0, 0.02, 49)
    size = measure_size(1.0 + error + noise)
    assert size is not None
    assert abs(size.error - error) < 2.0 * size.sigma < 0.05


def test_the_size_of_a_hand_that_few_frames_show_is_unknown():
    scale = np.full(49, np.nan)
    assert measure_size(scale) is None
    scale[:19] = 1.1
    assert measure_size(scale) is None


LARGE = HandShape(log_scale=0.14, stretch=0.03, gain=0.3)
BENT = HandShape(log_scale=0.05, stretch=0.2, gain=0.3)


def test_a_contour_of_another_size_throughout_is_no_deformation():
    assert find_misshapen([LARGE] * 49).anomalies == ()


def test_a_contour_of_another_shape_for_twelve_frames_is_a_deformation_there():
    deformation = find_misshapen([HandShape()] * 20 + [BENT] * 12 + [HandShape()] * 17)
    (result,) = deformation.anomalies
    assert (result.frame_start, result.frame_end) == (20, 31)


def test_a_contour_that_agrees_no_better_with_another_shape_is_no_anomaly():
    unsure = replace(BENT, gain=0.1)
    for shapes in ([unsure] * 49, [None] * 49, [HandShape()] * 22 + [BENT] * 3 + [HandShape()] * 24):
        assert find_misshapen(shapes).anomalies == ()
