"""Simulator that renders faults: a warped or second gripper, hidden links, a moved camera.

The additional gripper consists of the robot's own meshes and materials, is lit, casts shadows and occludes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from typing_extensions import override

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, to_quaternion, transform_points
from kinebench_drake.models.panda.description import HAND_LINK
from kinebench_drake.suites.simulator import GRIPPER_LINKS, CameraImage, Simulator
from training.viewpoint import place_camera

Warp = Callable[[Array], Array]
"""Maps points (N, 3) of the gripper to warped ones, in the frame of panda_hand [m]."""
_STEP_M = 1e-4
"""Step of the finite differences for normals [m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderFault:
    """Additional gripper to render."""

    warp: Warp
    """Change of shape."""
    X_HP: Array
    """(4, 4) pose in the frame of panda_hand [m]."""
    replaces: bool
    """True if it replaces the robot's gripper, which is hidden."""


class FaultSimulator(Simulator):
    """Simulator with faults in its images; the physics is unchanged."""

    _fault: RenderFault | None = None

    def set_fault(self, fault: RenderFault) -> None:
        """Render an additional gripper in all further images."""
        self._fault = fault

    def clear_faults(self, camera: Camera) -> None:
        """Render without faults, from `camera`."""
        self._fault = None
        self.set_visible(GRIPPER_LINKS, visible=True)
        place_camera(self, camera)

    @override
    def render(self) -> CameraImage:
        """Render the current state; the mask is that of the replacing gripper, if there is one."""
        fault = self._fault
        if fault is None:
            return super().render()
        scene = self.env.scene.sub_scenes[0]
        gripper = self._warped_gripper(fault.warp)
        X_WP = invert(self._X_BW) @ self.link_pose(HAND_LINK) @ fault.X_HP
        gripper.set_pose(self._pose_class(X_WP[:3, 3], to_quaternion(X_WP[:3, :3])))
        scene.add_entity(gripper)
        self.set_visible(GRIPPER_LINKS, visible=not fault.replaces)
        try:
            image = super().render()
            if fault.replaces:
                labels = self.env._sensors[self._camera_name].get_obs(
                    rgb=False, depth=False, position=False, segmentation=True
                )["segmentation"]
                mask = labels[0, ..., 0].cpu().numpy() == gripper.per_scene_id
                image = replace(image, mask=mask, robot=image.robot | mask)
        finally:
            scene.remove_entity(gripper)
            self.set_visible(GRIPPER_LINKS, visible=True)
        return image

    def _warped_gripper(self, warp: Warp) -> Any:
        """Return an entity with the warped meshes of the gripper in its current pose, in the frame of panda_hand."""
        import sapien

        body = sapien.render.RenderBodyComponent()
        X_HB = invert(self.link_pose(HAND_LINK))
        for name, link in self.env.agent.robot.links_map.items():
            own = link._objs[0].entity.find_component_by_type(sapien.render.RenderBodyComponent)
            if name not in GRIPPER_LINKS or own is None:
                continue
            for shape in own.render_shapes:
                X_HS = X_HB @ self.link_pose(name) @ np.asarray(shape.local_pose.to_transformation_matrix(), float)
                for part in shape.parts:
                    p_H = transform_points(X_HS, part.get_vertices() * shape.scale)
                    normal_H = _warp_normals(warp, p_H, part.get_vertex_normal() @ X_HS[:3, :3].T)
                    body.attach(
                        sapien.render.RenderShapeTriangleMesh(
                            warp(p_H).astype(np.float32),
                            part.get_triangles(),
                            normal_H.astype(np.float32),
                            part.get_vertex_uv(),
                            part.material,
                        )
                    )
        entity = sapien.Entity()
        entity.add_component(body)
        return entity


def _warp_normals(warp: Warp, p: Array, normal: Array) -> Array:
    """Return unit normals (N, 3) of the warped surface, by the inverse transpose of the warp's Jacobian."""
    columns = [(warp(p + step) - warp(p - step)) / (2 * _STEP_M) for step in _STEP_M * np.eye(3)]
    J = np.stack(columns, axis=-1)
    warped = np.linalg.solve(np.swapaxes(J, 1, 2), normal[..., None])[..., 0]
    return np.asarray(warped / np.maximum(np.linalg.norm(warped, axis=1, keepdims=True), 1e-12))
