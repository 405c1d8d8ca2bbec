"""How fast environments, pictures and demonstrations are: `python -m benchmarks.simulation --help`.

ManiSkill's own StackCube-v1 is measured in the same run with the same camera, control mode and simulation rates, turn
about, so that ratios hold whatever else the machine does.
"""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from benchmarks.markdown import replace_section, table
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.environment.native import prepare_vulkan
from kinebench_drake.errors import KinebenchError
from kinebench_drake.geometry import Array
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.clock import CLIP_FRAMES
from kinebench_drake.suites.episode import compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import render_video, run_expert
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.tasks.registry import TASKS

HEADING = "## Simulation"
"""Heading of the section that is written into the document."""
STEPS, PICTURES, ROUNDS = 40, 8, 5
"""Control steps and pictures timed in a round, and rounds."""
STOCK = "StackCube-v1"
"""Task that ManiSkill has, too."""
FPS = 17


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Wall times of one task."""

    task: str
    step_ms: float
    """Median control step, state only, `evaluate` included."""
    picture_ms: float
    """Median picture of 384x384: colour, depth and segmentation."""
    reset_ms: float
    """A reset, scene rebuilt."""
    demo_s: float
    """One clip of 49 frames: composed, planned, performed, filmed and encoded."""


def _median_ms(action: Callable[[], object], times: int) -> float:
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        action()
        taken.append(time.perf_counter() - start)
    return 1000.0 * float(np.median(taken))


def time_task(task: str, out: Path) -> Timing:
    """Time one task, scene made and shaders compiled before."""
    episode = compose(task, 0)
    with Simulator(task) as stage:
        stage.reset(episode)
        stage.render()
        rest = stage.snapshot()
        reset_ms = _median_ms(lambda: stage.reset(episode), 3)
        stage.render()
        step_ms = _median_ms(lambda: stage.step(rest.q, float(rest.fingers_m.sum())), ROUNDS * STEPS)
        picture_ms = _median_ms(stage.render, ROUNDS * PICTURES)
        start = time.perf_counter()
        performance = run_expert(stage, find_expert(task), compose(task, 1))
        clip = render_video(stage, performance.snapshots[: CLIP_FRAMES + 1])
        write_video(out / f"{task}.mp4", clip.rgb, FPS)
        demo_s = time.perf_counter() - start
    return Timing(task=task, step_ms=step_ms, picture_ms=picture_ms, reset_ms=reset_ms, demo_s=demo_s)


class _Stock:
    """ManiSkill's own task, set up as ours is."""

    def __init__(self) -> None:
        backend = prepare_vulkan()
        import gymnasium
        import mani_skill.envs  # noqa: F401 (registers the tasks)

        from kinebench_drake.suites.start import START_Q
        from kinebench_drake.suites.tasks.environment import camera_config

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


def against_stock() -> tuple[Array, Array]:
    """Times ours / ManiSkill's own (ROUNDS,) of a control step and of a picture, in turn in one process."""
    stock = _Stock()
    steps, pictures = [], []
    with Simulator(STOCK) as stage:
        stage.reset(compose(STOCK, 0))
        rest = stage.snapshot()

        def step() -> None:
            stage.step(rest.q, 0.08)

        stage.render()
        stock.render()
        for _ in range(ROUNDS):
            steps.append(_median_ms(step, STEPS) / _median_ms(stock.step, STEPS))
            pictures.append(_median_ms(stage.render, PICTURES) / _median_ms(stock.render, PICTURES))
    stock.close()
    return np.array(steps), np.array(pictures)


def section(timings: Sequence[Timing], steps: Array, pictures: Array) -> str:
    """The document's section."""
    rows = [
        (t.task, f"{t.step_ms:.1f}", f"{t.picture_ms:.0f}", f"{t.reset_ms:.0f}", f"{t.demo_s:.1f}") for t in timings
    ]
    worst = [max(getattr(t, name) for t in timings) for name in ("step_ms", "picture_ms", "demo_s")]
    return "\n".join(
        [
            HEADING,
            "",
            f"Written by `python -m benchmarks.simulation` on {os.cpu_count()} cores, rendering on the "
            f"{prepare_vulkan()}; wall times. Step: one control step of 0.05 s with the task's verdict, no picture. "
            "Picture: 384x384, colour, depth and segmentation. Reset: with the scene rebuilt. Demonstration: a clip of "
            "49 frames planned, performed, filmed and encoded as mp4.",
            "",
            *table(("task", "step, ms", "picture, ms", "reset, ms", "demonstration, s"), rows),
            "",
            f"The slowest: {worst[0]:.1f} ms a step, {worst[1]:.0f} ms a picture, {worst[2]:.1f} s a demonstration. "
            f"Beside ManiSkill's own {STOCK}, in turn in one process: a step takes {np.median(steps):.2f} times as "
            f"long ({steps.min():.2f} to {steps.max():.2f}), a picture {np.median(pictures):.2f} times "
            f"({pictures.min():.2f} to {pictures.max():.2f}).",
            "",
        ]
    )


@click.command(
    epilog="\b\nExample:\n  python -m benchmarks.simulation --out docs/benchmarks.md",
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False, exists=True), help="Document to write into.")
@click.option("--tasks", default=",".join(TASKS), help="Tasks, comma-separated.  [default: all]", metavar="A,B")
def main(out: Path | None, tasks: str) -> None:
    """Time environments, pictures and demonstrations."""
    try:
        with TemporaryDirectory() as folder:
            timings = [time_task(task, Path(folder)) for task in tasks.split(",")]
        text = section(timings, *against_stock())
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None
    click.echo(text)
    if out is not None:
        out.write_text(replace_section(out.read_text(), text))


if __name__ == "__main__":
    main()
