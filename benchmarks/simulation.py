"""Speed of environments, rendering and demonstrations.

ManiSkill's own StackCube-v1 is measured in the same run with the same camera, control mode and simulation rates, in
turn, so that ratios are independent of other load.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks import markdown
from benchmarks.record import machine_text
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.environment.native import prepare_vulkan
from kinebench_drake.geometry import Array
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.clock import CLIP_FRAMES
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import render_video, run_expert
from kinebench_drake.suites.simulator import Simulator, Snapshot

STEPS = 40
IMAGES = 8
ROUNDS = 5
"""Control steps and images timed in a round, and rounds."""
STOCK = "StackCube-v1"
"""Task that ManiSkill also has."""
FPS = 17


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskTiming:
    """Wall times of one task."""

    task: str
    step_ms: float
    """Median control step with the task's verdict, state only."""
    image_ms: float
    """Median image of 384x384: colour, depth and segmentation."""
    reset_ms: float
    """Median reset with a rebuilt scene."""
    demo_s: float
    """One clip of 49 frames: composed, planned, executed, rendered and encoded [s]."""


_COLUMNS = {"step, ms": "step_ms", "image, ms": "image_ms", "reset, ms": "reset_ms", "demonstration, s": "demo_s"}


def _median_ms(action: Callable[[], object], times: int) -> float:
    seconds = []
    for _ in range(times):
        start = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - start)
    return 1000.0 * float(np.median(seconds))


def _step(simulator: Simulator, rest: Snapshot) -> None:
    simulator.step(rest.q, rest.finger_width_m)
    simulator.outcome()


def time_task(task: str, out: Path) -> TaskTiming:
    """Time one task after its scene is built and its shaders are compiled."""
    episode = compose(task, 0)
    with Simulator(task) as simulator:
        simulator.reset(episode)
        simulator.render()
        rest = simulator.snapshot()
        reset_ms = _median_ms(lambda: simulator.reset(episode), 3)
        simulator.render()
        step_ms = _median_ms(lambda: _step(simulator, rest), ROUNDS * STEPS)
        image_ms = _median_ms(simulator.render, ROUNDS * IMAGES)
        start = time.perf_counter()
        rollout = run_expert(simulator, find_expert(task), compose(task, 1))
        video = render_video(simulator, rollout.snapshots[: CLIP_FRAMES + 1])
        write_video(out / f"{task}.mp4", video.rgb, FPS)
        demo_s = time.perf_counter() - start
    return TaskTiming(task=task, step_ms=step_ms, image_ms=image_ms, reset_ms=reset_ms, demo_s=demo_s)


class _StockTask:
    """ManiSkill's own task with our camera, control mode and rates."""

    def __init__(self) -> None:
        backend = prepare_vulkan()
        import gymnasium
        import mani_skill.envs  # noqa: F401 (registers the tasks)

        from kinebench_drake.suites.scene.builder import camera_config
        from kinebench_drake.suites.start import START_Q

        self._env: Any = gymnasium.make(
            STOCK,
            obs_mode="none",
            reward_mode="none",
            control_mode="pd_joint_pos",
            sim_backend="cpu",
            render_backend=backend,
        ).unwrapped
        config = camera_config(benchmark_camera())
        sensor = {"pose": config.pose, "width": 384, "height": 384, "fov": None, "intrinsic": config.intrinsic}
        self._env._custom_sensor_configs = {config.uid: sensor}
        self._env.reset(seed=0, options={"reconfigure": True})
        self._camera = self._env._sensors[config.uid]
        self._action = np.append(START_Q, 1.0).astype(np.float32)

    def step(self) -> None:
        self._env.step(self._action)

    def render(self) -> None:
        self._env.scene.update_render(update_sensors=True, update_human_render_cameras=False)
        self._camera.capture()
        self._camera.get_obs(rgb=True, depth=True, position=False, segmentation=True)

    def close(self) -> None:
        self._env.close()


def compare_with_stock() -> tuple[Array, Array]:
    """Return times ours / ManiSkill's own (ROUNDS,) of a control step and of an image, in turn in one process."""
    stock = _StockTask()
    steps = []
    images = []
    with Simulator(STOCK) as simulator:
        simulator.reset(compose(STOCK, 0))
        rest = simulator.snapshot()
        simulator.render()
        stock.render()
        for _ in range(ROUNDS):
            steps.append(_median_ms(lambda: _step(simulator, rest), STEPS) / _median_ms(stock.step, STEPS))
            images.append(_median_ms(simulator.render, IMAGES) / _median_ms(stock.render, IMAGES))
    stock.close()
    return np.array(steps), np.array(images)


def section(timings: Sequence[TaskTiming], steps: Array, images: Array) -> str:
    """Return the section of the document."""
    rows = [
        [name, f"{np.median(values):.2g}", f"{max(values):.2g}"]
        for name, key in _COLUMNS.items()
        for values in [[getattr(timing, key) for timing in timings]]
    ]
    return markdown.section(
        "Simulation",
        f"`python -m benchmarks simulation` on {machine_text()}, rendering on the {prepare_vulkan()}; wall times of "
        f"{len(timings)} tasks. Step: one control step of 0.05 s with the task's verdict, no image. Image: 384x384, "
        "colour, depth and segmentation. Demonstration: a clip of 49 frames planned, executed, rendered and encoded.",
        markdown.table(("what", "median", "slowest task"), rows),
        f"Compared with ManiSkill's own {STOCK}, in turn in one process, a step takes "
        f"{np.median(steps):.2f} times as long ({steps.min():.2f} to {steps.max():.2f}), an image "
        f"{np.median(images):.2f} times ({images.min():.2f} to {images.max():.2f}).",
    )


def measure(tasks: Sequence[str]) -> tuple[list[TaskTiming], Array, Array]:
    """Time tasks; with the ratios of steps and of images to those of ManiSkill's own task."""
    with TemporaryDirectory() as folder:
        timings = [time_task(task, Path(folder)) for task in tasks]
    return timings, *compare_with_stock()


def figures(timings: Sequence[TaskTiming]) -> dict[str, float]:
    """Return the medians over the tasks."""
    return {name: float(np.median([getattr(timing, key) for timing in timings])) for name, key in _COLUMNS.items()}
