"""CAD model of the Robotiq 2F-85.

The meshes of `robotiq_2f85.npz` and the places of its joints are those of robosuite 1.5.2 (`robotiq_gripper_85.xml` and
its visual meshes; MIT licence, `LICENSE`). Its fingers are parallelograms: the knuckles turn, the fingertips keep their
direction. The frame of the gripper is its mounting face: z along the fingers, which open along y.
"""

from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from kinebench_drake.geometry import Array, make_pose, rotation_exp, rotation_z, transform_points
from kinebench_drake.models.gripper import GripperModel, Knuckle, Parallelogram
from kinebench_drake.models.panda.description import RobotPart

_FILE = Path(__file__).with_name("robotiq_2f85.npz")
_OUTER_KNUCKLE = np.array([0.0, 0.0306011, 0.054904])
_INNER_KNUCKLE = np.array([0.0, 0.0127, 0.06142])
# in the frame of the outer knuckle, gripper open
_OUTER_FINGER = np.array([0.0, 0.0315, -0.0041])
_INNER_FINGER = np.array([0.0, 0.0376, 0.043])
# in the frame of the inner finger
_PAD = np.array([0.0, -0.0220203, 0.03242])
_PAD_SIZE = (0.022, 0.00635, 0.0375)
_LEVER_M = float(np.hypot(*_INNER_FINGER[1:]))


def _pad_face_m() -> float:
    """Return the distance of a pad's face from the axis of its finger along y [m]."""
    return float(-_PAD[1] + _PAD_SIZE[1] / 2)


@cache
def robotiq_2f85() -> GripperModel:
    """Return the gripper; its pads touch when it is closed."""
    with np.load(_FILE) as data:
        names = [key.removesuffix("_faces") for key in data if key.endswith("_faces")]
        meshes = {name: trimesh.Trimesh(data[f"{name}_vertices"], data[f"{name}_faces"]) for name in names}
    linkage = Parallelogram(lever_m=_LEVER_M, offset_m=_pad_face_m() - float(_OUTER_KNUCKLE[1]))
    open_m = float(_OUTER_KNUCKLE[1] + _INNER_FINGER[1]) - _pad_face_m()
    closed = rotation_exp([-float(linkage.turn(open_m)), 0.0, 0.0])
    tip = trimesh.util.concatenate(
        [meshes["inner_finger"], trimesh.creation.box(_PAD_SIZE).apply_translation(_PAD)]
    ).apply_translation(_OUTER_KNUCKLE + closed @ _INNER_FINGER)
    outer = trimesh.util.concatenate([meshes["outer_knuckle"], meshes["outer_finger"].apply_translation(_OUTER_FINGER)])
    turning = [(outer, _OUTER_KNUCKLE), (meshes["inner_knuckle"], _INNER_KNUCKLE)]
    sides = [(1.0, np.eye(4)), (-1.0, make_pose(rotation_z(np.pi), np.zeros(3)))]
    return GripperModel(
        parts={
            RobotPart.HAND: meshes["base"],
            RobotPart.LEFT_FINGER: tip,
            RobotPart.RIGHT_FINGER: _placed(tip, sides[1][1]),
        },
        max_finger_m=open_m,
        is_symmetric=True,
        mounts_vary=True,
        linkage=linkage,
        knuckles=tuple(
            Knuckle(
                mesh=_placed(mesh, X_HS @ make_pose(closed, axis)),
                sign=sign,
                axis_H=transform_points(X_HS, axis[None])[0],
            )
            for sign, X_HS in sides
            for mesh, axis in turning
        ),
    )


def _placed(mesh: trimesh.Trimesh, X: Array) -> trimesh.Trimesh:
    return mesh.copy().apply_transform(X)
