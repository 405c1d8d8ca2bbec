"""A stage that can cheat: it draws the gripper warped or a second one, hides links, or moves its camera.

Everything is rendered: a drawn gripper is made of the robot's own meshes and materials, is lit, casts shadows, and
hides what is behind it.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, to_quaternion, transform_points
from kinebench_drake.models.panda.robot import HAND_LINK
from kinebench_drake.suites.simulator import GRIPPER_LINKS, CameraImage, Simulator

Warp = Callable[[Array], Array]
"""Where points (N, 3) of the gripper go, in the frame of panda_hand [m]."""
_NUDGE_M = 1e-4  # step of the finite differences that turn normals


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderFault:
    """A gripper to draw."""

    warp: Warp
    """Its shape."""
    X_HP: Array
    """(4, 4) where it is drawn, as seen from the robot's hand [m]."""
    replaces: bool
    """Whether the robot's own gripper is not drawn."""


class FaultSimulator(Simulator):
    """See the module."""

    _costume: RenderFault | None = None

    def __enter__(self) -> "FaultSimulator":
        return self

    def wear(self, costume: RenderFault) -> None:
        """Draw this in the pictures from now on."""
        self._costume = costume

    def aim(self, camera: Camera) -> None:
        """Film from elsewhere, with the same lens."""
        from kinebench_drake.suites.tasks.environment import X_WB, sapien_from_opencv

        X_WS = sapien_from_opencv(X_WB @ camera.X_BC)
        rendering = self._env._sensors[self._camera_name].camera._render_cameras[0]
        rendering.set_local_pose(self._pose_class(X_WS[:3, 3], to_quaternion(X_WS[:3, :3])))
        self.camera = camera

    def be_honest(self, camera: Camera) -> None:
        """Draw everything as it is, from `camera`."""
        self._costume = None
        self.draw(GRIPPER_LINKS, visible=True)
        self.aim(camera)

    def picture(self) -> CameraImage:
        """See `Stage.picture`; the mask is that of the gripper that stands for the robot's own."""
        costume = self._costume
        if costume is None:
            return super().picture()
        scene = self._env.scene.sub_scenes[0]
        puppet = self._puppet(costume.warp, GRIPPER_LINKS)
        X_WP = invert(self._X_BW) @ self.link_pose(HAND_LINK) @ costume.X_HP
        puppet.set_pose(self._pose_class(X_WP[:3, 3], to_quaternion(X_WP[:3, :3])))
        scene.add_entity(puppet)
        self.draw(GRIPPER_LINKS, visible=not costume.replaces)
        try:
            picture = super().picture()
            if costume.replaces:
                labels = self._env._sensors[self._camera_name].get_obs(
                    rgb=False, depth=False, position=False, segmentation=True
                )["segmentation"]
                mask = labels[0, ..., 0].cpu().numpy() == puppet.per_scene_id
                picture = replace(picture, mask=mask, robot=picture.robot | mask)
        finally:
            scene.remove_entity(puppet)
            self.draw(GRIPPER_LINKS, visible=True)
        return picture

    def _puppet(self, warp: Warp, links: Collection[str]) -> Any:
        """An entity of the warped meshes of some links as they stand now, in the frame of panda_hand."""
        import sapien

        body = sapien.render.RenderBodyComponent()
        X_HB = invert(self.link_pose(HAND_LINK))
        for name, link in self._env.agent.robot.links_map.items():
            own = link._objs[0].entity.find_component_by_type(sapien.render.RenderBodyComponent)
            if name not in links or own is None:
                continue
            for shape in own.render_shapes:
                X_HS = X_HB @ self.link_pose(name) @ np.asarray(shape.local_pose.to_transformation_matrix(), float)
                for part in shape.parts:
                    p_H = transform_points(X_HS, part.get_vertices() * shape.scale)
                    normal_H = _turned(warp, p_H, part.get_vertex_normal() @ X_HS[:3, :3].T)
                    body.attach(
                        sapien.render.RenderShapeTriangleMesh(
                            warp(p_H).astype(np.float32),
                            part.get_triangles(),
                            normal_H.astype(np.float32),
                            part.get_vertex_uv(),
                            part.material,
                        )
                    )
        puppet = sapien.Entity()
        puppet.add_component(body)
        return puppet


def _turned(warp: Warp, p: Array, normal: Array) -> Array:
    """Unit normals (N, 3) of the warped surface: they go with the inverse transpose of the warp's Jacobian."""
    columns = [(warp(p + step) - warp(p - step)) / (2 * _NUDGE_M) for step in _NUDGE_M * np.eye(3)]
    J = np.stack(columns, axis=-1)
    turned = np.linalg.solve(np.swapaxes(J, 1, 2), normal[..., None])[..., 0]
    return np.asarray(turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12))
