import pytest

from kinebench_drake.suites.clip import Clip
from kinebench_drake.suites.formats.demo import Demo, Shots
from kinebench_drake.suites.rollout import Performance
from kinebench_drake.suites.stage import Stage


@pytest.fixture
def demo(filmed: tuple[Stage, Performance, Clip]) -> Demo:
    """The performance that `filmed` filmed, as a demonstration."""
    from kinebench_drake.suites.tasks.environment import X_WB

    _, performance, clip = filmed
    return Demo(performance=performance, shots=Shots(size=96), film=clip, X_WB=X_WB)
