from collections.abc import Iterator
from dataclasses import replace

import pytest

from benchmarks.faults.fault_simulator import FaultSimulator
from benchmarks.faults.recording import Recording
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import render_video, run_expert


@pytest.fixture(scope="session")
def recording() -> Iterator[Recording]:
    """StackCube-v1, seed 0, the first 30 frames, filmed in a quarter of the benchmark's resolution."""
    with FaultSimulator("StackCube-v1", camera=benchmark_camera().resized(96, 96)) as stage:
        performance = run_expert(stage, find_expert("StackCube-v1"), compose("StackCube-v1", 0))
        performance = replace(performance, snapshots=performance.snapshots[:30])
        yield Recording(simulator=stage, rollout=performance, video=render_video(stage, performance.snapshots))
