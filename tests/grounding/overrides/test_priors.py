"""Masks and depth in place of estimates; the estimator is a fake."""

from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import InputError
from kinebench_drake.grounding.priors import ExternalDepth, Priors
from kinebench_drake.grounding.tracking.view import Crop, GripperView, OverrideEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import RobotPart


class Flat:
    """Estimator of a hand one metre away everywhere."""

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        return ((number, self.view(crop)) for number, crop in crops.items())

    @staticmethod
    def view(crop: Crop) -> GripperView:
        n = crop.size // 2
        return GripperView(
            crop=crop,
            stride=2,
            in_image=np.ones((n, n), dtype=bool),
            part=np.full((n, n), RobotPart.HAND, np.uint8),
            depth_m=np.ones((n, n)),
            depth_sigma=np.full((n, n), 0.02),
            depth_factor_sigma=0.012,
            coordinates_P=np.zeros((n, n, 3)),
            coordinates_sigma_m=np.full((n, n), 0.01),
        )


CAMERA = benchmark_camera().resized(96, 96)
FRAMES = np.zeros((12, 96, 96, 3), np.uint8)
MASKS = np.zeros((12, 96, 96), dtype=bool)
"""A square that moves 2 px a frame."""
for k, mask in enumerate(MASKS):
    mask[30:60, 20 + 2 * k : 50 + 2 * k] = True


@pytest.fixture
def crop() -> Crop:
    return Crop.towards([0.0, 0.0, 1.0], 0.4, 64)


def test_true_mask_and_depth_replace_estimates_of_their_own_frame(crop: Crop) -> None:
    depth = np.broadcast_to(0.5 + 0.01 * np.arange(len(FRAMES))[:, None, None], MASKS.shape)
    estimator = OverrideEstimator(
        Flat(), Priors(mask=MASKS, depth=ExternalDepth(depth_m=np.where(MASKS, depth, 0.0), exact=True))
    )
    views = dict(estimator.estimate(FRAMES, CAMERA, dict.fromkeys([7, 2, 11], crop)))
    assert views.keys() == {7, 2, 11}
    for number, view in views.items():
        assert 0 < view.gripper.sum() < view.part.size
        np.testing.assert_allclose(view.depth_m[view.gripper], 0.5 + 0.01 * number, rtol=1e-6)
        assert (view.depth_m[~view.gripper] == 1.0).all()
        assert (view.depth_sigma[view.gripper] == 1e-3).all()


def test_without_a_prior_mask_or_depth_the_estimate_stays(crop: Crop) -> None:
    view = dict(OverrideEstimator(Flat(), Priors(mask=MASKS)).estimate(FRAMES, CAMERA, {0: crop}))[0]
    assert (view.depth_m == 1.0).all()
    assert not view.gripper.all()
    depth = np.full(MASKS.shape, 0.6)
    view = dict(
        OverrideEstimator(Flat(), Priors(depth=ExternalDepth(depth_m=depth))).estimate(FRAMES, CAMERA, {0: crop})
    )[0]
    assert view.gripper.all()
    np.testing.assert_allclose(view.depth_m, 0.6, rtol=1e-6)


def test_masks_of_another_video_are_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        Priors(mask=MASKS[:3]).check_shapes(*FRAMES.shape[:3])
