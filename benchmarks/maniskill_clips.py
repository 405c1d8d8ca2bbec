"""Render clips of ManiSkill's stock tasks at their own cameras, with exact poses.

    python benchmarks/maniskill_clips.py OUT --count 12 --seed 100

Writes OUT/NAME.mp4, OUT/NAME.gt.npz and OUT/manifest.jsonl, in the layout of `python -m benchmarks footage`. Poses and
cameras are those that the simulator states.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import gymnasium
import mani_skill.envs  # noqa: F401 - registers the tasks
import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.environment.native import prepare_vulkan
from kinebench_drake.geometry import Array, invert, orthonormalize
from kinebench_drake.io.container import write_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import hand_from_tcp

VIEWS = (
    ("PickCube-v1", "render_camera"),
    ("StackCube-v1", "base_camera"),
    ("PegInsertionSide-v1", "render_camera"),
    ("PlaceSphere-v1", "render_camera"),
    ("PokeCube-v1", "render_camera"),
    ("PullCubeTool-v1", "base_camera"),
    ("RollBall-v1", "render_camera"),
    ("StackPyramid-v1", "base_camera"),
    ("LiftPegUpright-v1", "render_camera"),
    ("PullCube-v1", "render_camera"),
    ("PushCube-v1", "base_camera"),
    ("StackCube-v1", "render_camera"),
)
"""Tasks, and the camera of each: that of its videos, or that of its policies' observations."""
PERIOD_S = 0.2
"""Task time between two frames [s]."""
_SIDE_PX = 256
"""Width and height of pictures by the cameras of observations [px]; videos have the size of the task."""
_USUAL_Q = np.array([0.0, np.pi / 8, 0.0, -5 * np.pi / 8, 0.0, 3 * np.pi / 4, np.pi / 4])
_SPREAD_RAD = np.array([0.4, 0.3, 0.3, 0.35, 0.3, 0.35, 0.8])
_LOWEST_M = 0.04
_STEP_FRAMES = 8


def motion(plant: ArmPlant, frames: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return postures (T, 7) [rad] and finger gaps (T,) [m] of a smooth motion through postures above the table."""
    stops = list[Array]()
    while len(stops) < max(2, frames // _STEP_FRAMES + 1):
        q = np.clip(_USUAL_Q + rng.normal(0.0, 1.0, 7) * _SPREAD_RAD, plant.lower + 0.1, plant.upper - 0.1)
        if plant.forward(q)[2, 3] > _LOWEST_M:
            stops.append(q)
    s = np.linspace(0.0, len(stops) - 1, frames)
    first = np.minimum(s.astype(int), len(stops) - 2)
    u = s - first
    u = u**3 * (10 - 15 * u + 6 * u**2)  # minimum jerk (Flash and Hogan 1985)
    postures = np.array(stops)
    gap = rng.uniform(0.0, 0.08, len(stops))
    return (1 - u)[:, None] * postures[first] + u[:, None] * postures[first + 1], (1 - u) * gap[first] + u * gap[
        first + 1
    ]


class StockScene:
    """A stock task with the Panda, and its camera."""

    def __init__(self, task: str, camera: str, seed: int) -> None:
        """Create the scene; `seed` places its objects."""
        sensors = {"width": _SIDE_PX, "height": _SIDE_PX} if camera == "base_camera" else {}
        self._env: Any = gymnasium.make(
            task, robot_uids="panda", obs_mode="rgb", render_mode="rgb_array", sim_backend="cpu", sensor_configs=sensors
        )
        self._env.reset(seed=seed)
        self._scene = self._env.unwrapped.scene
        self._robot = self._env.unwrapped.agent.robot
        cameras = self._scene.human_render_cameras if camera == "render_camera" else self._scene.sensors
        self._camera = cameras[camera]

    @property
    def X_WB(self) -> Array:
        """Pose (4, 4) of panda_link0 in the world [m]."""
        return np.asarray(self._robot.pose.to_transformation_matrix()[0].numpy(), dtype=np.float64)

    @property
    def camera(self) -> Camera:
        """The camera, as the simulator states it."""
        parameters = self._camera.get_params()
        K = parameters["intrinsic_cv"][0].numpy()
        X_CW = np.eye(4)
        X_CW[:3] = parameters["extrinsic_cv"][0].numpy()[:3]
        X_CW[:3, :3] = orthonormalize(X_CW[:3, :3])
        height, width = self.image().shape[:2]
        focal = np.diag(K)[:2].astype(float)
        centre = K[:2, 2].astype(float)
        return Camera(
            width=width, height=height, fx=focal[0], fy=focal[1], cx=centre[0], cy=centre[1],
            X_BC=invert(X_CW @ self.X_WB),
        )  # fmt: skip

    def set(self, q: Array, width_m: float) -> None:
        """Pose the arm (7,) [rad] and the fingers, `width_m` apart."""
        self._robot.set_qpos(np.concatenate([q, np.full(2, width_m / 2)]).astype(np.float32))

    def image(self) -> np.ndarray:
        """Return the image (H, W, 3)."""
        self._scene.update_render()
        self._camera.capture()
        return np.asarray(self._camera.get_obs(rgb=True, depth=False, segmentation=False, position=False)["rgb"][0])

    def close(self) -> None:
        """Free the scene."""
        self._env.close()


def main() -> None:
    """Render clips of the stock tasks, in turn."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=len(VIEWS))
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--frames", type=int, default=17)
    options = parser.parse_args()
    prepare_vulkan()
    options.out.mkdir(parents=True, exist_ok=True)
    plant = ArmPlant()
    for number in range(options.count):
        task, view = VIEWS[number % len(VIEWS)]
        name = f"k{number:02d}"
        if (options.out / f"{name}.gt.npz").exists():
            continue
        scene = StockScene(task, view, options.seed + number)
        q, gap = motion(plant, options.frames, np.random.default_rng([options.seed, number]))
        frames = []
        for posture, width_m in zip(q, gap, strict=True):
            scene.set(posture, width_m)
            frames.append(scene.image())
        write_video(options.out / f"{name}.mp4", frames, fps=17, crf=20)
        X_BG = np.array([plant.forward(posture) for posture in q])
        np.savez_compressed(
            options.out / f"{name}.gt.npz",
            base_from_hand=X_BG @ invert(hand_from_tcp()), base_from_tcp=X_BG, q=q, finger_width_m=gap,
        )  # fmt: skip
        line = {"video": f"{name}.mp4", "frame_period_s": PERIOD_S, "camera": scene.camera.to_json()}
        with (options.out / "manifest.jsonl").open("a") as manifest:
            manifest.write(json.dumps({**line, "task": task}) + "\n")
        scene.close()
        print(name, task, view, flush=True)


if __name__ == "__main__":
    main()
