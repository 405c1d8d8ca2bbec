"""Boxes: visual and collider coincide."""

import numpy as np
import pytest

from kinebench_drake.geometry import rotation_exp, transform_points
from kinebench_drake.suites.scene.mesh import BodyParts, box_collider, box_visual
from kinebench_drake.suites.scene.model import Material, SurfaceFinish

LOW = np.array([-0.1, 0.2, 0.0])
HIGH = np.array([0.3, 0.25, 0.5])


@pytest.mark.parametrize("bevel_m", [0.0, 0.001])
def test_a_panel_fills_the_space_between_its_corners(bevel_m: float) -> None:
    parts = BodyParts()
    parts.panel(LOW, HIGH, SurfaceFinish(), bevel_m=bevel_m)
    parts.panel(LOW, HIGH + 1.0, SurfaceFinish(), solid=False)
    body = parts.body("shelf", Material())
    visual = body.visuals[0]
    [solid] = body.colliders
    points = transform_points(visual.X_BodyV, visual.mesh.vertices)
    assert np.allclose([points.min(axis=0), points.max(axis=0)], [LOW, HIGH])
    assert np.allclose(solid.X_BodyC[:3, 3] - solid.size, LOW)
    assert np.allclose(solid.X_BodyC[:3, 3] + solid.size, HIGH)
    assert len(body.visuals) == 2


def test_visual_and_collider_of_a_rotated_box_coincide() -> None:
    R = rotation_exp([0.0, 0.0, 0.4])
    size = [0.2, 0.1, 0.02]
    center = [0.5, 0.0, 0.1]
    assert np.array_equal(
        box_visual(size, center, SurfaceFinish(), R=R).X_BodyV, box_collider(size, center, R=R).X_BodyC
    )
    assert np.allclose(box_collider(size, center, R=R).X_BodyC[:3, :3], R)
