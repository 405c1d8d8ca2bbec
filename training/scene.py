"""Random SAPIEN scenes: a Panda in random poses and paint, with random surroundings, lights and cameras."""

from typing import Any

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.environment import native
from kinebench_drake.geometry import Array, invert, make_pose, orthonormalize, transform_points
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H
from kinebench_drake.models.gripper import PARTS, GripperModel
from kinebench_drake.models.panda.cad import MAX_FINGER_M
from kinebench_drake.models.panda.description import GRIPPER, HAND_LINK, LINK_OF, RobotPart, source_urdf
from kinebench_drake.models.robotiq.cad import robotiq_2f85
from training.clutter import Clutter
from training.frame import RENDERED_DEPTH_BIAS_M, RenderedFrame, label_parts, varied_camera
from training.layout import (
    FAR_AWAY,
    GripperLook,
    ShownGripper,
    random_attachments,
    random_finger,
    random_grasp,
    random_gripper,
    random_mounted,
    random_paint,
    random_places,
    random_room,
    random_sizes,
)
from training.posture import PostureSampler
from training.viewpoint import ViewBounds, random_camera

IMAGE_SIZE = 384
"""Width and height of frames [px]."""

_OPENCV_FROM_SAPIEN = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_MINIMAL = 0.5
"""Share of scenes with the fast shader, without shadows and reflections."""
_NEAR_BENCHMARK = 0.2
"""Share of frames from near the benchmark camera."""
_FAR_M = 15.0
_ATTACHMENTS = {ShownGripper.FRANKA: random_attachments, ShownGripper.OTHER: random_gripper}
_GRASP_SHIFT_M = 0.045
"""Distance between the pads of the Robotiq 2F-85 and those of the Franka hand from the face behind them [m]."""


class MountedGripper:
    """Gripper of known shape on the arm's flange."""

    def __init__(self, clutter: Clutter, model: GripperModel, look: GripperLook) -> None:
        """Add its bodies to a scene."""
        self.model = model
        self.look = look
        surfaces = {
            RobotPart.LEFT_FINGER: look.fingers,
            RobotPart.RIGHT_FINGER: look.fingers,
            RobotPart.HAND: look.hand,
        }
        self._bodies = {
            body: clutter.body(mesh, surfaces[RobotPart(body)] if body < PARTS else look.knuckles)
            for body, mesh in model.meshes.items()
        }
        self.part_of_id = {actor.per_scene_id: RobotPart(model.part_of[body]) for body, actor in self._bodies.items()}
        """Part by the id of its pixels."""

    def place(self, sapien: Any, X_BR: Array, finger_m: float) -> None:
        """Move it to the pose `X_BR` (4, 4) of its mounting face in the base frame [m], at an opening [m]."""
        X_BP = self.model.open(np.tile(X_BR, (PARTS, 1, 1)), finger_m)
        for body, actor in self._bodies.items():
            actor.set_pose(sapien.Pose(X_BP[body]))


class TrainingScene:
    """Table, walls, loose objects, lights and a Panda; `frame` draws new poses for all of them and renders."""

    def __init__(
        self, rng: np.random.Generator, gripper: ShownGripper = ShownGripper.FRANKA, *, labels_franka: bool = True
    ) -> None:
        """Build the scene from `rng`; without Franka's gripper, hand and fingers are hidden.

        Pixels of Franka's gripper count as background unless `labels_franka`.
        """
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
        self._clutter = Clutter(sapien, self._scene, rng)
        self._table_z = 0.0 if rng.random() < 0.6 else float(rng.uniform(-0.35, 0.0))
        self._bounds = self._add_room()
        self._add_lights()
        self._halves = random_sizes(rng)
        self._objects = [self._clutter.object(half) for half in self._halves]
        half = float(rng.uniform(0.008, 0.036))
        self._payload = self._clutter.object(half), half
        if rng.random() < 0.2:
            self._clutter.other_robot()
        self._add_robot(hides_hand=gripper is not ShownGripper.FRANKA, labels_hand=labels_franka)
        attachments = _ATTACHMENTS[gripper](rng) if gripper in _ATTACHMENTS else []
        self._mounted: MountedGripper | None = None
        if gripper is ShownGripper.ROBOTIQ:
            self._mounted = MountedGripper(self._clutter, robotiq_2f85(), random_mounted(rng))
            self._part_of_id |= self._mounted.part_of_id
            attachments = self._mounted.look.attachments
        self._attachments = self._clutter.add_attachments(attachments)
        self._component: Any = None

    def _add_room(self) -> ViewBounds:
        """Add table, floor, pedestal and walls; return where cameras may stand."""
        stock_table = self._table_z == 0.0 and self._rng.random() < 0.25
        if stock_table:
            builder = self._scene.create_actor_builder()
            pose = self._sapien.Pose([0.615 - 0.12, 0, -0.9196429], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
            mesh = source_urdf().parents[3] / "utils/scene_builder/table/assets/table.glb"
            builder.add_visual_from_file(str(mesh), scale=[1.75] * 3, pose=self._sapien.Pose())
            builder.set_initial_pose(pose)
            builder.build_kinematic(name="room")
        return random_room(self._rng, self._table_z, self._clutter.box, table=not stock_table)

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

    def _add_robot(self, *, hides_hand: bool, labels_hand: bool) -> None:
        """Load the Panda, in three of ten scenes the one with a wrist camera, and paint it."""
        rng = self._rng
        urdf = "panda_v3.urdf" if rng.random() < 0.3 else "panda_v2.urdf"
        loader = self._scene.create_urdf_loader()
        loader.fix_root_link = True
        self._robot = loader.load(str(source_urdf().with_name(urdf)))
        self._links = {link.name: link for link in self._robot.get_links()}
        paint = random_paint(rng)
        part_of = {name: part for part, name in LINK_OF.items()}
        self._part_of_id = {}
        for name, link in self._links.items():
            part = part_of.get(name, RobotPart.BACKGROUND)
            if part in GRIPPER and not labels_hand:
                part = RobotPart.BACKGROUND
            self._part_of_id[link.entity.per_scene_id] = part
            body = link.entity.find_component_by_type(self._sapien.render.RenderBodyComponent)
            if body is None:
                continue
            if hides_hand and part_of.get(name) in GRIPPER:
                body.visibility = 0.0
            for shape in body.render_shapes:
                for piece in getattr(shape, "parts", []):
                    surface = paint(np.array(piece.material.base_color[:3]))
                    if surface is not None:
                        self._clutter.apply(surface, piece.material)
        limits = self._robot.get_qlimits()
        self._postures = PostureSampler(
            lower=limits[:7, 0], upper=limits[:7, 1], link_poses=self._link_poses, table_z=self._table_z
        )

    def _link_poses(self, q: Array, finger: float = 0.0) -> dict[str, Array]:
        """Return the poses (4, 4) of the links in the base frame by name, with the robot moved there."""
        self._robot.set_qpos(np.array([*q, finger, finger], dtype=np.float32))
        return {
            name: link.entity_pose.to_transformation_matrix().astype(np.float64) for name, link in self._links.items()
        }

    def _place_objects(self, X_BH: Array, holds: bool) -> None:
        rng = self._rng
        for actor, X_BO in zip(self._objects, random_places(rng, self._halves, X_BH, self._table_z), strict=True):
            actor.set_pose(self._sapien.Pose(X_BO))
        X_BO = X_BH @ random_grasp(rng)
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
        return random_camera(self._rng, centre_B, links, self._bounds, (IMAGE_SIZE, IMAGE_SIZE))

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
        finger = self._payload[1] if holds else random_finger(self._rng)
        X_BL = self._link_poses(self._postures.draw(self._rng), finger)
        X_BH = X_BL[HAND_LINK].copy()
        X_BH[:3, :3] = orthonormalize(X_BH[:3, :3])
        X_BT = X_BH
        if self._mounted is not None:
            X_BH = X_BH @ self._mounted.look.X_HR
            X_BL = X_BL | {HAND_LINK: X_BH}
            finger *= self._mounted.model.max_finger_m / MAX_FINGER_M
            self._mounted.place(self._sapien, X_BH, finger)
            X_BT = X_BH @ make_pose(np.eye(3), [0.0, 0.0, _GRASP_SHIFT_M])
        self._place_objects(X_BT, holds)
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
            depth_m = -component.get_picture("Position")[..., 2]
            ids = component.get_picture("Segmentation")[..., 1]
        return RenderedFrame.from_image(rgb, depth_m, label_parts(ids, self._part_of_id), camera, X_BL, finger)
