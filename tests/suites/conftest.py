from collections.abc import Iterator

import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, render_video, run_expert
from kinebench_drake.suites.simulator import Simulator


@pytest.fixture(scope="session")
def filmed() -> Iterator[tuple[Simulator, Rollout, RolloutVideo]]:
    """StackCube-v1, seed 0, done and filmed in a quarter of the benchmark's resolution."""
    with Simulator("StackCube-v1", camera=benchmark_camera().resized(96, 96)) as stage:
        performance = run_expert(stage, find_expert("StackCube-v1"), compose("StackCube-v1", 0))
        yield stage, performance, render_video(stage, performance.snapshots)
