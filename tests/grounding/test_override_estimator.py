"""Estimated depth of other programs, scaled by a known pose of the gripper."""

import numpy as np
import pytest

from kinebench_drake.grounding.override_estimator import calibrate_depth
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.types import ExternalDepth
from tests.grounding.conftest import hand_pose, perfect_view


@pytest.mark.parametrize("factor", [0.7, 1.25])
def test_a_known_pose_determines_the_factor_of_estimated_depth(cad: GripperCad, factor: float) -> None:
    X_CH = hand_pose(3)
    view = perfect_view(cad, X_CH, 0.02, depth_factor=factor, noise_m=1e-3)
    depth = ExternalDepth(depth_m=np.full((2, 4, 4), factor))
    scaled = calibrate_depth(depth, view, X_CH, 0.02)
    assert scaled.calibrated
    np.testing.assert_allclose(scaled.depth_m, 1.0, rtol=3e-3)
