"""CAD surface of the Robotiq 2F-85 at any opening.

The meshes of `robotiq_2f85.npz` and the places of its joints are those of robosuite 1.5.2 (`robotiq_gripper_85.xml` and
its visual meshes; MIT licence, `LICENSE`). Its fingers are parallelograms: the knuckles turn, the fingertips keep their
direction. Coordinates are in the frame of the mounting face, in metres: z along the fingers, which open along y.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from kinebench_drake.geometry import Array, make_pose, rotation_exp, rotation_z

CLOSED_RAD = 0.8
"""Turn of the knuckles from open to closed [rad]."""
_FILE = Path(__file__).with_name("robotiq_2f85.npz")
_OUTER_KNUCKLE = (0.0, 0.0306011, 0.054904)
_INNER_KNUCKLE = (0.0, 0.0127, 0.06142)
# in the frame of the outer knuckle
_OUTER_FINGER = (0.0, 0.0315, -0.0041)
_INNER_FINGER = (0.0, 0.0376, 0.043)
# in the frame of the inner finger
_PAD = (0.0, -0.0220203, 0.03242)
_PAD_SIZE = (0.022, 0.00635, 0.0375)


@cache
def _meshes() -> Mapping[str, trimesh.Trimesh]:
    """Return the rigid pieces, each in the frame of its joint."""
    with np.load(_FILE) as data:
        names = [key.removesuffix("_faces") for key in data if key.endswith("_faces")]
        return {name: trimesh.Trimesh(data[f"{name}_vertices"], data[f"{name}_faces"]) for name in names}


def robotiq_mesh(knuckle_rad: float) -> trimesh.Trimesh:
    """Return the mesh of the whole gripper.

    Args:
        knuckle_rad: turn of the knuckles, from 0 (open) to `CLOSED_RAD` [rad].
    """
    pad = trimesh.creation.box(_PAD_SIZE)
    turned, turned_back = (rotation_exp([angle, 0.0, 0.0]) for angle in (knuckle_rad, -knuckle_rad))
    pieces = [_meshes()["base"].copy()]
    for side in (0.0, np.pi):
        X_RS = make_pose(rotation_z(side), np.zeros(3))
        X_RK = X_RS @ make_pose(turned, _OUTER_KNUCKLE)
        X_RF = X_RK @ make_pose(turned_back, _INNER_FINGER)
        pieces += [
            _placed(_meshes()["outer_knuckle"], X_RK),
            _placed(_meshes()["outer_finger"], X_RK @ _shift(_OUTER_FINGER)),
            _placed(_meshes()["inner_knuckle"], X_RS @ make_pose(turned, _INNER_KNUCKLE)),
            _placed(_meshes()["inner_finger"], X_RF),
            _placed(pad, X_RF @ _shift(_PAD)),
        ]
    return trimesh.util.concatenate(pieces)


def _shift(p: ArrayLike) -> Array:
    return make_pose(np.eye(3), p)


def _placed(mesh: trimesh.Trimesh, X: Array) -> trimesh.Trimesh:
    return mesh.copy().apply_transform(X)
