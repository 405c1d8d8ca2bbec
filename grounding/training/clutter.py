"""Things that are not the robot's own: loose objects, other robots, and what people mount on the hand and the arm."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinebench_drake.geometry import Array, make_pose, rotation_exp
from kinebench_drake.models.panda.robot import source_urdf

FAR_AWAY = np.array([0.0, 0.0, -50.0])
"""Position of hidden actors [m]."""
_OTHER_ROBOTS = (
    *("xarm7/xarm7.urdf", "so100/so100.urdf", "koch/follower_arm_v1.1.urdf", "fetch/fetch.urdf"),
    *("g1_humanoid/g1_simplified_upper_body.urdf", "xarm7/xarm7_ability_right_hand.urdf"),
)
"""Descriptions below the installed mani_skill package's robots."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """Actor that moves with a link."""

    actor: Any
    link: str
    X_LA: Array
    """(4, 4) pose of the actor in the link frame [m]."""


class Clutter:
    """Builder of random actors in a SAPIEN scene."""

    def __init__(self, sapien: Any, scene: Any, rng: np.random.Generator, material: Any) -> None:
        """Build in `scene`, with materials from the function `material`."""
        self._sapien, self._scene, self._rng, self._material = sapien, scene, rng, material

    def box(self, half: tuple[float, ...], position: tuple[float, ...], material: Any = None) -> Any:
        """Return a new box with half extents `half` [m] at `position` [m]."""
        builder = self._scene.create_actor_builder()
        builder.add_box_visual(half_size=half, material=material or self._material())
        builder.set_initial_pose(self._sapien.Pose(position))
        return builder.build_kinematic(name="room")

    def object(self, half: float) -> Any:
        """Return a new hidden primitive with half thickness `half` [m]."""
        rng = self._rng
        builder = self._scene.create_actor_builder()
        material, length = self._material(), float(half * np.exp(rng.uniform(-0.7, 1.4)))
        kind = rng.integers(5)
        if kind == 0:
            builder.add_sphere_visual(radius=half, material=material)
        elif kind == 1:
            builder.add_capsule_visual(radius=half, half_length=length, material=material)
        elif kind == 2:
            builder.add_cylinder_visual(radius=half, half_length=length, material=material)
        else:
            builder.add_box_visual(
                half_size=[length, half, float(half * np.exp(rng.uniform(-0.7, 1.0)))], material=material
            )
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
        angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(0.6, 1.2)
        position = [0.3 + distance * np.cos(angle), distance * np.sin(angle), rng.uniform(-0.1, 0.0)]
        turn = rng.uniform(-np.pi, np.pi)
        robot.set_root_pose(self._sapien.Pose(position, [np.cos(turn / 2), 0, 0, np.sin(turn / 2)]))

    def attachments(self) -> list[Attachment]:
        """Return new mounts and cameras on the hand, cables along the arm, and pads on the fingers; often none."""
        rng = self._rng
        attachments = []
        if rng.random() < 0.35:  # a camera and its mount: boxes before or behind the wide side of the hand
            side = float(rng.choice([-1.0, 1.0]))
            material = self._material() if rng.random() < 0.4 else self._dark_material()
            for _ in range(rng.integers(1, 4)):
                half = tuple(float(h) for h in rng.uniform([0.008, 0.012, 0.006], [0.03, 0.06, 0.03]))
                p_HA = [side * (0.032 + half[0] + rng.uniform(0, 0.03)), rng.normal(0, 0.02), rng.uniform(-0.05, 0.06)]
                attachments.append(self._attach("panda_hand", half, p_HA, rng.normal(0, 0.2, 3), material))
        if rng.random() < 0.2:  # a cable
            material, angle = self._dark_material(), rng.uniform(-np.pi, np.pi)
            for link, height in (("panda_link5", -0.15), ("panda_link5", -0.05), ("panda_link7", 0.05)):
                p_LA = [0.07 * np.cos(angle), 0.07 * np.sin(angle), height + rng.normal(0, 0.03)]
                attachments.append(self._attach(link, (0.005, 0.005, 0.06), p_LA, rng.normal(0, 0.4, 3), material))
        if rng.random() < 0.25:  # other pads or fingers over Franka's own
            material = self._material()
            half = tuple(float(h) for h in rng.uniform([0.008, 0.003, 0.01], [0.014, 0.009, 0.03]))
            outward = rng.uniform(0.0, 0.008)
            for link, sign in (("panda_leftfinger", 1.0), ("panda_rightfinger", -1.0)):
                p_LA = [0.0, sign * (half[1] + outward), 0.054 - rng.uniform(-0.01, 0.6) * half[2]]
                attachments.append(self._attach(link, half, p_LA, np.zeros(3), material))
        return attachments

    def _dark_material(self) -> Any:
        material = self._sapien.render.RenderMaterial()
        material.set_base_color([*(self._rng.uniform(0.0, 0.25) * np.ones(3)), 1.0])
        material.set_roughness(float(self._rng.uniform(0.2, 1.0)))
        return material

    def _attach(self, link: str, half: tuple[float, ...], p_LA: Any, turn: Array, material: Any) -> Attachment:
        actor = self.box(half, tuple(FAR_AWAY), material)
        return Attachment(actor=actor, link=link, X_LA=make_pose(rotation_exp(turn), p_LA))

    def place(self, attachments: list[Attachment], links: Mapping[str, Any]) -> None:
        """Move attachments to where their links are."""
        for attachment in attachments:
            X_BL = links[attachment.link].entity_pose.to_transformation_matrix().astype(np.float64)
            attachment.actor.set_pose(self._sapien.Pose(X_BL @ attachment.X_LA))
