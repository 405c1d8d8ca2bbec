"""One function over many items in worker processes; a worker that dies ends the run."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

from kinebench_drake.errors import KinebenchError
from kinebench_drake.executors.base import Item, MakeWorker, Result, WorkerCrash
from kinebench_drake.executors.local import LocalExecutor

Trial = TypeVar("Trial")


def run_all(make_worker: MakeWorker[Item, Result], items: Sequence[Item], jobs: int) -> Iterator[Result]:
    """Yield the result of each item as soon as it is available, in any order.

    Raises:
        KinebenchError: a worker died.
    """
    for outcome in LocalExecutor(jobs=jobs).run(make_worker, items):
        if isinstance(outcome, WorkerCrash):
            raise KinebenchError(f"{outcome.item}: {outcome.reason}")
        yield outcome.result


def run_trials(
    make_worker: Callable[[int], Callable[[int], Trial]], count: int, seed: int, jobs: int = 1
) -> Iterator[Trial]:
    """Run trials 0 to `count` by workers that are made of the seed; trial and seed determine what is drawn.

    Raises:
        KinebenchError: a worker died.
    """
    return run_all(partial(make_worker, seed), range(count), jobs)
