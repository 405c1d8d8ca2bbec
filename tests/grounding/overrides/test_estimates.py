"""Estimated depth of other programs, scaled by a known pose of the gripper."""

from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.grounding.registration.fit import calibrate_depth
from kinebench_drake.grounding.tracking.tracker import CadTracker
from kinebench_drake.grounding.tracking.view import Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.cad import GripperCad
from tests.grounding.conftest import hand_pose, perfect_view


@pytest.mark.parametrize("factor", [0.7, 1.25])
def test_a_known_pose_determines_the_factor_of_estimated_depth(cad: GripperCad, factor: float) -> None:
    X_CH = hand_pose(3)
    view = perfect_view(cad, X_CH, 0.02, depth_factor=factor, noise_m=1e-3)
    depth = ExternalDepth(depth_m=np.full((2, 4, 4), factor))
    scaled = calibrate_depth(depth, view, X_CH, 0.02)
    assert scaled.calibrated
    np.testing.assert_allclose(scaled.depth_m, 1.0, rtol=3e-3)


def test_cells_without_external_depth_do_not_calibrate_its_scale(cad: GripperCad) -> None:
    """They have the network's, which is right whatever the scale of the other."""

    class Network:
        def estimate(
            self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]
        ) -> Iterator[tuple[int, GripperView]]:
            yield from ((i, perfect_view(cad, X_CH, 0.02, crop=crop)) for i, crop in crops.items())

    def calibrate(rows: slice) -> ExternalDepth:
        depth_m = np.full((2, camera.height, camera.width), 1.3 * X_CH[2, 3])
        depth_m[0] = 0.0
        depth_m[0, rows] = depth_m[1, rows]
        priors = Priors(X_CH=np.stack([X_CH, X_CH]), depth=ExternalDepth(depth_m=depth_m))
        depth = CadTracker(Network())._calibrate(frames, camera, priors).depth
        assert depth is not None
        return depth

    X_CH = hand_pose(3)
    camera = benchmark_camera()
    frames = np.zeros((2, camera.height, camera.width, 3), np.uint8)
    whole, some, none = (calibrate(rows) for rows in (slice(None), slice(1, None, 4), slice(0)))
    assert [whole.calibrated, some.calibrated, none.calibrated] == [True, True, False]
    assert some.depth_m[1, 0, 0] == pytest.approx(whole.depth_m[1, 0, 0], rel=0.01)
    assert whole.depth_m[1, 0, 0] < 0.9 * none.depth_m[1, 0, 0]
