from collections.abc import Iterator
from dataclasses import replace

import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.suites.clip import film
from kinebench_drake.suites.episode import compose
from kinebench_drake.suites.experts.registry import find_expert
from kinebench_drake.suites.faults.take import Take
from kinebench_drake.suites.faults.trickstage import TrickStage
from kinebench_drake.suites.rollout import perform


@pytest.fixture(scope="session")
def take() -> Iterator[Take]:
    """StackCube-v1, seed 0, the first 30 frames, filmed in a quarter of the benchmark's resolution."""
    with TrickStage("StackCube-v1", camera=benchmark_camera().resized(96, 96)) as stage:
        performance = perform(stage, find_expert("StackCube-v1"), compose("StackCube-v1", 0))
        performance = replace(performance, snapshots=performance.snapshots[:30])
        yield Take(stage=stage, performance=performance, clip=film(stage, performance.snapshots))
