"""Contribution of ICP: the table of known errors, and depth with a share of the network's errors."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.registration import BlendedEstimator, RegistrationErrors, SmoothErrorEstimator, section
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.grounding.priors import ExternalDepth
from kinebench_drake.grounding.tracking.view import Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.cad import GripperCad
from tests.grounding.conftest import hand_pose, perfect_view


def errors(gain_m: float) -> RegistrationErrors:
    fit = [0.002, 0.003, 0.004]
    return RegistrationErrors(
        position_m={"fit": fit, "ICP": [0.01] * 3, "combined": [x - gain_m for x in fit]},
        rotation_rad={name: [0.02] * 3 for name in ("fit", "ICP", "combined")},
        weight=[0.0, 0.5, 1.0],
    )


def test_the_section_states_medians_and_paired_differences() -> None:
    lines = section({"network": [errors(0.0), errors(0.0)], "exact": [errors(0.001), errors(0.002)]}).splitlines()
    network, exact = lines[-2:]
    assert network.startswith("| network | 0.50 | 3.00 / 1.15 | 10.00 / 1.15 | 3.00 / 1.15 | +0.00")
    assert "| -1.50 (-2.00 to -1.00) / +0.00" in exact
    assert "6 single frames of 2 held-out videos" in "\n".join(lines)


class _OneView:
    def __init__(self, view: GripperView) -> None:
        self._view = view

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        yield 0, self._view


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_blended_depth_keeps_the_given_share_of_the_network_error(share: float) -> None:
    camera = benchmark_camera()
    view = perfect_view(GripperCad(), hand_pose(0))
    true_C = np.full((1, camera.height, camera.width), 0.6)
    axis = (view.rays() @ view.crop.R_CV.T)[..., 2]
    view = replace(view, depth_m=1.04 * 0.6 / axis)
    blended = BlendedEstimator(_OneView(view), ExternalDepth(depth_m=true_C, exact=True), share)
    ((_, result),) = blended.estimate(np.zeros((1, camera.height, camera.width, 3), np.uint8), camera, {0: view.crop})
    inside = view.crop.in_image(camera, view.stride)
    inside[[0, -1]] = inside[:, [0, -1]] = False
    np.testing.assert_allclose((result.depth_m * axis / 0.6)[inside], 1.04**share, rtol=1e-5)


def test_a_smooth_depth_error_has_its_nominal_size_and_is_smooth_in_image_and_time() -> None:
    camera = benchmark_camera()
    view = perfect_view(GripperCad(), hand_pose(0))
    frames = np.zeros((20, camera.height, camera.width, 3), np.uint8)

    class Same:
        def estimate(
            self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]
        ) -> Iterator[tuple[int, GripperView]]:
            return ((number, view) for number in crops)

    def errors(seed: int) -> np.ndarray:
        wrong = SmoothErrorEstimator(Same(), len(frames), 0.05, np.random.default_rng(seed))
        views = wrong.estimate(frames, camera, dict.fromkeys(range(len(frames)), view.crop))
        return np.array([own.depth_m / view.depth_m - 1.0 for _, own in views])

    values = np.array([errors(seed) for seed in range(6)])
    assert np.sqrt((values**2).mean()) == pytest.approx(0.05, rel=0.3)
    for axis in (1, 2, 3):
        assert np.diff(values, axis=axis).std() < 0.6 * values.std()
    np.testing.assert_array_equal(errors(3), values[3])
