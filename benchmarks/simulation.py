"""Speed of environments, rendering and demonstrations."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks import markdown
from benchmarks.record import machine_text
from kinebench_drake.environment.native import prepare_vulkan
from kinebench_drake.io.container import write_video
from kinebench_drake.suites.clock import CLIP_FRAMES
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import render_video, run_expert
from kinebench_drake.suites.simulator import Simulator, Snapshot

STEPS = 200
IMAGES = 40
RESETS = 3
"""Control steps, images and resets timed."""
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
        reset_ms = _median_ms(lambda: simulator.reset(episode), RESETS)
        simulator.render()
        step_ms = _median_ms(lambda: _step(simulator, rest), STEPS)
        image_ms = _median_ms(simulator.render, IMAGES)
        start = time.perf_counter()
        rollout = run_expert(simulator, find_expert(task), compose(task, 1))
        video = render_video(simulator, rollout.snapshots[: CLIP_FRAMES + 1])
        write_video(out / f"{task}.mp4", video.rgb, FPS)
        demo_s = time.perf_counter() - start
    return TaskTiming(task=task, step_ms=step_ms, image_ms=image_ms, reset_ms=reset_ms, demo_s=demo_s)


def section(timings: Sequence[TaskTiming]) -> str:
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
    )


def measure(tasks: Sequence[str]) -> list[TaskTiming]:
    """Time tasks."""
    with TemporaryDirectory() as folder:
        return [time_task(task, Path(folder)) for task in tasks]


def figures(timings: Sequence[TaskTiming]) -> dict[str, float]:
    """Return the medians over the tasks."""
    return {name: float(np.median([getattr(timing, key) for timing in timings])) for name, key in _COLUMNS.items()}
