"""Rendering of training frames in several processes."""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.base import WorkerCrash
from kinebench_drake.executors.local import LocalExecutor
from training.frame import FILES, save_shard
from training.layout import ShownGripper, TrainedNetwork
from training.scene import TrainingScene

FRAMES_PER_SCENE = 20
_FRANKA = ShownGripper.FRANKA
_NONE = ShownGripper.NONE
_OTHER = ShownGripper.OTHER
_ROBOTIQ = ShownGripper.ROBOTIQ
SHOWN = {
    TrainedNetwork.GRIPPER: (*(_FRANKA,) * 15, _NONE),
    TrainedNetwork.ARM: (_OTHER, _OTHER, _NONE, _OTHER, _FRANKA),
    TrainedNetwork.ROBOTIQ: (
        *(_ROBOTIQ,) * 4,
        _FRANKA,
        *(_ROBOTIQ,) * 4,
        _OTHER,
        *(_ROBOTIQ,) * 4,
        _FRANKA,
        *(_ROBOTIQ,) * 2,
        _NONE,
    ),
}
"""Grippers of successive scenes; what is not the network's own gripper counts as background."""

_REPORT_EVERY = 20
_STREAM = 0x4B42
"""Number that separates these random streams from others with the same seed."""


class SceneRenderer:
    """Worker that renders the frames of one scene after the other; the same seed gives the same scene."""

    def __init__(self, folder: Path, network: TrainedNetwork) -> None:
        """Render the scenes for `network` into `folder`."""
        self._folder = folder
        self._network = network
        self._scene: TrainingScene | None = None

    def __call__(self, seed: int) -> None:
        """Render the scene of a seed."""
        # The last scene lives until the next is built: SAPIEN compiles its shaders again, for seconds, whenever no
        # scene exists.
        shown = SHOWN[self._network]
        self._scene = TrainingScene(
            np.random.default_rng([seed, _STREAM]),
            shown[seed % len(shown)],
            labels_franka=self._network is not TrainedNetwork.ROBOTIQ,
        )
        save_shard([self._scene.frame() for _ in range(FRAMES_PER_SCENE)], _shard(self._folder, seed))


def _shard(folder: Path, seed: int) -> Path:
    return folder / f"{seed:06d}"


def render(
    folder: Path, seeds: Iterable[int], jobs: int, report: Callable[[str], None], network: TrainedNetwork
) -> None:
    """Render the scenes of `seeds` that `folder` lacks, in `jobs` processes; call `report` with lines on the progress.

    Raises:
        SetupError: a rendering process died, most often because there is no Vulkan driver.
    """
    missing = [s for s in seeds if not (_shard(folder, s) / FILES[-1]).is_file()]
    if not missing:
        return
    report(f"rendering {len(missing)} scenes into {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    executor = LocalExecutor(jobs=jobs)
    for finished, done in enumerate(executor.run(partial(SceneRenderer, folder, network=network), missing), 1):
        if isinstance(done, WorkerCrash):
            raise SetupError(
                f"rendering stopped after {finished - 1} of {len(missing)} scenes; `kinebench-drake doctor` shows why, "
                "and repairs the Vulkan driver with --fix"
            )
        if finished % _REPORT_EVERY == 0 or finished == len(missing):
            report(f"rendered {finished}/{len(missing)} scenes")
