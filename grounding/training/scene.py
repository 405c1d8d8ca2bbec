"""Random SAPIEN scenes: a Panda in random poses and paint, with random surroundings, lights and cameras."""

from typing import Any

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.environment import native
from kinebench_drake.geometry import Array, invert, make_pose, orthonormalize, transform_points
from kinebench_drake.grounding.crop import GRIPPER_CENTRE_H
from kinebench_drake.grounding.training.clutter import FAR_AWAY, Clutter
from kinebench_drake.grounding.training.texture import random_photograph, random_texture
from kinebench_drake.grounding.training.viewpoint import ViewBounds, random_camera
from kinebench_drake.models.panda.robot import GRIPPER, LINK_OF, RobotPart, source_urdf
from kinebench_drake.models.perception.frame import RENDERED_DEPTH_BIAS_M, RenderedFrame, label_parts, varied_camera

IMAGE_SIZE = 384
"""Width and height of frames [px]."""

_TABLE_HALF = (0.9, 1.2, 0.02)
_OPENCV_FROM_SAPIEN = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_MINIMAL = 0.5  # share of scenes with the fast shader, without shadows and reflections
_NEAR_BENCHMARK = 0.2  # share of frames from near the benchmark camera
_FAR_M = 15.0
_REST = np.array([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.785])
_SPREAD_RAD = np.array([0.6, 0.5, 0.4, 0.5, 0.5, 0.5, 1.2])


class TrainingScene:
    """Table, walls, loose objects, lights and a Panda; `frame` draws new poses for all of them and renders."""

    def __init__(self, rng: np.random.Generator, *, handless: bool = False) -> None:
        """Build the scene from `rng`; a `handless` scene hides hand and fingers, as some generated videos do."""
        native.prepare_vulkan()
        import sapien

        self._sapien: Any = sapien
        self._rng = rng
        self._minimal = bool(rng.random() < _MINIMAL)
        sapien.render.set_camera_shader_dir("minimal" if self._minimal else "default")
        if self._minimal:
            sapien.render.set_picture_format("Color", "r8g8b8a8unorm")
            sapien.render.set_picture_format("ColorRaw", "r8g8b8a8unorm")
            sapien.render.set_picture_format("PositionSegmentation", "r16g16b16a16sint")
        else:
            sapien.render.set_picture_format("Color", "r32g32b32a32sfloat")
            sapien.render.set_picture_format("Position", "r32g32b32a32sfloat")
        self._scene = sapien.Scene()
        self._clutter = Clutter(sapien, self._scene, rng, self._material)
        self._table_z = 0.0 if rng.random() < 0.6 else float(rng.uniform(-0.35, 0.0))
        self._bounds = self._add_room()
        self._add_lights()
        sizes = [float(rng.uniform(0.05, 0.15) if rng.random() < 0.12 else rng.uniform(0.01, 0.05)) for _ in range(12)]
        self._objects = [(self._clutter.object(half), half) for half in sizes]
        half = float(rng.uniform(0.008, 0.036))
        self._payload = self._clutter.object(half), half
        if rng.random() < 0.2:
            self._clutter.other_robot()
        self._add_robot(handless)
        self._attachments = [] if handless else self._clutter.attachments()
        self._component: Any = None

    def _material(self) -> Any:
        rng, render = self._rng, self._sapien.render
        material = render.RenderMaterial()
        kind = rng.random()
        if kind < 0.45:
            material.set_base_color_texture(render.RenderTexture2D(random_texture(rng), "R8G8B8A8Unorm", srgb=True))
        elif kind < 0.6:
            photograph = random_photograph(rng, 256)
            pixels = np.dstack([photograph, np.full(photograph.shape[:2], 255, np.uint8)])
            material.set_base_color_texture(render.RenderTexture2D(pixels, "R8G8B8A8Unorm", srgb=True))
        elif kind < 0.75:  # white, grey and black things are frequent where robots work, and look like one
            material.set_base_color([*np.clip(rng.uniform(0, 1) + rng.normal(0, 0.02, 3), 0, 1), 1.0])
        else:
            material.set_base_color([*rng.uniform(0, 1, 3), 1.0])
        material.set_roughness(float(rng.uniform(0.1, 1.0)))
        material.set_metallic(float(rng.choice([0.0, 0.0, 0.0, 0.7])))
        material.set_specular(float(rng.uniform(0, 0.8)))
        return material

    def _add_room(self) -> ViewBounds:
        """Add table top, floor, pedestal and sometimes walls; return where cameras may stand."""
        rng, z = self._rng, self._table_z
        lower, upper = np.array([-3.0, -3.0, z + 0.03]), np.full(3, 3.0)
        if z == 0.0 and rng.random() < 0.25:
            builder = self._scene.create_actor_builder()
            pose = self._sapien.Pose([0.615 - 0.12, 0, -0.9196429], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
            mesh = source_urdf().parents[3] / "utils/scene_builder/table/assets/table.glb"
            builder.add_visual_from_file(str(mesh), scale=[1.75] * 3, pose=self._sapien.Pose())
            builder.set_initial_pose(pose)
            builder.build_kinematic(name="room")
        else:
            length, width, thickness = (
                _TABLE_HALF[0] * rng.uniform(0.5, 1.0),
                _TABLE_HALF[1] * rng.uniform(0.5, 1.0),
                0.02,
            )
            behind = float(rng.uniform(-0.5, 0.1)) if z == 0.0 else float(rng.uniform(0.1, 0.3))
            self._clutter.box((length, width, thickness), (behind + length, float(rng.normal(0, 0.2)), z - thickness))
        if z < 0.0 or rng.random() < 0.2:  # a pedestal or a mounting plate
            height = max(-z, 0.02) / 2
            half = rng.uniform(0.1, 0.22, 2)
            self._clutter.box((half[0], half[1], height), (float(rng.normal(-0.05, 0.03)), 0.0, -height))
        self._clutter.box((4, 4, 0.01), (0, 0, min(-0.4, -0.93 + rng.uniform(-0.1, 0.4))))
        if rng.random() < 0.5:
            lower[0] = rng.uniform(-2.5, -0.5)
            self._clutter.box((0.02, 4, 3), (float(lower[0]) - 0.1, 0, 1))
        if rng.random() < 0.4:
            side, distance = float(rng.choice([-1, 1])), float(rng.uniform(0.8, 2.5))
            self._clutter.box((3, 0.02, 3), (0, side * (distance + 0.1), 1))
            lower[1], upper[1] = (-distance, 3.0) if side < 0 else (-3.0, distance)
        if rng.random() < 0.3:
            upper[0] = rng.uniform(1.4, 2.8)
            self._clutter.box((0.02, 4, 3), (float(upper[0]) + 0.1, 0, 1))
        return ViewBounds(tuple(lower), tuple(upper))

    def _add_lights(self) -> None:
        rng = self._rng
        self._scene.set_ambient_light((rng.uniform(0.1, 0.8) * rng.uniform(0.8, 1.0, 3)).tolist())
        for number in range(rng.integers(1, 4)):
            direction = rng.normal(size=3)
            direction[2] = -abs(direction[2]) - 0.3
            colour = (rng.uniform(0.3, 1.6) * rng.uniform(0.75, 1.0, 3)).tolist()
            shadow = number == 0 and not self._minimal  # the renderer supports one light with shadows
            self._scene.add_directional_light(direction.tolist(), colour, shadow=shadow, shadow_scale=2.0)
        for _ in range(rng.integers(0, 3)):
            position = [*rng.uniform(-1.0, 1.5, 2), rng.uniform(0.6, 2.0)]
            self._scene.add_point_light(position, (rng.uniform(0.2, 1.5) * rng.uniform(0.8, 1.0, 3)).tolist())

    def _add_robot(self, handless: bool) -> None:
        """Load the Panda, in three of ten scenes the one with a wrist camera, and paint it."""
        rng = self._rng
        urdf = "panda_v3.urdf" if rng.random() < 0.3 else "panda_v2.urdf"
        loader = self._scene.create_urdf_loader()
        loader.fix_root_link = True
        self._robot = loader.load(str(source_urdf().with_name(urdf)))
        self._links = {link.name: link for link in self._robot.get_links()}
        paint = self._draw_paint()
        part_of = {name: part for part, name in LINK_OF.items()}
        self._part_of_id = {}
        for name, link in self._links.items():
            part = part_of.get(name, RobotPart.BACKGROUND)
            self._part_of_id[link.entity.per_scene_id] = part
            body = link.entity.find_component_by_type(self._sapien.render.RenderBodyComponent)
            if body is None:
                continue
            if handless and part in GRIPPER:
                body.visibility = 0.0
            for shape in body.render_shapes:
                for piece in getattr(shape, "parts", []):
                    paint(piece.material)
        limits = self._robot.get_qlimits()
        self._lower, self._upper = limits[:7, 0], limits[:7, 1]

    def _draw_paint(self) -> Any:
        """Return a function that changes a material of the robot: kept, tinted, white to grey, coloured or textured."""
        rng = self._rng
        kind, tint, grey = rng.random(), rng.uniform(0.7, 1.1, 3), rng.uniform(0.25, 1.0)
        gloss = rng.uniform([0.1, 0.0], [1.0, 0.8])

        def paint(material: Any) -> None:
            colour = np.array(material.base_color[:3])
            if kind < 0.3:
                return
            if kind < 0.55:
                colour = colour * tint
            elif kind < 0.85:  # dark pieces stay darker than light ones in two thirds of these scenes
                shade = grey * (0.35 + 0.65 * colour.mean() if kind < 0.75 else 1.0)
                colour = shade * rng.uniform(0.93, 1.0, 3) + rng.normal(0, 0.03)
            elif kind < 0.95:
                colour = rng.uniform(0, 1, 3)
            else:
                texture = self._sapien.render.RenderTexture2D(random_texture(rng), "R8G8B8A8Unorm", srgb=True)
                material.set_base_color_texture(texture)
            material.set_base_color([*np.clip(colour, 0, 1), 1.0])
            material.set_roughness(float(gloss[0]))
            material.set_specular(float(gloss[1]))

        return paint

    def _place_robot(self, finger: float) -> Array:
        """Sample joint angles by rejection: above the table, mostly pointing down; return X_BH."""
        rng = self._rng
        for _ in range(20000):
            q = _REST + rng.normal(0, _SPREAD_RAD) if rng.random() < 0.8 else rng.uniform(self._lower, self._upper)
            if (q < self._lower).any() or (q > self._upper).any():
                continue
            self._robot.set_qpos(np.array([*q, finger, finger], dtype=np.float32))
            X_BH = self._pose("panda_hand")
            tip_z = X_BH[2, 3] + 0.11 * X_BH[2, 2] - self._table_z
            low = min(float(self._links[n].entity_pose.p[2]) for n in ("panda_link5", "panda_link6", "panda_link7"))
            if tip_z < 0.0 or X_BH[2, 3] < self._table_z + 0.03 or low < self._table_z + 0.05 or tip_z > 0.85:
                continue
            if rng.random() > np.exp(2.0 * (-X_BH[2, 2] - 1.0)) or (X_BH[0, 3] < 0.2 and rng.random() < 0.8):
                continue
            return X_BH
        raise RuntimeError("no robot pose above the table after 20,000 draws; the joint limits exclude it")

    def _pose(self, link: str) -> Array:
        return np.asarray(self._links[link].entity_pose.to_transformation_matrix(), dtype=np.float64)

    def _place_objects(self, X_BH: Array, holds: bool) -> None:
        rng = self._rng
        middle = X_BH[:3, 3] + 0.06 * X_BH[:3, 2]
        for actor, half in self._objects:
            position = FAR_AWAY
            kind = rng.random()
            if kind < 0.45:
                position = np.array([*rng.uniform([0.15, -0.6], [0.9, 0.6]), self._table_z + half])
            elif kind < 0.65:  # near the gripper, sometimes hiding parts of it
                position = middle + rng.normal(0, 0.12, 3)
                position[2] = max(position[2], self._table_z + half)
            if np.linalg.norm(position - middle) < 0.09 + half:
                position = FAR_AWAY
            quaternion = rng.normal(size=4)
            actor.set_pose(self._sapien.Pose(position, quaternion / np.linalg.norm(quaternion)))
        X_BO = X_BH @ make_pose(np.eye(3), [0, 0, 0.1034 + rng.uniform(-0.02, 0.04)])
        self._payload[0].set_pose(self._sapien.Pose(X_BO if holds else make_pose(np.eye(3), FAR_AWAY)))
        self._clutter.place(self._attachments, self._links)

    def _draw_camera(self, X_BH: Array) -> Camera:
        centre_B = transform_points(X_BH, GRIPPER_CENTRE_H[None])[0]
        if self._rng.random() < _NEAR_BENCHMARK:
            for _ in range(100):
                camera = varied_camera(self._rng, IMAGE_SIZE)
                pixel = camera.project(transform_points(invert(camera.X_BC), centre_B[None])[0])
                if (pixel > -40).all() and (pixel < IMAGE_SIZE + 40).all():
                    return camera
        links = np.stack([link.entity_pose.p for link in self._links.values()]).astype(np.float64)
        return random_camera(self._rng, centre_B, links, self._bounds, IMAGE_SIZE)

    def _aim(self, camera: Camera) -> Any:
        """Return SAPIEN's camera, made like `camera`."""
        if self._component is None:
            self._component = self._scene.add_camera("camera", camera.width, camera.height, 1.0, 0.01, _FAR_M)
        component = self._component
        component.set_perspective_parameters(0.01, _FAR_M, camera.fx, camera.fy, camera.cx, camera.cy, 0.0)
        X_BS = camera.X_BC @ make_pose(_OPENCV_FROM_SAPIEN, np.zeros(3))
        component.set_local_pose(self._sapien.Pose(X_BS))
        return component

    def frame(self) -> RenderedFrame:
        """Draw new poses and render a frame."""
        holds = bool(self._rng.random() < 0.35)
        finger = (
            self._payload[1]
            if holds
            else float(self._rng.choice([self._rng.uniform(0, 0.04), 0.04, 0.0], p=[0.7, 0.2, 0.1]))
        )
        X_BH = self._place_robot(finger)
        X_BH[:3, :3] = orthonormalize(X_BH[:3, :3])
        self._place_objects(X_BH, holds)
        camera = self._draw_camera(X_BH)
        component = self._aim(camera)
        self._scene.update_render()
        component.take_picture()
        if self._minimal:
            rgb = component.get_picture("Color")[..., :3]
            packed = component.get_picture("PositionSegmentation")
            depth_m = -packed[..., 2].astype(np.float64) / 1000.0 + RENDERED_DEPTH_BIAS_M
            ids = packed[..., 3]
        else:
            rgb = (np.clip(component.get_picture("Color")[..., :3], 0, 1) * 255).astype(np.uint8)
            depth_m, ids = -component.get_picture("Position")[..., 2], component.get_picture("Segmentation")[..., 1]
        X_BL = {name: self._pose(name) for name in self._links}
        return RenderedFrame.from_image(rgb, depth_m, label_parts(ids, self._part_of_id), camera, X_BL, finger)
