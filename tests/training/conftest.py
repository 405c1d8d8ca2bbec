from pathlib import Path

import pytest

from training.crops import Shards


@pytest.fixture(scope="session")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Shards:
    """One scene with a gripper and one without."""
    from training.render import HANDLESS_EVERY, SceneRenderer

    folder: Path = tmp_path_factory.mktemp("frames")
    render = SceneRenderer(folder)
    for seed in (HANDLESS_EVERY - 2, HANDLESS_EVERY - 1):
        render(seed)
    return Shards([folder])
