import pytest

from kinebench_drake.suites.clip import RolloutVideo
from kinebench_drake.suites.formats.demo import Demo, Shots
from kinebench_drake.suites.rollout import Rollout
from kinebench_drake.suites.simulator import Simulator


@pytest.fixture
def demo(filmed: tuple[Simulator, Rollout, RolloutVideo]) -> Demo:
    """The performance that `filmed` filmed, as a demonstration."""
    from kinebench_drake.suites.tasks.environment import X_WB

    _, performance, clip = filmed
    return Demo(performance=performance, shots=Shots(size=96), film=clip, X_WB=X_WB)
