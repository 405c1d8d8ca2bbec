"""Actors of a SAPIEN scene that are not the robot's own: loose things, other robots, mounts on the hand and the arm."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from kinebench_drake.models.panda.description import source_urdf
from training.layout import (
    FAR_AWAY,
    Attachment,
    SolidKind,
    Surface,
    random_solid,
    random_surface,
)

_OTHER_ROBOTS = (
    *("xarm7/xarm7.urdf", "so100/so100.urdf", "koch/follower_arm_v1.1.urdf", "fetch/fetch.urdf"),
    *("g1_humanoid/g1_simplified_upper_body.urdf", "xarm7/xarm7_ability_right_hand.urdf"),
)
"""Descriptions below the installed mani_skill package's robots."""


_TEXTURE_M = 0.1
"""Size of a texture on a mesh [m]."""


class Clutter:
    """Builder of random actors in a SAPIEN scene."""

    def __init__(self, sapien: Any, scene: Any, rng: np.random.Generator) -> None:
        """Build in `scene`."""
        self._sapien = sapien
        self._scene = scene
        self._rng = rng

    def apply(self, surface: Surface, material: Any) -> Any:
        """Give a material the look of a surface, and return it."""
        if surface.texture is not None:
            texture = self._sapien.render.RenderTexture2D(surface.texture, "R8G8B8A8Unorm", srgb=True)
            material.set_base_color_texture(texture)
        material.set_base_color([*surface.colour, 1.0])
        material.set_roughness(surface.roughness)
        if surface.metallic is not None:
            material.set_metallic(surface.metallic)
        if surface.specular is not None:
            material.set_specular(surface.specular)
        return material

    def _material(self, surface: Surface | None = None) -> Any:
        return self.apply(surface or random_surface(self._rng), self._sapien.render.RenderMaterial())

    def box(self, half: tuple[float, ...], position: tuple[float, ...], surface: Surface | None = None) -> Any:
        """Return a new box with half extents `half` [m] at `position` [m]."""
        builder = self._scene.create_actor_builder()
        builder.add_box_visual(half_size=half, material=self._material(surface))
        builder.set_initial_pose(self._sapien.Pose(position))
        return builder.build_kinematic(name="room")

    def body(self, mesh: trimesh.Trimesh, surface: Surface) -> Any:
        """Return a new actor with the shape of a mesh [m]."""
        builder = self._scene.create_actor_builder()
        builder.set_initial_pose(self._sapien.Pose(FAR_AWAY))
        actor = builder.build_kinematic(name="body")
        flat = mesh.vertices[mesh.faces].reshape(-1, 3)
        shape = self._sapien.render.RenderShapeTriangleMesh(
            vertices=flat.astype(np.float32),
            triangles=np.arange(len(flat), dtype=np.uint32).reshape(-1, 3),
            normals=np.repeat(mesh.face_normals, 3, axis=0).astype(np.float32),
            uvs=flat[:, :2].astype(np.float32) / _TEXTURE_M,
            material=self._material(surface),
        )
        render_body = self._sapien.render.RenderBodyComponent()
        render_body.attach(shape)
        actor.add_component(render_body)
        return actor

    def object(self, half: float) -> Any:
        """Return a new hidden primitive with half thickness `half` [m]."""
        builder = self._scene.create_actor_builder()
        material = self._material()
        solid = random_solid(self._rng, half)
        length = solid.half[0]
        if solid.kind is SolidKind.SPHERE:
            builder.add_sphere_visual(radius=half, material=material)
        elif solid.kind is SolidKind.CAPSULE:
            builder.add_capsule_visual(radius=half, half_length=length, material=material)
        elif solid.kind is SolidKind.CYLINDER:
            builder.add_cylinder_visual(radius=half, half_length=length, material=material)
        else:
            builder.add_box_visual(half_size=solid.half, material=material)
        builder.set_initial_pose(self._sapien.Pose(FAR_AWAY))
        return builder.build_kinematic(name="object")

    def other_robot(self) -> None:
        """Add another robot in a random posture, away from the Panda."""
        rng = self._rng
        path = source_urdf().parents[1] / Path(str(rng.choice(_OTHER_ROBOTS)))
        loader = self._scene.create_urdf_loader()
        loader.fix_root_link = True
        robot = loader.load(str(path))
        limits = np.clip(robot.get_qlimits(), -np.pi, np.pi)
        robot.set_qpos(rng.uniform(0.6 * limits[:, 0], 0.6 * limits[:, 1]).astype(np.float32))
        angle = rng.uniform(-np.pi, np.pi)
        distance = rng.uniform(0.6, 1.2)
        position = [0.3 + distance * np.cos(angle), distance * np.sin(angle), rng.uniform(-0.1, 0.0)]
        turn = rng.uniform(-np.pi, np.pi)
        robot.set_root_pose(self._sapien.Pose(position, [np.cos(turn / 2), 0, 0, np.sin(turn / 2)]))

    def add_attachments(self, attachments: Sequence[Attachment]) -> list[tuple[Any, Attachment]]:
        """Return attachments with new actors."""
        return [(self.box(a.half, tuple(FAR_AWAY), a.surface), a) for a in attachments]

    def place(self, attachments: list[tuple[Any, Attachment]], links: Mapping[str, Any]) -> None:
        """Move attachments to where their links are."""
        for actor, attachment in attachments:
            X_BL = links[attachment.link].entity_pose.to_transformation_matrix().astype(np.float64)
            actor.set_pose(self._sapien.Pose(X_BL @ attachment.X_LA))
