"""Visible share of the gripper, by the CAD model without rendering."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.perception.clip import TruthClip
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.models.panda.cad import GripperCad


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
