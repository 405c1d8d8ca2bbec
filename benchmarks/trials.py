"""Numbered trials of a study in worker processes; trial and seed determine what is drawn."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeVar

from kinebench_drake.errors import KinebenchError
from kinebench_drake.executors.base import WorkerCrash
from kinebench_drake.executors.local import LocalExecutor

Trial = TypeVar("Trial")


def run_trials(
    make_worker: Callable[[int], Callable[[int], Trial]], count: int, seed: int, jobs: int = 1
) -> Iterator[Trial]:
    """Run trials 0 to `count`, in any order, by workers that are made of the seed.

    Raises:
        KinebenchError: a worker died.
    """
    for outcome in LocalExecutor(jobs=jobs).run(partial(make_worker, seed), range(count)):
        if isinstance(outcome, WorkerCrash):
            raise KinebenchError(f"trial {outcome.item} of seed {seed} crashed: {outcome.reason}")
        yield outcome.result
