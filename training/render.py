"""Rendering of training frames in several processes."""

import multiprocessing
import queue
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from kinebench_drake.errors import SetupError
from kinebench_drake.executors.local import one_thread
from kinebench_drake.models.perception.frame import FILES, save_shard
from training.layout import ShownGripper
from training.scene import TrainingScene

FRAMES_PER_SCENE = 20
HANDLESS_EVERY = 16
"""Interval of the scenes that show an arm without its gripper."""
OTHERS = (ShownGripper.OTHER, ShownGripper.OTHER, ShownGripper.NONE, ShownGripper.OTHER, ShownGripper.FRANKA)
"""Grippers of successive scenes for the network of the arm alone."""

_REPORT_EVERY = 20
_STREAM = 0x4B42  # separates these random streams from others with the same seed


def _gripper(seed: int, *, arm: bool) -> ShownGripper:
    """Return the gripper of a scene, of those for the network of the arm alone if `arm`."""
    if arm:
        return OTHERS[seed % len(OTHERS)]
    return ShownGripper.NONE if seed % HANDLESS_EVERY == HANDLESS_EVERY - 1 else ShownGripper.FRANKA


def render_shards(folder: Path, seeds: Iterable[int], *, arm: bool = False) -> Iterator[int]:
    """Render the frames of one scene per seed into `folder`; yield each finished seed.

    The same seed gives the same scene; with `arm` those for the network of the arm alone.
    """
    for seed in seeds:
        # The variable keeps the last scene alive until the next is built: SAPIEN compiles its shaders again, for
        # seconds, whenever no scene exists.
        rng = np.random.default_rng([seed, _STREAM])
        scene = TrainingScene(rng, _gripper(seed, arm=arm))
        save_shard([scene.frame() for _ in range(FRAMES_PER_SCENE)], _shard(folder, seed))
        yield seed


def _shard(folder: Path, seed: int) -> Path:
    return folder / f"{seed:06d}"


def _work(folder: Path, seeds: list[int], arm: bool, done: "multiprocessing.Queue[int | None]") -> None:
    for seed in render_shards(folder, seeds, arm=arm):
        done.put(seed)
    done.put(None)


def render(folder: Path, seeds: Iterable[int], jobs: int, report: Callable[[str], None], *, arm: bool = False) -> None:
    """Render the scenes of `seeds` that `folder` lacks, in `jobs` processes; call `report` with lines on the progress.

    Raises:
        SetupError: a rendering process died, most often because there is no Vulkan driver.
    """
    missing = [s for s in seeds if not (_shard(folder, s) / FILES[-1]).is_file()]
    if not missing:
        return
    report(f"rendering {len(missing)} scenes into {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    done: multiprocessing.Queue[int | None] = context.Queue()
    workers = [
        context.Process(target=_work, args=(folder, missing[k::jobs], arm, done), daemon=True)
        for k in range(min(jobs, len(missing)))
    ]
    with one_thread():
        for worker in workers:
            worker.start()
    finished, running = 0, len(workers)
    while running:
        try:
            seed = done.get(timeout=5.0)
        except queue.Empty as error:
            if any(w.exitcode not in (None, 0) for w in workers):
                raise SetupError(
                    f"rendering stopped after {finished} of {len(missing)} scenes; `kinebench-drake doctor` shows why, "
                    "and repairs the Vulkan driver with --fix"
                ) from error
            continue
        if seed is None:
            running -= 1
            continue
        finished += 1
        if finished % _REPORT_EVERY == 0 or finished == len(missing):
            report(f"rendered {finished}/{len(missing)} scenes")
