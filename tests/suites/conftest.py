from collections.abc import Iterator

import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.suites.clip import Clip, film
from kinebench_drake.suites.episode import compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.rollout import Performance, perform
from kinebench_drake.suites.stage import Stage


@pytest.fixture(scope="session")
def filmed() -> Iterator[tuple[Stage, Performance, Clip]]:
    """StackCube-v1, seed 0, done and filmed in a quarter of the benchmark's resolution."""
    with Stage("StackCube-v1", camera=benchmark_camera().resized(96, 96)) as stage:
        performance = perform(stage, find_expert("StackCube-v1"), compose("StackCube-v1", 0))
        yield stage, performance, film(stage, performance.snapshots)
