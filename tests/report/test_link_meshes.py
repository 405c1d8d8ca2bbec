"""Surfaces of the links: light, in place, of whatever shapes the URDF has."""

import numpy as np
import pytest

from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import load_robot
from kinebench_drake.report.replay import MAX_TRIANGLES, link_meshes


def by_link(plant):
    return {mesh.link: mesh for mesh in link_meshes(plant)}


def test_meshes_of_the_panda_have_few_triangles_and_true_size():
    meshes = by_link(ArmPlant())
    assert set(meshes) == {
        *(f"panda_link{k}" for k in range(8)),
        "panda_hand",
        "panda_leftfinger",
        "panda_rightfinger",
    }
    for mesh in meshes.values():
        assert len(mesh.faces) <= MAX_TRIANGLES
        assert mesh.faces.max() < len(mesh.vertices)
    size = np.ptp(meshes["panda_hand"].vertices, axis=0)
    np.testing.assert_allclose(size, [0.063, 0.204, 0.092], atol=0.005)  # the hand as its maker draws it


SHAPES = {
    1: ('<visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>', [0.1, 0.2, 0.3]),
    2: ('<visual><geometry><cylinder radius="0.05" length="0.4"/></geometry></visual>', [0.1, 0.1, 0.4]),
    3: ('<visual><geometry><sphere radius="0.06"/></geometry></visual>', [0.12, 0.12, 0.12]),
    4: (
        '<visual><origin xyz="0.5 0 0"/><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
        '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>',
        [0.6, 0.1, 0.1],
    ),
    5: ('<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>', [0.2, 0.2, 0.2]),
}
"""Elements of a link, by its number, and the extent of its mesh [m]."""


@pytest.fixture
def arm(tmp_path):
    """An arm of plain shapes; its fifth link has no visual element."""
    links = "".join(
        f'<link name="link{k}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        f"</inertial>{SHAPES.get(k, ('',))[0]}</link>"
        for k in range(8)
    )
    joints = "".join(
        f'<joint name="joint{k}" type="revolute"><parent link="link{k - 1}"/><child link="link{k}"/>'
        f'<origin xyz="0 0 1"/><axis xyz="{k % 2} {(k + 1) % 2} 0"/>'
        '<limit lower="-2" upper="2" velocity="2" effort="50"/></joint>'
        for k in range(1, 8)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    return ArmPlant(load_robot(path, "link7"))


def test_primitive_shapes_of_a_urdf_have_meshes(arm):
    meshes = by_link(arm)
    assert set(meshes) == {f"link{k}" for k in SHAPES}
    for k, (_, extent) in SHAPES.items():
        np.testing.assert_allclose(np.ptp(meshes[f"link{k}"].vertices, axis=0), extent, rtol=0.02)
    assert meshes["link4"].vertices[:, 0].max() == pytest.approx(0.55)
