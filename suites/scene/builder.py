"""Builders of ManiSkill cameras, actors and articulations, the latter from the arrays of asset models without files."""

from typing import Any

import numpy as np
import sapien
from mani_skill.render import ShaderConfig
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.building import ActorBuilder, ArticulationBuilder
from mani_skill.utils.structs import Actor, Articulation
from sapien.wrapper.articulation_builder import LinkBuilder

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, to_quaternion
from kinebench_drake.suites.scene.model import AssetModel, Collider, ColliderKind, RigidBody, SurfaceFinish, Visual

X_WB = make_pose(np.eye(3), [-0.615, 0.0, 0.0])
"""Pose (4, 4) of the robot base in the ManiSkill world [m]."""
CAMERA = "base_camera"
"""Name of the camera."""
NEAR_M = 0.01
FAR_M = 20.0
"""Distances between which a camera sees."""


def to_pose(X: Array) -> sapien.Pose:
    """Convert a pose (4, 4) to SAPIEN."""
    return sapien.Pose(X[:3, 3], to_quaternion(X[:3, :3]))


def sapien_from_opencv(X_AC: Array) -> Array:
    """Convert a camera pose (4, 4) from OpenCV's axes (z forward, x right) to SAPIEN's (x forward, y left, z up)."""
    R_CS = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    return X_AC @ make_pose(R_CS, np.zeros(3))


def camera_config(camera: Camera, shaders: ShaderConfig | None = None) -> CameraConfig:
    """Convert a camera to ManiSkill's configuration; without shaders it has ManiSkill's own."""
    return CameraConfig(
        CAMERA,
        pose=to_pose(sapien_from_opencv(X_WB @ camera.X_BC)),
        width=camera.width,
        height=camera.height,
        near=NEAR_M,
        far=FAR_M,
        intrinsic=camera.K,
        shader_config=shaders,
    )


def _render_material(surface: SurfaceFinish) -> sapien.render.RenderMaterial:
    material = sapien.render.RenderMaterial()
    material.base_color = [*surface.color, 1.0]
    material.roughness = surface.roughness
    material.metallic = surface.metallic
    material.specular = surface.specular
    if surface.texture is not None:
        opaque = np.full((*surface.texture.shape[:2], 1), 255, np.uint8)
        image = np.concatenate([surface.texture, opaque], axis=-1)
        material.base_color_texture = sapien.render.RenderTexture2D(
            np.ascontiguousarray(image), "R8G8B8A8Unorm", mipmap_levels=6, srgb=True
        )
    return material


def _render_shape(visual: Visual) -> sapien.render.RenderShapeTriangleMesh:
    mesh = visual.mesh
    shape = sapien.render.RenderShapeTriangleMesh(
        mesh.vertices.astype(np.float32),
        mesh.faces.astype(np.uint32),
        mesh.normals.astype(np.float32),
        mesh.uv.astype(np.float32),
        _render_material(visual.surface),
    )
    shape.local_pose = to_pose(visual.X_BodyV)
    return shape


def _collision_shape(collider: Collider, material: sapien.physx.PhysxMaterial) -> sapien.physx.PhysxCollisionShape:
    physx = sapien.physx
    match collider.kind:
        case ColliderKind.BOX:
            return physx.PhysxCollisionShapeBox(collider.size, material)
        case ColliderKind.SPHERE:
            return physx.PhysxCollisionShapeSphere(collider.size[0], material)
        case ColliderKind.CYLINDER:
            return physx.PhysxCollisionShapeCylinder(*collider.size, material)
        case ColliderKind.CAPSULE:
            return physx.PhysxCollisionShapeCapsule(*collider.size, material)
        case ColliderKind.HULL:
            points = np.asarray(collider.points, dtype=np.float32)
            return physx.PhysxCollisionShapeConvexMesh(vertices=points, scale=[1.0, 1.0, 1.0], material=material)


class _BodyBuilder:
    """Mixin for SAPIEN's builders that makes visuals and colliders directly from a body's arrays."""

    body: RigidBody
    collision_groups: list[int]

    def attach_colliders(self, component: Any) -> Any:
        """Attach the body's colliders to a PhysX component and return it."""
        m = self.body.material
        material = sapien.physx.PhysxMaterial(m.static_friction, m.dynamic_friction, m.restitution)
        for collider in self.body.colliders:
            shape = _collision_shape(collider, material)
            shape.local_pose = to_pose(collider.X_BodyC)
            shape.set_collision_groups(self.collision_groups)
            shape.set_density(m.density)
            component.attach(shape)
        return component

    def build_render_component(self) -> sapien.render.RenderBodyComponent:
        """Make the render component with the body's visuals."""
        component = sapien.render.RenderBodyComponent()
        for visual in self.body.visuals:
            component.attach(_render_shape(visual))
        component.name = self.body.name
        return component


class _ActorBuilder(_BodyBuilder, ActorBuilder):  # type: ignore[misc]
    def build_physx_component(self, link_parent: Any = None) -> Any:
        component = self.attach_colliders(super().build_physx_component(link_parent))
        if self.physx_body_type == "dynamic":
            component.linear_damping = self.body.material.linear_damping
            component.angular_damping = self.body.material.angular_damping
        return component

    def build_entity(self) -> Any:
        entity = sapien.Entity()
        if self.scene.can_render():
            entity.add_component(self.build_render_component())
        entity.add_component(self.build_physx_component())
        entity.name = self.name
        return entity


class _LinkBuilder(_BodyBuilder, LinkBuilder):  # type: ignore[misc]
    def __init__(self, index: int, parent: "_LinkBuilder | None", body: RigidBody) -> None:
        super().__init__(index, parent)
        self.body = body
        self.visual_records = [None]  # ManiSkill renders only links that have some; the visuals come from the body

    def build_physx_component(self, link_parent: Any = None) -> Any:
        component = self.attach_colliders(super().build_physx_component(link_parent))
        component.disable_gravity = self.body.joint is not None
        return component


def build_actor(scene: Any, name: str, body: RigidBody, X_WA: Array, *, physics: str) -> Actor:
    """Build a single rigid body.

    Args:
        X_WA: pose (4, 4) in the ManiSkill world [m].
        physics: "dynamic", "kinematic" or "static".
    """
    builder = _ActorBuilder()
    builder.scene = scene
    builder.body = body
    builder.set_scene_idxs([0])
    builder.set_physx_body_type(physics)
    builder.initial_pose = to_pose(X_WA)
    return builder.build(name)


def build_articulation(scene: Any, name: str, model: AssetModel, X_WM: Array) -> Articulation:
    """Build bodies with joints, the first one fixed at the pose (4, 4) in the ManiSkill world.

    Arguments as of `build_actor`.
    """
    builder = ArticulationBuilder()
    builder.scene = scene
    builder.set_scene_idxs([0])
    builder.initial_pose = to_pose(X_WM)
    root = None
    for body in model.bodies:
        link = _LinkBuilder(len(builder.link_builders), root, body)
        builder.link_builders.append(link)
        link.set_name(body.name)
        if body.joint is None:
            root = link
            continue
        joint = body.joint
        link.set_joint_name(f"{body.name}_joint")
        link.set_joint_properties(
            joint.kind.value,
            limits=[[0.0, joint.upper]],
            pose_in_parent=to_pose(joint.X_ParentJ),
            pose_in_child=to_pose(joint.X_BodyJ),
            damping=joint.damping,
        )
    articulation = builder.build(name, fix_root_link=True)
    for body, active in zip(model.bodies[1:], articulation.active_joints, strict=True):
        if body.joint is not None:
            active.set_friction(body.joint.friction)
    return articulation
