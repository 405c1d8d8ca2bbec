"""ManiSkill scene of an episode: physics, rendering, task outcome.

sapien and mani_skill are loaded when a `Simulator` is created.
"""

import gc
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.environment.native import ignore_vulkan_warning, prepare_vulkan
from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array, from_quaternion, invert
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import FINGER_LINKS, HAND_LINK
from kinebench_drake.suites.clock import Control
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_task
from kinebench_drake.suites.families.task import Scene, TaskVariant

SimulatorState: TypeAlias = Mapping[str, Mapping[str, NDArray[np.float32]]]
"""ManiSkill's state: kind (actors, articulations) and name to values."""
GRIPPER_LINKS = (HAND_LINK, *FINGER_LINKS, *(f"{finger}_pad" for finger in FINGER_LINKS))
"""Links of the gripper in masks; some of ManiSkill's Pandas have no pad links."""


@cache
def _exempt_libraries() -> None:
    """Exempt the objects of the libraries from garbage collection: going through them takes most of each reset."""
    gc.collect()
    gc.freeze()


@contextmanager
def setup_errors() -> Iterator[None]:
    """Turn errors of a missing library or driver into SetupError with the remedy; others propagate."""
    try:
        yield
    except ImportError as error:
        raise SetupError(
            f"ManiSkill cannot be loaded ({error}); `kinebench-drake doctor --fix` repairs what is missing, or says how"
        ) from error
    except RuntimeError as error:  # of SAPIEN, with the Vulkan error name
        reason = str(error).split("\n")[0]
        if not re.search(r"\bvk::|vulkan|render", reason, re.IGNORECASE):
            raise
        raise SetupError(
            f"Vulkan does not work ({reason}); `kinebench-drake doctor --fix` unpacks a driver that renders on the CPU "
            "where one is missing"
        ) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """State of robot and objects."""

    q: Array
    """(7,) arm joint angles [rad]."""
    fingers_m: Array
    """(2,) finger joints [m]."""
    objects: dict[str, Array]
    """Position and quaternion wxyz (7,) of each object in the ManiSkill world [m]."""
    joints: dict[str, float]
    """Joint position of each articulated object [rad or m]."""

    @property
    def finger_width_m(self) -> float:
        """Gap between the finger pads [m]."""
        return float(self.fingers_m.sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraImage:
    """Rendered image with depth and masks."""

    rgb: NDArray[np.uint8]
    """(H, W, 3)."""
    depth_mm: NDArray[np.uint16]
    """(H, W) distance along the camera's z, truncated to millimetres; 0 for no surface."""
    mask: NDArray[np.bool_]
    """(H, W) pixels of the gripper (hand and fingers)."""
    robot: NDArray[np.bool_]
    """(H, W) pixels of the robot, including the gripper."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskOutcome:
    """Outcome of a task in one state."""

    success: bool
    progress: float
    """Progress towards the goal, 0..1."""
    conditions: dict[str, bool]
    """The task's named sub-conditions."""

    @property
    def reason(self) -> str:
        """Failed conditions, such as "not on top, not released"; empty on success."""
        failed = [f"not {name.replace('_', ' ')}" for name, holds in self.conditions.items() if not holds]
        return "" if self.success else ", ".join(failed)


class Simulator:
    """Task with one Panda and one camera, simulated on the CPU.

    It takes some seconds to build the first time in a process, whose objects are exempt from garbage collection then.

    Args:
        robot: one of `KineBenchEnv.SUPPORTED_ROBOTS`: "panda" or "panda_wristcam".
        camera: camera; None: the benchmark camera.
        renders: whether images can be rendered; physics alone needs no Vulkan.

    Raises:
        UsageError: there is no such task or variant.
        SetupError: sapien, mani_skill or a Vulkan driver is missing or cannot be loaded.
    """

    def __init__(
        self,
        task: str,
        *,
        robot: str = "panda",
        camera: Camera | None = None,
        variant: TaskVariant = TaskVariant.PLAIN,
        renders: bool = True,
        control: Control = Control.JOINTS,
    ) -> None:
        ignore_vulkan_warning()  # SAPIEN looks for Vulkan when it is imported
        backend = prepare_vulkan() if renders else "none"
        with setup_errors():
            import sapien

            from kinebench_drake.suites.scene.builder import CAMERA, X_WB
            from kinebench_drake.suites.scene.environment import KineBenchEnv

        _exempt_libraries()
        plant = ArmPlant()
        self.joint_limits = (plant.lower, plant.upper)
        """Lower and upper joint limits, each (7,) [rad]."""
        self.camera = benchmark_camera() if camera is None else camera
        self.task = find_task(task, variant)
        self._pose_class = sapien.Pose
        self._camera_name = CAMERA
        self._X_BW = invert(X_WB)
        with setup_errors():
            self.env: Any = KineBenchEnv(
                task=task,
                obs_mode="none",
                reward_mode="none",
                control_mode=control.value,
                robot_uids=robot,
                sim_backend="cpu",
                render_backend=backend,
                camera=self.camera,
                variant=variant.value,
            )
            """The ManiSkill environment."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the scene."""
        self.env.close()

    def reset(self, episode: Episode) -> None:
        """Set up the scene of an episode."""
        self.env.reset(seed=episode.seed, options={"episode": episode})

    def scene(self) -> Scene:
        """Return the current placement of robot and objects."""
        scene: Scene = self.env.first_scene()
        return scene

    def link_pose(self, link: str) -> Array:
        """Return the pose (4, 4) of a robot link in the base frame [m]."""
        raw = np.asarray(self.env.agent.robot.links_map[link].pose.raw_pose[0], dtype=np.float64)
        return self._X_BW @ from_quaternion(raw[3:], raw[:3])

    @staticmethod
    def action(targets: ArrayLike, finger_width_m: float) -> NDArray[np.float32]:
        """Return ManiSkill's action for targets, such as `q` (7,) [rad], and a gap between the finger pads [m]."""
        # of one finger joint's target, for actions -1 and 1 (ManiSkill's Panda)
        low = -0.01
        fingers = float(np.clip(2.0 * (finger_width_m / 2.0 - low) / (0.04 - low) - 1.0, -1.0, 1.0))
        return np.append(np.asarray(targets), fingers).astype(np.float32)

    def step(self, q: ArrayLike, finger_width_m: float) -> None:
        """Simulate one control step with joint targets `q` (7,) [rad] and a gap between the finger pads [m]."""
        self.env.advance(self.action(q, finger_width_m))

    def step_pose(self, X_BG: ArrayLike, finger_width_m: float) -> None:
        """Simulate one control step towards a pose (4, 4) of panda_hand_tcp in B [m], under `Control.POSE`."""
        X = np.asarray(X_BG, dtype=np.float64)
        angles = Rotation.from_matrix(X[:3, :3]).as_euler("XYZ")  # convention of ManiSkill's controller
        self.env.advance(self.action(np.append(X[:3, 3], angles), finger_width_m))

    def simulation_state(self) -> SimulatorState:
        """Return ManiSkill's state: pose and velocities (13,) of actors, with joint states for articulations."""
        kinds: dict[str, Any] = self.env.get_state_dict()
        return {
            kind: {name: value[0].cpu().numpy() for name, value in kinds.get(kind, {}).items()}
            for kind in ("actors", "articulations")
        }

    def restore(self, state: SimulatorState) -> None:
        """Set the `simulation_state` of another simulator of the same episode."""
        import torch

        self.env.set_state_dict(
            {kind: {name: torch.from_numpy(value)[None] for name, value in members.items()}
             for kind, members in state.items()}
        )  # fmt: skip

    def outcome(self) -> TaskOutcome:
        """Evaluate the task in the current state."""
        values = {name: value[0].item() for name, value in self.env.evaluate().items()}
        success = bool(values.pop("success"))
        return TaskOutcome(
            success=success, progress=float(values.pop("progress")), conditions={n: bool(v) for n, v in values.items()}
        )

    def snapshot(self) -> Snapshot:
        """Return the current state of robot and objects."""
        qpos = np.asarray(self.env.agent.robot.get_qpos()[0], dtype=np.float64)
        things = self.env.objects
        return Snapshot(
            q=qpos[:7],
            fingers_m=qpos[7:9],
            objects={name: np.asarray(x.pose.raw_pose[0], dtype=np.float64) for name, x in things.items()},
            joints={name: float(x.qpos[0, 0]) for name, x in things.items() if hasattr(x, "qpos")},
        )

    def set_snapshot(self, snapshot: Snapshot) -> None:
        """Set the state of robot and objects, without simulating."""
        self.env.agent.robot.set_qpos(np.concatenate([snapshot.q, snapshot.fingers_m])[None].astype(np.float32))
        for name, raw in snapshot.objects.items():
            thing = self.env.objects[name]
            thing.set_pose(self._pose_class(raw[:3], raw[3:]))
            if name in snapshot.joints:
                thing.set_qpos(np.array([[snapshot.joints[name]]], dtype=np.float32))

    def set_visible(self, links: Collection[str], *, visible: bool) -> None:
        """Show or hide robot links."""
        import sapien

        for name, link in self.env.agent.robot.links_map.items():
            if name in links:
                body = link._objs[0].entity.find_component_by_type(sapien.render.RenderBodyComponent)
                if body is not None:
                    body.visibility = float(visible)

    def _capture(self) -> tuple[NDArray[np.uint8], NDArray[np.uint16], NDArray[np.integer[Any]], dict[str, int]]:
        """Return colour (H, W, 3), depth (H, W) [mm], segmentation ids (H, W), and the ids of the links by name."""
        self.env.scene.update_render(update_sensors=True, update_human_render_cameras=False)
        sensor = self.env._sensors[self._camera_name]
        sensor.capture()
        [camera] = sensor.camera._render_cameras  # without ManiSkill's tensors, which take a sixth of the image's time
        place = camera.get_picture("PositionSegmentation")  # x, y, z in OpenGL's axes [mm], segmentation id
        depth = np.clip(-place[..., 2], 0, None).astype(np.uint16)
        ids = {name: int(link.per_scene_id[0]) for name, link in self.env.agent.robot.links_map.items()}
        return np.array(camera.get_picture("Color")[..., :3]), depth, place[..., 3], ids

    def render(self) -> CameraImage:
        """Render the current state."""
        rgb, depth_mm, labels, ids = self._capture()
        return CameraImage(
            rgb=rgb,
            depth_mm=depth_mm,
            mask=np.isin(labels, [i for name, i in ids.items() if name in GRIPPER_LINKS]),
            robot=np.isin(labels, list(ids.values())),
        )
