import pytest

from kinebench_drake.suites.formats.demo import Demo, RenderOptions
from kinebench_drake.suites.rollout import Rollout, RolloutVideo
from kinebench_drake.suites.simulator import Simulator


@pytest.fixture
def demo(filmed: tuple[Simulator, Rollout, RolloutVideo]) -> Demo:
    """The performance that `filmed` filmed, as a demonstration."""
    from kinebench_drake.suites.scene.environment import X_WB

    _, performance, clip = filmed
    return Demo(rollout=performance, options=RenderOptions(size=96), video=clip, X_WB=X_WB)
