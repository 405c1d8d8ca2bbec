import numpy as np
import pytest

from kinebench_drake.geometry import make_pose, pose_difference, rotation_exp, transform_points
from kinebench_drake.grounding.registration.fit import align, fit
from kinebench_drake.models.panda.cad import GripperCad
from tests.grounding.conftest import hand_pose, perfect_view


def test_alignment_recovers_a_known_pose() -> None:
    rng = np.random.default_rng(0)
    X = make_pose(rotation_exp([0.4, -1.2, 2.0]), [0.1, 0.2, 0.3])
    p_B = rng.normal(size=(30, 3))
    np.testing.assert_allclose(align(transform_points(X, p_B), p_B, rng.uniform(0.5, 2, 30)), X, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_exact_coordinates_determine_pose_and_finger_width(cad: GripperCad, seed: int) -> None:
    X_CH = hand_pose(seed)
    finger = 0.005 + 0.005 * seed
    view = perfect_view(cad, X_CH, finger)
    result = fit(view)
    assert result is not None
    distance, angle = pose_difference(result.X_CH, X_CH)
    assert distance < 1e-3
    assert np.rad2deg(angle) < 0.2
    if np.isfinite(result.finger_m):
        assert result.finger_m == pytest.approx(finger, abs=1e-3)


def test_a_common_factor_of_the_depth_is_estimated_and_corrected(cad: GripperCad) -> None:
    errors = []
    for seed in range(6):
        view = perfect_view(cad, hand_pose(seed), noise_m=0.003, depth_factor=1.03, seed=seed)
        result = fit(view)
        assert result is not None
        errors.append(pose_difference(result.X_CH, hand_pose(seed))[0])
        assert 1 / 1.03 < result.depth_factor < 1.0
    uncorrected = 0.03 * 0.65
    assert np.median(errors) < 0.7 * uncorrected


def test_outlier_coordinates_hardly_change_the_pose(cad: GripperCad) -> None:
    X_CH = hand_pose(1)
    view = perfect_view(cad, X_CH, noise_m=0.002)
    wrong = np.random.default_rng(0).random(view.part.shape) < 0.15
    view.coordinates_P[wrong] += [0.08, -0.05, 0.03]
    result = fit(view)
    assert result is not None
    distance, angle = pose_difference(result.X_CH, X_CH)
    assert distance < 0.007
    assert np.rad2deg(angle) < 1.5


def test_a_view_without_gripper_has_no_pose(cad: GripperCad) -> None:
    view = perfect_view(cad, hand_pose(0))
    view.part[:] = 0
    assert fit(view) is None
