"""The Robotiq 2F-85: known dimensions, symmetry and the path of its fingertips."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from kinebench_drake.models.robotiq.cad import CLOSED_RAD, robotiq_mesh


def pad(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """The corners (8, 3) of a pad, the last piece of the mesh."""
    return np.asarray(mesh.vertices[-8:])


def pad_gap_m(mesh: trimesh.Trimesh) -> float:
    return float(2 * np.abs(pad(mesh)[:, 1]).min())


def test_the_stroke_of_the_gripper_is_that_of_the_data_sheet() -> None:
    assert pad_gap_m(robotiq_mesh(0.0)) == pytest.approx(0.085, abs=0.002)
    assert pad_gap_m(robotiq_mesh(0.5 * CLOSED_RAD)) == pytest.approx(0.045, abs=0.006)
    assert pad_gap_m(robotiq_mesh(CLOSED_RAD)) < 0.003


@pytest.mark.parametrize("knuckle_rad", [0.0, 0.3, CLOSED_RAD])
def test_the_fingers_are_symmetric_under_half_a_turn(knuckle_rad: float) -> None:
    mesh = robotiq_mesh(knuckle_rad)
    fingers = mesh.vertices[mesh.vertices[:, 2] > 0.1]
    turned = fingers * [-1.0, -1.0, 1.0]
    distance = np.array([np.linalg.norm(fingers - point, axis=1).min() for point in turned[::10]])
    assert distance.max() < 1e-4


def test_closing_moves_the_fingertips_forwards_and_keeps_their_direction() -> None:
    opened, closed = (robotiq_mesh(angle) for angle in (0.0, CLOSED_RAD))
    assert 0.005 < closed.bounds[1, 2] - opened.bounds[1, 2] < 0.02
    for mesh in (opened, closed):
        np.testing.assert_allclose(np.ptp(pad(mesh), axis=0), [0.022, 0.00635, 0.0375], atol=1e-6)


def test_changing_a_mesh_does_not_change_later_ones() -> None:
    robotiq_mesh(0.2).apply_translation([1.0, 0.0, 0.0])
    assert abs(robotiq_mesh(0.2).bounds).max() < 0.2
