"""ManiSkill environments of the tasks: `gymnasium.make("KineBench/StackCube-v1")` after `register()`.

One scene on the CPU, which is rebuilt at every reset, because each seed has its own assets and looks. ManiSkill's own
tasks of the same names are not affected.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.agents.robots import Panda, PandaWristCam
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import REGISTERED_ENVS, register_env
from mani_skill.utils.structs import Actor, Articulation
from mani_skill.utils.structs.pose import Pose
from numpy.typing import NDArray
from torch import Tensor

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.suites.composition import Episode, Pool, compose
from kinebench_drake.suites.families.registry import TASKS, find_task
from kinebench_drake.suites.families.task import Placement, Scene, TaskVariant
from kinebench_drake.suites.scene.builder import X_WB, build_actor, build_articulation, camera_config, to_pose
from kinebench_drake.suites.scene.look import background, light, surroundings, table
from kinebench_drake.suites.scene.rendering import simplify_arm, software_shaders
from kinebench_drake.suites.scene.state import ARM, State
from kinebench_drake.suites.start import start_q

NAMESPACE = "KineBench"
"""Gymnasium namespace of the tasks."""


class KineBenchEnv(BaseEnv):  # type: ignore[misc]
    """Environment of one task.

    `reset(seed=...)` composes the episode of that seed; `reset(options={"episode": episode})` uses this one.
    `evaluate()` returns `success`, `progress` (0..1) and the task's named sub-conditions.
    """

    SUPPORTED_ROBOTS = ("panda", "panda_wristcam")
    SUPPORTED_REWARD_MODES = ("sparse", "none")
    agent: Panda | PandaWristCam

    def __init__(
        self,
        *args: Any,
        task: str,
        robot_uids: str = "panda",
        pool: str = "all",
        variant: str = "plain",
        camera: Camera | None = None,
        num_envs: int = 1,
        **kwargs: Any,
    ) -> None:
        """Make the environment.

        Args:
            robot_uids: "panda" or "panda_wristcam".
            pool: assets and looks to draw from: "all", "seen" or "unseen".
            variant: "plain" or "obstacles".
            camera: camera of the observations; None: the benchmark's.
            num_envs: 1.

        Raises:
            UsageError: the task is unknown or has no such variant, or several scenes are asked for.
        """
        if num_envs != 1:
            raise UsageError(
                f"num_envs is {num_envs}, expected 1: each scene has its own assets; run several processes"
            )
        self.task = find_task(task, TaskVariant(variant))
        self._pool = Pool(pool)
        self._variant = TaskVariant(variant)
        self._camera = benchmark_camera() if camera is None else camera
        super().__init__(*args, robot_uids=robot_uids, reconfiguration_freq=1, **kwargs)

    @property
    def _by_software(self) -> bool:
        """Whether images are rendered on the CPU."""
        return self._render_device is not None and bool(self._render_device.is_cpu())

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return [camera_config(self._camera, software_shaders() if self._by_software else None)]

    def _load_agent(self, options: dict[str, Any]) -> None:
        super()._load_agent(options, sapien.Pose(X_WB[:3, 3]))
        if self._by_software:
            simplify_arm(self.agent.robot)

    def _load_scene(self, options: dict[str, Any]) -> None:
        seed = int(self._episode_seed[0])
        episode = options.get("episode") or compose(self.task.card.id, seed, pool=self._pool, variant=self._variant)
        if episode.task != self.task.card.id:
            raise InputError(f"an episode of {self.task.card.id} is expected, got one of {episode.task}")
        self.episode: Episode = episode
        self.layout = episode.layout()
        for name, body in surroundings(table(episode.table), background(episode.background)).items():
            build_actor(self.scene, f"{name}_0", body, X_WB, physics="static")
        self.objects: dict[str, Actor | Articulation] = {
            name: self._load_object(name, placement) for name, placement in self.layout.placements.items()
        }

    def _load_object(self, name: str, placement: Placement) -> Actor | Articulation:
        X_WM = X_WB @ placement.X_BM
        if placement.model.articulated:
            return build_articulation(self.scene, name, placement.model, X_WM)
        [body] = placement.model.bodies
        if placement.decor:
            return build_actor(self.scene, name, replace(body, colliders=()), X_WM, physics="kinematic")
        return build_actor(self.scene, name, body, X_WM, physics="dynamic")

    def _load_lighting(self, options: dict[str, Any]) -> None:
        look = light(self.episode.light)
        self.scene.ambient_light = look.ambient
        self.scene.add_directional_light(
            look.key_direction, look.key_color, shadow=True, shadow_scale=1.5, shadow_map_size=1024
        )
        self.scene.add_directional_light(look.fill_direction, look.fill_color, shadow=False)

    def _initialize_episode(self, env_idx: Tensor, options: dict[str, Any]) -> None:
        q = start_q(self.task.card.id, self.episode.seed, self.layout.finger_width_m)
        self.agent.reset(q[None].astype(np.float32))
        self.agent.robot.set_pose(sapien.Pose(X_WB[:3, 3]))
        for name, entity in self.objects.items():
            placement = self.layout.placements[name]
            entity.set_pose(to_pose(X_WB @ placement.X_BM))
            if isinstance(entity, Articulation):
                joint = torch.tensor([[placement.joint]], dtype=torch.float32)
                entity.set_qpos(joint)
                entity.set_qvel(torch.zeros_like(joint))
            elif not placement.decor:
                entity.set_linear_velocity(torch.zeros(1, 3))
                entity.set_angular_velocity(torch.zeros(1, 3))
        self._starts = self._body_poses()
        self._joint_starts = self._joints()

    def _in_base(self, pose: Pose) -> Tensor:
        """Convert poses of the ManiSkill world to matrices (N, 4, 4) in B."""
        X: Tensor = pose.to_transformation_matrix().clone()
        X[:, :3, 3] -= torch.as_tensor(X_WB[:3, 3], dtype=X.dtype, device=X.device)
        return X

    def _body_poses(self) -> dict[str, Tensor]:
        poses = {}
        for name, entity in self.objects.items():
            poses[name] = self._in_base(entity.pose)
            if isinstance(entity, Articulation):
                for body in self.layout.placements[name].model.bodies[1:]:
                    poses[f"{name}/{body.name}"] = self._in_base(entity.links_map[body.name].pose)
        return poses

    def _joints(self) -> dict[str, Tensor]:
        return {name: x.qpos[:, 0].clone() for name, x in self.objects.items() if isinstance(x, Articulation)}

    def _speeds(self) -> dict[str, Tensor]:
        """Return the speeds (N,) of the joints of articulations, of free objects, and of the arm."""
        speeds: dict[str, Tensor] = {ARM: self.agent.robot.qvel[:, :N_JOINTS].abs().amax(dim=-1)}
        for name, entity in self.objects.items():
            if isinstance(entity, Articulation):
                speeds[name] = entity.qvel[:, 0].abs()
            elif not self.layout.placements[name].decor:
                speeds[name] = torch.linalg.norm(entity.linear_velocity, dim=-1)
        return speeds

    def state(self) -> State:
        """Return the current state."""
        return State(
            X_BG=self._in_base(self.agent.tcp.pose),
            finger_width_m=self.agent.robot.qpos[:, -2:].sum(dim=-1),
            poses=self._body_poses(),
            starts=self._starts,
            joints=self._joints(),
            joint_starts=self._joint_starts,
            speeds=self._speeds(),
            models={name: [p.model] for name, p in self.layout.placements.items()},
            grasps=lambda name: self.agent.is_grasping(self.objects[name]),
        )

    def first_scene(self) -> Scene:
        """Return the scene as an expert receives it."""
        state = self.state()
        return Scene(
            X_BG=state.X_BG[0].cpu().numpy().astype(np.float64),
            finger_width_m=float(state.finger_width_m[0]),
            poses={name: X[0].cpu().numpy().astype(np.float64) for name, X in state.poses.items()},
            joints={name: float(x[0]) for name, x in state.joints.items()},
            models={name: models[0] for name, models in state.models.items()},
            avoided=self.layout.avoided,
        )

    def advance(self, action: NDArray[np.float32]) -> None:
        """Simulate one control step; unlike `step` neither evaluates the task nor observes."""
        self._step_action(action)
        self._elapsed_steps += 1

    def evaluate(self) -> dict[str, Tensor]:
        """Return success, progress 0..1 and the task's sub-conditions, each (N,)."""
        state = self.state()
        conditions = self.task.conditions(state)
        success = torch.stack(list(conditions.values())).all(dim=0)
        progress = self.task.progress(state).clamp(0.0, 1.0)
        return {"success": success, "progress": torch.where(success, torch.ones_like(progress), progress), **conditions}

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, Tensor]:
        extra = {"tcp_pose": self.agent.tcp.pose.raw_pose}
        if self.obs_mode_struct.use_state:
            extra |= {f"{name}_pose": entity.pose.raw_pose for name, entity in self.objects.items()}
        return extra


def environment_id(task: str) -> str:
    """Return the gymnasium id of a plain task id."""
    return f"{NAMESPACE}/{task}"


def register() -> None:
    """Register the tasks with gymnasium and ManiSkill; repeated calls have no effect."""
    for name in TASKS:
        uid = environment_id(name)
        if uid not in REGISTERED_ENVS:
            register_env(uid, max_episode_steps=192 * TASKS[name].card.clips, task=name)(KineBenchEnv)
