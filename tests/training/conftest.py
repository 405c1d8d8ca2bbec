from pathlib import Path

import pytest

from training.crops import Shards


@pytest.fixture(scope="session")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Shards:
    """One scene with a gripper and one without."""
    from training.render import HANDLESS_EVERY, render_shards

    folder: Path = tmp_path_factory.mktemp("frames")
    assert list(render_shards(folder, [HANDLESS_EVERY - 2, HANDLESS_EVERY - 1])) == [14, 15]
    return Shards([folder])
