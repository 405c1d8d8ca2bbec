"""Visible share of the gripper and maps of depth errors, by the CAD model without rendering."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.perception.clip import TruthClip, find_clips
from benchmarks.perception.depth_map import measure_depth
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.grounding.tracking.view import Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.description import RobotPart


@pytest.fixture
def small(clip: TruthClip) -> TruthClip:
    """Three frames: in the middle, half out of the picture, not there."""
    X = np.repeat(clip.X_CH[:1], 3, axis=0)
    X[:, :3, 3] = [0.0, 0.0, 0.7]
    camera = benchmark_camera()
    edge = float((np.linalg.inv(camera.K) @ [camera.width, camera.cy, 1.0])[0] * 0.7)
    X[1, 0, 3] = edge
    X[2] = np.nan
    return replace(clip, camera=camera, X_CH=X, t_s=clip.t_s[:3], finger_width_m=clip.finger_width_m[:3])


def test_visible_share_is_the_part_of_the_outline_inside_the_image(small: TruthClip, cad: GripperCad) -> None:
    masks = small.masks(cad)
    share = small.visible_share(masks, cad)
    assert share[0] > 0.97
    wide = replace(small.camera, width=768)  # the picture goes on to the right
    surface = cad.cast(small.X_CH[1], wide.rays().reshape(-1, 3), float(small.finger_width_m[1]) / 2)
    whole = surface.part.reshape(384, 768) > 0
    assert share[1] == pytest.approx(whole[:, :384].sum() / whole.sum(), abs=0.02)
    assert 0.1 < share[1] < 0.9
    assert np.isnan(share[2])
    assert not masks[2].any()


def test_a_stored_mask_takes_precedence_over_the_cad_outline(small: TruthClip, cad: GripperCad) -> None:
    outline = small.masks(cad)
    stored = outline.copy()
    stored[0, :, :192] = False
    half = replace(small, mask=stored)
    assert half.masks(cad) is stored
    expected = stored[0].sum() / outline[0].sum()
    assert half.visible_share(stored, cad)[0] == pytest.approx(expected, abs=0.05)


class TooFar:
    """Estimator of a flat hand 2 % too far."""

    def estimate(self, frames: Frames, camera: Camera, crops: Mapping[int, Crop]) -> Iterator[tuple[int, GripperView]]:
        for number, crop in crops.items():
            n = crop.size // 2
            z_V = 0.7005 / (crop.rays(2) @ crop.R_CV.T)[..., 2]
            part = np.full((n, n), RobotPart.HAND, np.uint8)
            flat = np.full((n, n), 0.01)
            view = GripperView(
                crop=crop, stride=2, in_image=part > 0, part=part, depth_m=1.02 * z_V, depth_sigma=flat,
                depth_factor_sigma=0.012, coordinates_P=np.zeros((n, n, 3)), coordinates_sigma_m=flat,
            )  # fmt: skip
            yield number, view


def test_a_constant_depth_error_appears_unchanged_in_median_and_maps(folder: Path) -> None:
    errors = measure_depth(find_clips(folder), TooFar())
    assert errors is not None
    assert errors.median == pytest.approx(0.02, abs=1e-5)
    assert errors.level_median == pytest.approx(0.02, abs=1e-5)
    for errormap in (errors.front, errors.side):
        mean = errormap.mean()
        assert np.isfinite(mean).any()
        np.testing.assert_allclose(mean[np.isfinite(mean)], 0.02, atol=1e-5)
    on_gripper = np.isfinite(errors.example.error)
    np.testing.assert_allclose(errors.example.error[on_gripper], 0.02, atol=1e-5)
