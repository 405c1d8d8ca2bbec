"""Rendering of training frames by several processes."""

import multiprocessing
import os
import queue
from collections.abc import Callable, Iterable
from pathlib import Path

_REPORT_EVERY = 20


def _work(folder: Path, seeds: list[int], done: "multiprocessing.Queue[int | None]") -> None:
    from kinebench_drake.grounding.training.frames import render_shards

    for seed in render_shards(folder, seeds):
        done.put(seed)
    done.put(None)


def render(folder: Path, seeds: Iterable[int], jobs: int, report: Callable[[str], None]) -> None:
    """Render the scenes of `seeds` that `folder` lacks, in `jobs` processes; `report` hears of the progress.

    Raises:
        SetupError: a rendering process died, most often for want of a Vulkan driver.
    """
    from kinebench_drake.errors import SetupError

    missing = [s for s in seeds if not (folder / f"{s:06d}" / "truth.npz").is_file()]
    if not missing:
        return
    report(f"rendering {len(missing)} scenes into {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    done: multiprocessing.Queue[int | None] = context.Queue()
    os.environ.setdefault("LP_NUM_THREADS", "1")  # lavapipe: one thread a process, processes side by side
    workers = [
        context.Process(target=_work, args=(folder, missing[k::jobs], done), daemon=True)
        for k in range(min(jobs, len(missing)))
    ]
    for worker in workers:
        worker.start()
    finished, running = 0, len(workers)
    while running:
        try:
            seed = done.get(timeout=5.0)
        except queue.Empty as error:
            if any(w.exitcode not in (None, 0) for w in workers):
                raise SetupError(
                    f"rendering stopped after {finished} of {len(missing)} scenes; `kinebench-drake doctor` tells why"
                ) from error
            continue
        if seed is None:
            running -= 1
            continue
        finished += 1
        if finished % _REPORT_EVERY == 0 or finished == len(missing):
            report(f"rendered {finished}/{len(missing)} scenes")
