from pathlib import Path

import pytest

from training.crops import Shards


@pytest.fixture(scope="session")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Shards:
    """One scene with a gripper and one without."""
    from training.layout import ShownGripper, TrainedNetwork
    from training.render import SHOWN, SceneRenderer

    folder: Path = tmp_path_factory.mktemp("frames")
    render = SceneRenderer(folder, TrainedNetwork.GRIPPER)
    handless = SHOWN[TrainedNetwork.GRIPPER].index(ShownGripper.NONE)
    for seed in (handless - 1, handless):
        render(seed)
    return Shards([folder])
