"""Collisions of the arm with the static objects of a scene, computed with Drake's geometry engine.

Checked at their initial poses: the fixed bodies of articulations, and objects that must not be touched.
The gripper may touch all but the last group; the other links may touch nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import (
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    GeometrySet,
    ProximityProperties,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.families.task import Scene
from kinebench_drake.suites.scene.model import Collider, ColliderKind

# SAPIEN's cylinders and capsules lie along x, Drake's along z.
_X_ALONG_Z = make_pose(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.zeros(3))


@dataclass(frozen=True, slots=True, kw_only=True)
class Penetration:
    """Overlap of a link of the arm with an object of the scene."""

    step: int
    """Row of the path."""
    link: str
    """Name of the link."""
    object_name: str
    """Name of the object."""
    depth_m: float
    """Penetration depth."""


def _shape(collider: Collider) -> tuple[Shape, Array]:
    """Return Drake's shape of a collider and its pose (4, 4) in the collider's frame."""
    upright = np.eye(4)
    match collider.kind:
        case ColliderKind.BOX:
            return Box(*(2.0 * half for half in collider.size)), upright
        case ColliderKind.SPHERE:
            return Sphere(collider.size[0]), upright
        case ColliderKind.CYLINDER:
            return Cylinder(collider.size[0], 2.0 * collider.size[1]), _X_ALONG_Z
        case ColliderKind.CAPSULE:
            return Capsule(collider.size[0], 2.0 * collider.size[1]), _X_ALONG_Z
        case ColliderKind.HULL:
            points: Any = np.asarray(collider.points, dtype=np.float64).T
            return Convex(points=points, label="hull"), upright


class SceneGeometry:
    """The arm's links and a scene's static colliders in a Drake SceneGraph."""

    def __init__(self, plant: ArmPlant, scene: Scene) -> None:
        """Copy the links' collision geometry from the plant and add the scene's static colliders."""
        self._plant = plant
        self._graph: Any = SceneGraph()
        self._source = self._graph.RegisterSource("scene")
        self._frames: dict[str, Any] = {}
        self._names: dict[Any, str] = {}
        arm, tool = self._add_links()
        free, avoided = self._add_objects(scene)
        manager = self._graph.collision_filter_manager()
        links = GeometrySet([*arm, *tool])
        objects = GeometrySet([*free, *avoided])
        manager.Apply(CollisionFilterDeclaration().ExcludeWithin(links).ExcludeWithin(objects))
        manager.Apply(CollisionFilterDeclaration().ExcludeBetween(GeometrySet(tool), GeometrySet(free)))
        self._context: Any = self._graph.CreateDefaultContext()

    def _register(self, frame: Any, shape: Shape, X: Array, name: str) -> Any:
        instance = GeometryInstance(RigidTransform(X), shape, f"{name}_{len(self._names)}")
        instance.set_proximity_properties(ProximityProperties())
        key = self._graph.RegisterGeometry(self._source, frame, instance)
        self._names[key] = name
        return key

    def _add_links(self) -> tuple[list[Any], list[Any]]:
        """Register the moving links; return the geometry of the arm and of the tool."""
        plant = self._plant
        inspector = self._plant.query(self._plant.robot.rest_q).inspector()
        arm: list[Any] = []
        tool: list[Any] = []
        for key in inspector.GetAllGeometryIds(Role.kProximity):
            link = plant.drake.GetBodyFromFrameId(inspector.GetFrameId(key)).name()
            if not plant.chain.carries(link).any():
                continue
            if link not in self._frames:
                self._frames[link] = self._graph.RegisterFrame(self._source, GeometryFrame(link))
            X = inspector.GetPoseInFrame(key).GetAsMatrix4()
            own = self._register(self._frames[link], inspector.GetShape(key), X, link)
            (tool if link in plant.tool else arm).append(own)
        return arm, tool

    def _add_objects(self, scene: Scene) -> tuple[list[Any], list[Any]]:
        """Register the static colliders; return the geometry that the gripper may touch and that it must not."""
        free: list[Any] = []
        avoided: list[Any] = []
        for name, model in scene.models.items():
            if name in scene.avoided or model.articulated:
                for collider in model.bodies[0].colliders:
                    shape, X_CS = _shape(collider)
                    X = scene.poses[name] @ collider.X_BodyC @ X_CS
                    own = self._register(self._graph.world_frame_id(), shape, X, name)
                    (avoided if name in scene.avoided else free).append(own)
        return free, avoided

    def penetrations(self, q: Array, finger_width_m: Array) -> Iterator[Penetration]:
        """Yield the overlaps along a path of joint angles (N, 7) [rad] and finger widths (N,) [m]."""
        port = self._graph.get_source_pose_port(self._source)
        for step, (row, width) in enumerate(zip(q, finger_width_m, strict=True)):
            self._plant.set_posture(row, float(width))
            poses = FramePoseVector()
            for link, frame in self._frames.items():
                body = self._plant.drake.GetBodyByName(link)
                poses.set_value(frame, self._plant.drake.EvalBodyPoseInWorld(self._plant.context, body))
            port.FixValue(self._context, poses)
            query: Any = self._graph.get_query_output_port().Eval(self._context)
            for pair in query.ComputePointPairPenetration():
                names = self._names[pair.id_A], self._names[pair.id_B]
                link, name = names if names[0] in self._frames else names[::-1]
                yield Penetration(step=step, link=link, object_name=name, depth_m=float(pair.depth))
