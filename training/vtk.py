"""Random scenes in Drake's VTK renderer, another one than that of training: measurements on unfamiliar images."""

import base64
import json
import struct
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    ClippingRange,
    ColorRenderCamera,
    Cylinder,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    InMemoryMesh,
    LightParameter,
    MakeRenderEngineVtk,
    Mesh,
    PerceptionProperties,
    RenderCameraCore,
    RenderEngineVtkParams,
    RenderLabel,
    Rgba,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, make_pose, rotation_exp, transform_points
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H
from kinebench_drake.io.frames import Frames
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import panda
from kinebench_drake.models.panda.cad import FINGER_ORIGIN_H, visual_file
from kinebench_drake.models.panda.description import GRIPPER, HAND_LINK, LINK_OF, OPENING_SIGN, RobotPart
from training.layout import (
    FAR_AWAY,
    Solid,
    SolidKind,
    Surface,
    random_attachments,
    random_grasp,
    random_paint,
    random_places,
    random_room,
    random_sizes,
    random_solid,
    random_surface,
)
from training.posture import Motion, PostureSampler
from training.viewpoint import random_camera

SIZES = ((384, 384), (320, 240), (640, 480), (512, 512), (640, 360), (480, 640), (256, 256), (960, 540))
"""Width and height of images [px]."""
_FAR_M = 15.0
_SCENERY = 100
"""Render label of all but the robot."""
_RENDERER = "vtk"
_SHADOWS = 0.4
"""Share of scenes with shadows."""
_Z_UP = make_pose(rotation_exp(np.array([-np.pi / 2, 0.0, 0.0])), np.zeros(3))
"""Drake turns glTF meshes from y up to z up; the Panda's are z up as they are."""
_HALF_TURN = make_pose(rotation_exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
_VIEWS = 200
"""Draws of a camera that sees a whole motion."""
_IN_VIEW = 0.75
"""Share of frames whose gripper's centre is in the image."""


@cache
def _arm() -> ArmPlant:
    return ArmPlant(panda())


@cache
def _gltf(part: RobotPart) -> str:
    """Return the glTF text of a part's mesh, its binary data inside."""
    data = visual_file(part).read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    gltf = json.loads(data[20 : 20 + length])
    gltf["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data[28 + length :]).decode()
    return json.dumps(gltf)


def _painted(part: RobotPart, paint: Callable[[Array], Surface | None]) -> Mesh:
    gltf = json.loads(_gltf(part))
    for material in gltf["materials"]:
        look = material["pbrMetallicRoughness"]
        surface = paint(np.array(look["baseColorFactor"][:3]))
        if surface is not None:  # the meshes have no texture coordinates
            colour = surface.colour if surface.texture is None else surface.texture[..., :3].mean(axis=(0, 1)) / 255
            look.update(baseColorFactor=[*colour, 1.0], roughnessFactor=surface.roughness)
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(json.dumps(gltf), ".gltf", LINK_OF[part])))


def _shape(solid: Solid) -> Any:
    length, half, height = solid.half
    if solid.kind is SolidKind.SPHERE:
        return Sphere(half)
    if solid.kind is SolidKind.BOX:
        return Box(2 * length, 2 * half, 2 * height)
    return (Capsule if solid.kind is SolidKind.CAPSULE else Cylinder)(half, 2 * length)


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedVideo:
    """Rendered video of T frames with ground truth."""

    frames: Frames
    camera: Camera
    frame_period_s: float
    """Time between two frames [s]."""
    motion: Motion
    X_BH: Array
    """(T, 4, 4) pose of panda_hand in the base frame [m]."""
    visible: NDArray[np.int64]
    """(T,) pixels that show the gripper."""


class VtkScene:
    """Table, walls, loose things, lights and a Panda in Drake's VTK renderer, with random poses of all of them."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Build the scene from `rng`."""
        self._rng = rng
        self._graph = SceneGraph()
        self._graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(self._draw_look()))
        self._source = self._graph.RegisterSource("scene")
        self._frames: dict[str, Any] = {}
        self._numbers = count()
        self._size = SIZES[int(rng.integers(len(SIZES)))]
        table_z = 0.0 if rng.random() < 0.6 else float(rng.uniform(-0.35, 0.0))
        with tempfile.TemporaryDirectory() as folder:
            self._folder = Path(folder)
            self._bounds = random_room(rng, table_z, self._add_box)
            self._halves = random_sizes(rng)
            for k, half in enumerate(self._halves):
                self._add(f"object{k}", _shape(random_solid(rng, half)), random_surface(rng))
            self._payload_m = float(rng.uniform(0.008, 0.036))
            self._add("payload", _shape(random_solid(rng, self._payload_m)), random_surface(rng))
            self._add_robot()
            self._attachments = random_attachments(rng)
            for k, a in enumerate(self._attachments):
                self._add(f"attachment{k}", Box(*(2 * h for h in a.half)), a.surface)
            self._context = self._graph.CreateDefaultContext()
        arm = _arm()
        self._postures = PostureSampler(lower=arm.lower, upper=arm.upper, link_poses=arm.link_poses, table_z=table_z)

    def _draw_look(self) -> RenderEngineVtkParams:
        """Draw lights, shadows and the colour of the distance."""
        rng = self._rng
        lights = []
        for _ in range(rng.integers(1, 4)):
            direction = rng.normal(size=3)
            direction[2] = -abs(direction[2]) - 0.3
            colour = Rgba(*rng.uniform(0.75, 1.0, 3))
            intensity = float(rng.uniform(0.5, 2.2))
            lights.append(
                LightParameter(
                    type="directional", color=colour, intensity=intensity, frame="world", direction=direction
                )
            )
        if rng.random() < 0.3:
            position = np.array([*rng.uniform(-1.0, 1.5, 2), rng.uniform(1.2, 2.0)])
            lights.append(
                LightParameter(type="point", intensity=float(rng.uniform(0.3, 1.5)), frame="world", position=position)
            )
        # A lamp at the camera, in place of ambient light; strong where there is no other.
        intensity = float(rng.uniform(0.2, 1.0) if rng.random() < 0.7 else rng.uniform(1.2, 2.5))
        lights = lights if intensity < 1.2 else []
        lights.append(LightParameter(type="directional", intensity=intensity, frame="camera"))
        return RenderEngineVtkParams(
            default_clear_color=np.clip(rng.uniform(0.1, 0.9) + rng.normal(0, 0.1, 3), 0, 1),
            lights=lights,
            cast_shadows=bool(rng.random() < _SHADOWS),
            shadow_map_size=1024,
        )

    def _properties(self, surface: Surface | None, label: int) -> PerceptionProperties:
        properties = PerceptionProperties()
        properties.AddProperty("label", "id", RenderLabel(label))
        if surface is not None and surface.texture is not None:
            path = self._folder / f"{next(self._numbers)}.png"
            cv2.imwrite(str(path), surface.texture[..., 2::-1])
            properties.AddProperty("phong", "diffuse_map", str(path))
        if surface is not None:
            properties.AddProperty("phong", "diffuse", Rgba(*surface.colour))
        return properties

    def _add(
        self, name: str, shape: Any, surface: Surface | None, label: int = _SCENERY, X: Array | None = None
    ) -> None:
        """Add a geometry that moves with a new frame `name`, at pose `X` (4, 4) in it."""
        instance = GeometryInstance(RigidTransform(np.eye(4) if X is None else X), shape, name)
        instance.set_perception_properties(self._properties(surface, label))
        self._frames[name] = self._graph.RegisterFrame(self._source, GeometryFrame(name))
        self._graph.RegisterGeometry(self._source, self._frames[name], instance)

    def _add_box(self, half: tuple[float, ...], position: tuple[float, ...]) -> None:
        instance = GeometryInstance(
            RigidTransform(np.array(position)),
            Box(*(2 * h for h in half)),
            f"room{next(self._numbers)}",
        )
        instance.set_perception_properties(self._properties(random_surface(self._rng), _SCENERY))
        self._graph.RegisterAnchoredGeometry(self._source, instance)

    def _add_robot(self) -> None:
        paint = random_paint(self._rng)
        for part, link in LINK_OF.items():
            mesh = _painted(part, paint)
            turned = _HALF_TURN @ _Z_UP if part is RobotPart.RIGHT_FINGER else _Z_UP
            self._add(link, mesh, None, int(part), turned)

    def _move(self, X_BL: Mapping[str, Array], X_BO: Sequence[Array], X_BP: Array) -> None:
        """Move links, objects and payload to poses (4, 4) in the base frame."""
        poses = {**X_BL, **{f"object{k}": X for k, X in enumerate(X_BO)}, "payload": X_BP}
        poses |= {f"attachment{k}": X_BL[a.link] @ a.X_LA for k, a in enumerate(self._attachments)}
        vector = FramePoseVector()
        for name, frame in self._frames.items():
            vector.set_value(frame, RigidTransform(poses[name]))
        self._graph.get_source_pose_port(self._source).FixValue(self._context, vector)

    def _draw_objects(self, X_BH: Array) -> list[Array]:
        return list(random_places(self._rng, self._halves, X_BH, self._postures.table_z))

    def _draw_camera(self, X_BL: Mapping[str, Array], motion: Sequence[Mapping[str, Array]]) -> Camera:
        """Return a camera that sees the gripper at link poses `X_BL`, clear of the links in all of `motion`."""
        centre_B = transform_points(X_BL[HAND_LINK], GRIPPER_CENTRE_H[None])[0]
        links_B = np.concatenate([[X[:3, 3] for X in poses.values()] for poses in motion])
        return random_camera(self._rng, centre_B, links_B, self._bounds, self._size)

    def _render(self, camera: Camera) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Return image (H, W, 3) and parts (H, W)."""
        info = CameraInfo(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        core = RenderCameraCore(_RENDERER, info, ClippingRange(0.01, _FAR_M), RigidTransform())
        query = self._graph.get_query_output_port().Eval(self._context)
        pose = self._graph.world_frame_id(), RigidTransform(camera.X_BC)
        rgb = query.RenderColorImage(ColorRenderCamera(core, False), *pose).data[..., :3].copy()
        label = query.RenderLabelImage(ColorRenderCamera(core, False), *pose).data[..., 0]
        return rgb, np.where(label < _SCENERY, label, 0).astype(np.uint8)

    def video(self) -> RenderedVideo:
        """Draw a motion, maybe with a grasp, and a static camera that sees it, and render it."""
        rng = self._rng
        period_s = float(rng.choice([0.1, 0.15, 0.2]))
        motion = self._postures.draw_motion(rng, period_s, self._payload_m)
        X_BL = [_link_poses(q, finger) for q, finger in zip(motion.q, motion.finger_m.tolist(), strict=True)]
        X_BH = np.stack([X[HAND_LINK] for X in X_BL])
        camera = self._draw_static_camera(X_BL, X_BH)
        objects = self._draw_objects(X_BH[len(X_BH) // 2])
        grasp = np.flatnonzero(motion.holds)
        X_HP = random_grasp(rng)
        frames = []
        visible = []
        for t, X in enumerate(X_BL):
            # The thing lies where it is grasped before, and where it is released afterwards.
            hidden = make_pose(np.eye(3), FAR_AWAY)
            self._move(X, objects, X_BH[np.clip(t, grasp[0], grasp[-1])] @ X_HP if len(grasp) else hidden)
            rgb, part = self._render(camera)
            frames.append(rgb)
            visible.append(np.isin(part, GRIPPER).sum())
        return RenderedVideo(
            frames=np.stack(frames),
            camera=camera,
            frame_period_s=period_s,
            motion=motion,
            X_BH=X_BH,
            visible=np.array(visible),
        )

    def _draw_static_camera(self, X_BL: Sequence[Mapping[str, Array]], X_BH: Array) -> Camera:
        """Return a camera that sees the gripper in most of the frames, or the best of many draws."""
        centre_B = X_BH[:, :3, 3] + X_BH[:, :3, :3] @ GRIPPER_CENTRE_H
        best = None
        most = -1.0
        for _ in range(_VIEWS):
            camera = self._draw_camera(X_BL[int(self._rng.integers(len(X_BL)))], X_BL)
            shown = _share_shown(camera, centre_B)
            if shown > most:
                best = camera
                most = shown
            if shown >= _IN_VIEW:
                break
        assert best is not None
        return best


def _share_shown(camera: Camera, p_B: Array) -> float:
    """Return the share of points `p_B` (N, 3) in front of the camera and inside its image."""
    p_C = transform_points(np.linalg.inv(camera.X_BC), p_B)
    pixel = camera.project(p_C)
    inside = (p_C[:, 2] > 0.25) & (pixel > 0).all(axis=1) & (pixel < [camera.width, camera.height]).all(axis=1)
    return float(inside.mean())


def _link_poses(q: Array, finger_m: float) -> dict[str, Array]:
    """Return the poses (4, 4) of the links in the base frame [m], by name."""
    X_BL = _arm().link_poses(q)
    for part, sign in OPENING_SIGN.items():
        if part is not RobotPart.HAND:
            X_HF = make_pose(np.eye(3), FINGER_ORIGIN_H + np.array([0.0, sign * finger_m, 0.0]))
            X_BL[LINK_OF[part]] = X_BL[HAND_LINK] @ X_HF
    return X_BL
