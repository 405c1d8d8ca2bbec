"""ManiSkill environments of the tasks: `gymnasium.make("KineBench/StackCube-v1")` after `register()`.

They run on the CPU and, in batches, on ManiSkill's GPU simulation. ManiSkill's own tasks of the same names are not
affected. A single environment is rebuilt at every reset, because each seed has its own assets and looks.
"""

from collections.abc import Sequence
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
from kinebench_drake.errors import InputError
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.suites.composition import Episode, Pool, compose
from kinebench_drake.suites.families.registry import TASKS, find_task
from kinebench_drake.suites.families.task import Scene, SceneLayout, TaskVariant
from kinebench_drake.suites.scene.builder import X_WB, build_actor, build_articulation, camera_config, to_pose
from kinebench_drake.suites.scene.look import background, light, surroundings, table
from kinebench_drake.suites.scene.rendering import simplify_arm, software_shaders
from kinebench_drake.suites.scene.state import ARM, State
from kinebench_drake.suites.start import start_q

NAMESPACE = "KineBench"
"""Gymnasium namespace of the tasks."""


class KineBenchEnv(BaseEnv):  # type: ignore[misc]
    """Environment of one task.

    `reset(seed=...)` composes the episode of that seed; `reset(options={"episodes": [episode, ...]})` uses one episode
    per scene. `evaluate()` returns `success`, `progress` (0..1) and the task's named sub-conditions.
    """

    SUPPORTED_ROBOTS = ("panda", "panda_wristcam")
    SUPPORTED_REWARD_MODES = ("sparse", "dense", "normalized_dense", "none")
    agent: Panda | PandaWristCam

    def __init__(
        self,
        *args: Any,
        task: str,
        robot_uids: str = "panda",
        pool: str = "all",
        variant: str = "plain",
        camera: Camera | None = None,
        **kwargs: Any,
    ) -> None:
        """Make the environment.

        Args:
            robot_uids: "panda" or "panda_wristcam".
            pool: assets and looks to draw from: "all", "seen" or "unseen".
            variant: "plain" or "obstacles".
            camera: camera of the observations; None: the benchmark's.

        Raises:
            UsageError: the task is unknown or has no such variant.
        """
        self.task = find_task(task, TaskVariant(variant))
        self._pool = Pool(pool)
        self._variant = TaskVariant(variant)
        self._camera = benchmark_camera() if camera is None else camera
        self.episodes: list[Episode] = []
        self.layouts: list[SceneLayout] = []
        self._starts: dict[str, Tensor] = {}
        self._joint_starts: dict[str, Tensor] = {}
        kwargs.setdefault("reconfiguration_freq", 1 if kwargs.get("num_envs", 1) == 1 else 0)
        super().__init__(*args, robot_uids=robot_uids, **kwargs)

    @property
    def _by_software(self) -> bool:
        """Whether images are rendered on the CPU."""
        return self._render_device is not None and bool(self._render_device.is_cpu())

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return [camera_config(self._camera, software_shaders() if self._by_software else None)]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        config = camera_config(self._camera)
        config.uid = "render_camera"
        return config

    def _load_agent(self, options: dict[str, Any]) -> None:
        super()._load_agent(options, sapien.Pose(X_WB[:3, 3]))
        if self._by_software:
            simplify_arm(self.agent.robot)

    def _compose(self, options: dict[str, Any]) -> None:
        """Set the episodes and layouts of all scenes."""
        episodes: Sequence[Episode] | None = options.get("episodes")
        if episodes is None:
            episodes = [
                compose(self.task.card.id, int(seed), pool=self._pool, variant=self._variant)
                for seed in self._episode_seed
            ]
        if len(episodes) != self.num_envs or any(e.task != self.task.card.id for e in episodes):
            raise InputError(
                f"{self.num_envs} episodes of {self.task.card.id} are expected, got "
                f"{len(episodes)} of {', '.join(sorted({e.task for e in episodes}))}"
            )
        self.episodes = list(episodes)
        self.layouts = [episode.layout() for episode in episodes]

    def _load_scene(self, options: dict[str, Any]) -> None:
        self._compose(options)
        self._fresh = True
        names = list(self.layouts[0].placements)
        for i, episode in enumerate(self.episodes):
            for name, body in surroundings(table(episode.table), background(episode.background)).items():
                build_actor(self.scene, f"{name}_{i}", body, X_WB, [i], physics="static")
        self.objects: dict[str, Actor | Articulation] = {name: self._load_object(name) for name in names}

    def _load_object(self, name: str) -> Actor | Articulation:
        """Build the object with a name in all scenes."""
        built: list[Any] = []
        for i, layout in enumerate(self.layouts):
            placement = layout.placements[name]
            own_name = name if self.num_envs == 1 else f"{name}_{i}"
            X_WM = X_WB @ placement.X_BM
            if placement.model.articulated:
                built.append(build_articulation(self.scene, own_name, placement.model, X_WM, [i]))
            else:
                [body] = placement.model.bodies
                if placement.decor:
                    body = replace(body, colliders=())
                built.append(
                    build_actor(
                        self.scene, own_name, body, X_WM, [i], physics="kinematic" if placement.decor else "dynamic"
                    )
                )
        if self.num_envs == 1:
            return built[0]
        for part in built:  # replaced by one merged entry for all scenes
            self.scene.remove_from_state_dict_registry(part)
        merged: Actor | Articulation = (
            Articulation.merge(built, name=name, merge_links=True)
            if isinstance(built[0], Articulation)
            else Actor.merge(built, name=name)
        )
        self.scene.add_to_state_dict_registry(merged)
        return merged

    def _load_lighting(self, options: dict[str, Any]) -> None:
        for i, episode in enumerate(self.episodes):
            look = light(episode.light)
            self.scene.sub_scenes[i].ambient_light = look.ambient
            self.scene.add_directional_light(
                look.key_direction, look.key_color, shadow=True, shadow_scale=1.5, shadow_map_size=1024, scene_idxs=[i]
            )
            self.scene.add_directional_light(look.fill_direction, look.fill_color, shadow=False, scene_idxs=[i])

    def _initialize_episode(self, env_idx: Tensor, options: dict[str, Any]) -> None:
        if not self._fresh:
            self._redraw_poses(env_idx, options)
        self._fresh = False
        with torch.device(self.device):
            rows = [int(i) for i in env_idx]
            q = np.stack(
                [start_q(self.task.card.id, self.episodes[i].seed, self.layouts[i].finger_width_m) for i in rows]
            )
            self.agent.reset(q.astype(np.float32))
            self.agent.robot.set_pose(sapien.Pose(X_WB[:3, 3]))
            for name, entity in self.objects.items():
                placements = [self.layouts[i].placements[name] for i in rows]
                entity.set_pose(Pose.create([to_pose(X_WB @ p.X_BM) for p in placements], device=self.device))
                if isinstance(entity, Articulation):
                    joint = torch.tensor([[p.joint] for p in placements], dtype=torch.float32)
                    entity.set_qpos(joint)
                    entity.set_qvel(torch.zeros_like(joint))
                elif not placements[0].decor:
                    entity.set_linear_velocity(torch.zeros(len(rows), 3))
                    entity.set_angular_velocity(torch.zeros(len(rows), 3))
        if self.gpu_sim_enabled:
            self.scene._gpu_apply_all()
            self.scene.px.gpu_update_articulation_kinematics()
            self.scene._gpu_fetch_all()
        self._store_starts(env_idx)

    def _redraw_poses(self, env_idx: Tensor, options: dict[str, Any]) -> None:
        """Draw new layouts for the assets that are built already, where scenes are not rebuilt."""
        episodes: Sequence[Episode] | None = options.get("episodes")
        for i in map(int, env_idx):
            old = self.episodes[i]
            new = old.reseeded(int(self._episode_seed[i])) if episodes is None else episodes[i]
            if (new.assets, new.table, new.background, new.light) != (old.assets, old.table, old.background, old.light):
                raise InputError("an episode with other assets or looks needs options={'reconfigure': True}")
            layout = new.layout()
            for name, placement in layout.placements.items():
                if placement.model.asset_id != self.layouts[i].placements[name].model.asset_id:
                    raise InputError(f"{name} has another asset: that needs options={{'reconfigure': True}}")
            self.episodes[i] = new
            self.layouts[i] = layout

    def _store_starts(self, env_idx: Tensor) -> None:
        """Store the current poses and joint positions of some scenes as those of the episode's start."""
        poses = self._body_poses()
        joints = self._joints()
        if not self._starts or len(env_idx) == self.num_envs:
            self._starts = poses
            self._joint_starts = joints
            return
        for now, start in ((poses, self._starts), (joints, self._joint_starts)):
            for name, value in now.items():
                start[name][env_idx] = value[env_idx]

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
                for body in self.layouts[0].placements[name].model.bodies[1:]:
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
            elif not self.layouts[0].placements[name].decor:
                speeds[name] = torch.linalg.norm(entity.linear_velocity, dim=-1)
        return speeds

    def state(self) -> State:
        """Return the current state of all scenes."""
        return State(
            X_BG=self._in_base(self.agent.tcp.pose),
            finger_width_m=self.agent.robot.qpos[:, -2:].sum(dim=-1),
            poses=self._body_poses(),
            starts=self._starts,
            joints=self._joints(),
            joint_starts=self._joint_starts,
            speeds=self._speeds(),
            models={name: [layout.placements[name].model for layout in self.layouts] for name in self.objects},
            grasps=lambda name: self.agent.is_grasping(self.objects[name]),
        )

    def first_scene(self) -> Scene:
        """Return the first scene as an expert receives it."""
        state = self.state()
        return Scene(
            X_BG=state.X_BG[0].cpu().numpy().astype(np.float64),
            finger_width_m=float(state.finger_width_m[0]),
            poses={name: X[0].cpu().numpy().astype(np.float64) for name, X in state.poses.items()},
            joints={name: float(x[0]) for name, x in state.joints.items()},
            models={name: models[0] for name, models in state.models.items()},
            avoided=self.layouts[0].avoided,
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

    def compute_dense_reward(self, obs: Any, action: Tensor, info: dict[str, Any]) -> Tensor:
        """Return the progress, plus 1 for success."""
        reward: Tensor = info["progress"] + info["success"]
        return reward

    def compute_normalized_dense_reward(self, obs: Any, action: Tensor, info: dict[str, Any]) -> Tensor:
        """Return half the dense reward."""
        return self.compute_dense_reward(obs, action, info) / 2.0


def environment_id(task: str) -> str:
    """Return the gymnasium id of a plain task id."""
    return f"{NAMESPACE}/{task}"


def register() -> None:
    """Register the tasks with gymnasium and ManiSkill; repeated calls have no effect."""
    for name in TASKS:
        uid = environment_id(name)
        if uid not in REGISTERED_ENVS:
            register_env(uid, max_episode_steps=192 * TASKS[name].card.clips, task=name)(KineBenchEnv)
