"""Link poses and lowest points of the arm for whole arrays of postures.

Forward kinematics here is a product of exponentials (R. W. Brockett, "Robotic manipulators and the product of
exponentials formula", 1984) with the axes of the plant's zero posture, so that proofs do not depend on the code that
they test.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from pydrake.geometry import Box, Convex, Mesh
from pydrake.multibody.tree import BodyIndex

from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.robot import N_JOINTS

_OPEN_M = 0.04
"""A gap within the range of every such gripper [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solid:
    """One convex collision geometry, fixed to a link."""

    joint: int
    """Number of arm joints between the base and the link."""
    side: float
    """Displacement of the link along the hand's y axis / gap between the pads: 1/2, -1/2 or 0."""
    X_BS: Array
    """(4, 4) pose in the base at posture zero with closed fingers [m]."""
    vertices: Array
    """(V, 3) corners of its hull in its own frame [m]."""
    radius: float
    """Greatest distance of a vertex from the origin [m]."""


class Body:
    """The arm's joint axes and collision geometry, copied from a plant."""

    def __init__(self, plant: ArmPlant) -> None:
        """Copy from `plant`, whose context is left at posture zero with closed fingers."""
        drake = plant.drake
        plant.set_posture(np.zeros(N_JOINTS), 0.0)
        joints = [drake.GetJointByName(name) for name in plant.robot.joints]
        frames = [_pose(j.frame_on_child(), plant.context) for j in joints]
        self.axes = np.array([X[:3, :3] @ j.revolute_axis() for X, j in zip(frames, joints, strict=True)])
        """(7, 3) joint axes in B at posture zero."""
        self.points = np.array([X[:3, 3] for X in frames])
        """(7, 3) a point on each axis [m]."""
        self.X_BG = plant.forward(np.zeros(N_JOINTS))
        """(4, 4) TCP in B at posture zero [m]."""
        depth = {plant.robot.base_link: 0, **{j.child_body().name(): i + 1 for i, j in enumerate(joints)}}
        inspector: Any = plant.diagram.GetSubsystemByName("scene_graph").model_inspector()
        plant.set_posture(np.zeros(N_JOINTS), 0.0)
        closed = {b.name(): _pose(b.body_frame(), plant.context) for b in _bodies(drake)}
        plant.set_posture(np.zeros(N_JOINTS), _OPEN_M)
        opened = {b.name(): _pose(b.body_frame(), plant.context) for b in _bodies(drake)}
        self._hand_y = self.X_BG[:3, 1]
        self.solids = tuple(
            _Solid(
                joint=_depth(drake, body, depth),
                side=float((opened[body.name()] - closed[body.name()])[:3, 3] @ self._hand_y) / _OPEN_M,
                X_BS=closed[body.name()] @ inspector.GetPoseInFrame(geometry).GetAsMatrix4(),
                vertices=(vertices := shape_vertices(inspector.GetShape(geometry))),
                radius=float(np.linalg.norm(vertices, axis=-1).max()),
            )
            for body in _bodies(drake)
            if body.name() not in ("world", plant.robot.base_link)
            for geometry in drake.GetCollisionGeometriesForBody(body)
        )
        """Collision geometries of all links but the base link."""
        plant.set_posture(np.zeros(N_JOINTS))

    def links(self, q: Array) -> Array:
        """Return displacements (N, 8, 4, 4) from posture zero to `q` (N, 7) [rad] of the links behind 0..7 joints."""
        X = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        out = [X]
        for j in range(N_JOINTS):
            X = X @ _about(self.axes[j], self.points[j], q[:, j])
            out.append(X)
        return np.stack(out, axis=1)

    def forward(self, q: Array) -> Array:
        """Return TCP poses X_BG (N, 4, 4) [m] of postures `q` (N, 7) [rad]."""
        return np.asarray(self.links(q)[:, -1] @ self.X_BG)

    def lowest(self, q: Array, finger_width_m: Array) -> Array:
        """Return the height (N,) [m] in B of the arm's lowest point at postures `q` (N, 7) [rad] and gaps (N,) [m]."""
        moved = self.links(q)
        return self._lowest(self.solids, moved, finger_width_m)

    def lowest_of_gripper(self, X_BG: Array, finger_width_m: Array) -> Array:
        """Return the height (N,) [m] in B of the lowest point of hand and fingers at TCP poses (N, 4, 4)."""
        moved = np.broadcast_to((X_BG @ np.linalg.inv(self.X_BG))[:, None], (len(X_BG), N_JOINTS + 1, 4, 4))
        gripper = [s for s in self.solids if s.joint == N_JOINTS]
        return self._lowest(gripper[1:], moved, finger_width_m)  # the first belongs to link 7

    def _lowest(self, solids: Sequence[_Solid], moved: Array, width: Array) -> Array:
        height = np.full(len(moved), np.inf)
        for solid in solids:
            X = moved[:, solid.joint] @ solid.X_BS
            z = X[:, 2, 3] + solid.side * width * (moved[:, solid.joint, 2, :3] @ self._hand_y)
            near = np.flatnonzero(z - solid.radius < height)
            if len(near):
                height[near] = np.minimum(height[near], z[near] + (X[near, 2, :3] @ solid.vertices.T).min(axis=-1))
        return np.asarray(height)


def _bodies(drake: Any) -> list[Any]:
    return [drake.get_body(BodyIndex(i)) for i in range(drake.num_bodies())]


def _pose(frame: Any, context: Any) -> Array:
    return np.asarray(frame.CalcPoseInWorld(context).GetAsMatrix4())


def _depth(drake: Any, body: Any, depth: dict[str, int]) -> int:
    """Return the number of arm joints between the base and a body."""
    inbound = {j.child_body().name(): j for j in (drake.get_joint(i) for i in drake.GetJointIndices())}
    while body.name() not in depth:
        body = inbound[body.name()].parent_body()
    return depth[body.name()]


def _about(axis: Array, point: Array, angle: Array) -> Array:
    """Return rotations (N, 4, 4) about a line in space by `angle` (N,) [rad]."""
    R = rotation_exp(angle[:, None] * axis)
    return make_pose(R, point - R @ point)


def shape_vertices(shape: Any) -> Array:
    """Return the corners (V, 3) of the hull of a box or a mesh in its own frame [m].

    Raises:
        InputError: the shape is neither.
    """
    if isinstance(shape, Box):
        return np.asarray(np.array(list(product((-0.5, 0.5), repeat=3))) * shape.size())
    if isinstance(shape, Mesh | Convex):
        hull = shape.GetConvexHull()
        return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    raise InputError(f"collision geometry {type(shape).__name__} is not supported; expected boxes and meshes")
