"""Random SAPIEN scenes: a Panda in random poses with random tables, walls, objects, lights and cameras."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.environment import native
from kinebench_drake.geometry import Array, invert, make_pose, orthonormalize
from kinebench_drake.models.panda.robot import GRIPPER, LINK_OF, RobotPart, source_urdf
from kinebench_drake.models.perception.frame import RENDERED_DEPTH_BIAS_M, RenderedFrame, label_parts, varied_camera

_SIZE = 256


def _noise(rng: np.random.Generator, octaves: int) -> NDArray[np.float32]:
    """Return value noise (256, 256) in 0..1: a sum of random grids with doubling resolution and halving weight."""
    total = np.zeros((_SIZE, _SIZE), np.float32)
    for octave in range(octaves):
        cells = 2 ** (octave + 2)
        grid = rng.random((cells, cells), dtype=np.float32)
        total += np.asarray(cv2.resize(grid, (_SIZE, _SIZE), interpolation=cv2.INTER_CUBIC)) * 0.5**octave
    total -= total.min()
    return total / max(float(total.max()), 1e-6)


def random_texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return a random texture (256, 256, 4) RGBA; the same generator state gives the same bytes."""
    y, x = np.mgrid[0:_SIZE, 0:_SIZE].astype(np.float32) / _SIZE
    pattern = rng.integers(5)
    noise = _noise(rng, int(rng.integers(2, 7)))
    frequency = float(rng.uniform(2, 14))
    if pattern == 0:
        blend = noise
    elif pattern == 1:  # wood: rings of a distorted distance
        blend = 0.5 + 0.5 * np.sin(2 * np.pi * frequency * (x + 0.25 * noise))
    elif pattern == 2:
        blend = ((np.floor(x * frequency) + np.floor(y * frequency)) % 2).astype(np.float32)
    elif pattern == 3:
        blend = 0.5 + 0.5 * np.sign(np.sin(2 * np.pi * frequency * (x * np.cos(noise[0, 0] * 6) + y)))
    else:  # cloth: a fine weave over soft noise
        blend = 0.6 * noise + 0.4 * (0.5 + 0.25 * (np.sin(x * 400) + np.sin(y * 400)))
    blend = np.clip(blend * rng.uniform(0.4, 1.0) + 0.1 * _noise(rng, 5), 0, 1)[..., None]
    first, second = rng.uniform(0, 255, 3), rng.uniform(0, 255, 3)
    if rng.random() < 0.5:  # similar colours are more frequent on real tables and walls
        second = np.clip(first + rng.normal(0, 40, 3), 0, 255)
    colour = first * blend + second * (1 - blend)
    return np.dstack([colour, np.full((_SIZE, _SIZE), 255.0)]).astype(np.uint8)


IMAGE_SIZE = 384
"""Width and height of frames [px]."""

_TABLE_HALF = (0.9, 1.2, 0.02)
_OPENCV_FROM_SAPIEN = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


class TrainingScene:
    """Table, walls, loose objects, lights and a Panda; `frame` draws new poses for all of them and renders."""

    def __init__(self, rng: np.random.Generator, *, handless: bool = False) -> None:
        """Build the scene from `rng`; a `handless` scene hides hand and fingers, as some generated videos do."""
        native.prepare_vulkan()
        import sapien

        self._sapien: Any = sapien
        self._rng = rng
        self._minimal = bool(rng.random() < 0.8)
        sapien.render.set_camera_shader_dir("minimal" if self._minimal else "default")
        if self._minimal:
            sapien.render.set_picture_format("Color", "r8g8b8a8unorm")
            sapien.render.set_picture_format("ColorRaw", "r8g8b8a8unorm")
            sapien.render.set_picture_format("PositionSegmentation", "r16g16b16a16sint")
        else:
            sapien.render.set_picture_format("Color", "r32g32b32a32sfloat")
            sapien.render.set_picture_format("Position", "r32g32b32a32sfloat")
        self._scene = sapien.Scene()
        self._add_room()
        self._add_lights()
        self._objects = [self._random_object() for _ in range(10)]
        self._payload = self._random_object(payload=True)
        self._add_robot(handless)
        self._component: Any = None

    def _material(self) -> Any:
        material = self._sapien.render.RenderMaterial()
        if self._rng.random() < 0.6:
            texture = self._sapien.render.RenderTexture2D(random_texture(self._rng), "R8G8B8A8Unorm", srgb=True)
            material.set_base_color_texture(texture)
        else:
            material.set_base_color([*self._rng.uniform(0, 1, 3), 1.0])
        material.set_roughness(float(self._rng.uniform(0.1, 1.0)))
        material.set_metallic(float(self._rng.choice([0.0, 0.0, 0.0, 0.7])))
        material.set_specular(float(self._rng.uniform(0, 0.8)))
        return material

    def _box(self, half: tuple[float, ...], position: tuple[float, ...], material: Any = None) -> Any:
        builder = self._scene.create_actor_builder()
        builder.add_box_visual(half_size=half, material=material or self._material())
        builder.set_initial_pose(self._sapien.Pose(position))
        return builder.build_kinematic(name="room")

    def _add_room(self) -> None:
        """Add the table top at z = 0 of the base frame, the floor and sometimes walls."""
        rng = self._rng
        if rng.random() < 0.3:
            builder = self._scene.create_actor_builder()
            scale = 1.75
            pose = self._sapien.Pose([0.615 - 0.12, 0, -0.9196429], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
            mesh = source_urdf().parents[3] / "utils/scene_builder/table/assets/table.glb"
            builder.add_visual_from_file(str(mesh), scale=[scale] * 3, pose=self._sapien.Pose())
            builder.set_initial_pose(pose)
            builder.build_kinematic(name="room")
        else:
            self._box(_TABLE_HALF, (float(rng.uniform(0.2, 0.6)), 0.0, -_TABLE_HALF[2]))
        self._box((4, 4, 0.01), (0, 0, -0.93))
        if rng.random() < 0.6:
            self._box((0.02, 4, 3), (float(rng.uniform(-2.5, -0.4)), 0, 1))
        if rng.random() < 0.4:
            self._box((3, 0.02, 3), (0, float(rng.choice([-1, 1]) * rng.uniform(1.0, 2.5)), 1))

    def _add_lights(self) -> None:
        rng = self._rng
        self._scene.set_ambient_light((rng.uniform(0.15, 0.7) * rng.uniform(0.8, 1.0, 3)).tolist())
        for number in range(rng.integers(1, 4)):
            direction = rng.normal(size=3)
            direction[2] = -abs(direction[2]) - 0.3
            colour = (rng.uniform(0.3, 1.4) * rng.uniform(0.75, 1.0, 3)).tolist()
            shadow = number == 0 and not self._minimal  # the renderer supports one light with shadows
            self._scene.add_directional_light(direction.tolist(), colour, shadow=shadow, shadow_scale=2.0)
        if rng.random() < 0.4:
            position = [*rng.uniform(-0.5, 1.2, 2), rng.uniform(0.6, 1.5)]
            self._scene.add_point_light(position, (rng.uniform(0.3, 1.5, 3)).tolist())

    def _random_object(self, payload: bool = False) -> tuple[Any, float]:
        """Return a random primitive and its half thickness [m]; a `payload` fits between the fingers."""
        rng = self._rng
        builder = self._scene.create_actor_builder()
        material = self._material()
        half = rng.uniform(0.008, 0.036) if payload else rng.uniform(0.01, 0.06)
        kind = rng.integers(4)
        if kind == 0:
            builder.add_sphere_visual(radius=half, material=material)
        elif kind == 1:
            builder.add_capsule_visual(radius=half, half_length=float(rng.uniform(0.01, 0.1)), material=material)
        elif kind == 2:
            builder.add_cylinder_visual(radius=half, half_length=float(rng.uniform(0.01, 0.1)), material=material)
        else:
            size = [float(rng.uniform(0.01, 0.08)), half, float(rng.uniform(0.01, 0.08))]
            builder.add_box_visual(half_size=size, material=material)
        builder.set_initial_pose(self._sapien.Pose([0, 0, -5]))
        return builder.build_kinematic(name="object"), float(half)

    def _add_robot(self, handless: bool) -> None:
        """Load the Panda, in three of ten scenes the one with a wrist camera; sometimes change its colours slightly."""
        rng = self._rng
        urdf = "panda_v3.urdf" if rng.random() < 0.3 else "panda_v2.urdf"
        loader = self._scene.create_urdf_loader()
        loader.fix_root_link = True
        self._robot = loader.load(str(source_urdf().with_name(urdf)))
        self._links = {link.name: link for link in self._robot.get_links()}
        recolour, tint = rng.random() < 0.3, rng.uniform(0.7, 1.1, 3)
        part_of = {name: part for part, name in LINK_OF.items()}
        self._part_of_id = {}
        for name, link in self._links.items():
            part = part_of.get(name, RobotPart.BACKGROUND)
            self._part_of_id[link.entity.per_scene_id] = part
            body = link.entity.find_component_by_type(self._sapien.render.RenderBodyComponent)
            if handless and part in GRIPPER and body is not None:
                body.visibility = 0.0
            if recolour and body is not None:
                for shape in body.render_shapes:
                    for piece in getattr(shape, "parts", []):
                        colour = np.clip(np.array(piece.material.base_color[:3]) * tint, 0, 1)
                        piece.material.set_base_color([*colour, 1.0])
        limits = self._robot.get_qlimits()
        self._lower, self._upper = limits[:7, 0], limits[:7, 1]

    def _camera(self, camera: Camera) -> Any:
        if self._component is None:
            self._component = self._scene.add_camera("camera", camera.width, camera.height, 1.0, 0.01, 10.0)
        component = self._component
        component.set_perspective_parameters(0.01, 10.0, camera.fx, camera.fy, camera.cx, camera.cy, 0.0)
        X_BS = camera.X_BC @ make_pose(_OPENCV_FROM_SAPIEN, np.zeros(3))
        component.set_local_pose(self._sapien.Pose(X_BS))
        return component

    def _place_robot(self, camera: Camera, finger: float) -> Array:
        """Sample joint angles by rejection: above the table, in view, mostly pointing down; return X_CH."""
        rng = self._rng
        X_CB = invert(camera.X_BC)
        rest = np.array([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.785])
        for _ in range(20000):
            if rng.random() < 0.8:
                q = rest + rng.normal(0, [0.6, 0.5, 0.4, 0.5, 0.5, 0.5, 1.2])
            else:
                q = rng.uniform(self._lower, self._upper)
            if (q < self._lower).any() or (q > self._upper).any():
                continue
            self._robot.set_qpos(np.array([*q, finger, finger], dtype=np.float32))
            X_BH = self._links["panda_hand"].entity_pose.to_transformation_matrix().astype(np.float64)
            tip = X_BH[:3, 3] + 0.11 * X_BH[:3, 2]
            low = min(float(self._links[n].entity_pose.p[2]) for n in ("panda_link5", "panda_link6", "panda_link7"))
            if tip[2] < 0.0 or X_BH[2, 3] < 0.03 or low < 0.05 or tip[2] > 0.75:
                continue
            if rng.random() > np.exp(2.5 * (-X_BH[2, 2] - 1.0)) or (X_BH[0, 3] < 0.2 and rng.random() < 0.8):
                continue
            X_CH = X_CB @ X_BH
            middle = X_CH[:3, 3] + 0.05 * X_CH[:3, 2]
            if middle[2] < 0.25:
                continue
            pixel = camera.project(middle)
            margin = 0.0 if rng.random() < 0.8 else 40.0
            if (pixel < -margin).any() or (pixel > IMAGE_SIZE + margin).any():
                continue
            return np.asarray(X_CH)
        raise RuntimeError("no robot pose in view after 20,000 draws; the camera does not see the work space")

    def _place_objects(self, X_BH: Array, holds: bool) -> None:
        rng = self._rng
        for actor, half in self._objects:
            if rng.random() < 0.4:
                position = np.array([0, 0, -5.0])
            elif rng.random() < 0.7:
                position = np.array([*rng.uniform([0.2, -0.5], [0.8, 0.5]), half])
            else:  # near the gripper, sometimes hiding parts of it
                position = X_BH[:3, 3] + 0.08 * X_BH[:3, 2] + rng.normal(0, 0.1, 3)
                position[2] = max(position[2], half)
                if np.linalg.norm(position - X_BH[:3, 3] - 0.06 * X_BH[:3, 2]) < 0.09 + half:
                    position = np.array([0, 0, -5.0])
            quaternion = rng.normal(size=4)
            actor.set_pose(self._sapien.Pose(position, quaternion / np.linalg.norm(quaternion)))
        payload, _ = self._payload
        if holds:
            X_BO = X_BH @ make_pose(np.eye(3), [0, 0, 0.1034 + rng.uniform(-0.02, 0.04)])
            payload.set_pose(self._sapien.Pose(X_BO))
        else:
            payload.set_pose(self._sapien.Pose([0, 0, -5]))

    def frame(self) -> RenderedFrame:
        """Draw new poses and render a frame."""
        camera = varied_camera(self._rng, IMAGE_SIZE)
        holds = bool(self._rng.random() < 0.35)
        finger = (
            self._payload[1]
            if holds
            else float(self._rng.choice([self._rng.uniform(0, 0.04), 0.04, 0.0], p=[0.7, 0.2, 0.1]))
        )
        X_CH = self._place_robot(camera, finger)
        X_BH = camera.X_BC @ X_CH
        X_BH[:3, :3] = orthonormalize(X_BH[:3, :3])
        self._place_objects(X_BH, holds)
        component = self._camera(camera)
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
        X_BL = {n: link.entity_pose.to_transformation_matrix().astype(np.float64) for n, link in self._links.items()}
        return RenderedFrame.from_image(rgb, depth_m, label_parts(ids, self._part_of_id), camera, X_BL, finger)
