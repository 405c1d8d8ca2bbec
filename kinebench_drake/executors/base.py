"""Executor interface: one function over many items, in this process, in worker processes or on a Ray cluster."""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from importlib.util import find_spec
from typing import Generic, Protocol, TypeAlias, TypeVar, runtime_checkable

from kinebench_drake.errors import SetupError, UsageError

Item = TypeVar("Item")
Result = TypeVar("Result")

MakeWorker: TypeAlias = Callable[[], Callable[[Item], Result]]
"""Function that creates a worker, which maps an item to its result."""


class ExecutorKind(Enum):
    """Executors that `--engine` can name."""

    LOCAL = "local"
    RAY = "ray"


@dataclass(frozen=True, slots=True, kw_only=True)
class ItemResult(Generic[Item, Result]):
    """Result of one item."""

    item: Item
    result: Result


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerCrash(Generic[Item]):
    """Item whose worker process died."""

    item: Item
    reason: str


@dataclass(frozen=True, slots=True)
class ItemProgress:
    """Line of progress from a worker process."""

    line: str


Outcomes: TypeAlias = Generator[ItemResult[Item, Result] | WorkerCrash[Item], None, None]


class Executor(Protocol):
    """Runs one function over many items."""

    def run(self, make_worker: MakeWorker[Item, Result], items: Sequence[Item]) -> Outcomes[Item, Result]:
        """Yield the outcome of each item as soon as it is available, in any order.

        Args:
            make_worker: called once per process; returns the function called for each item, which is closed after the
                last item if it has `close`. Must be picklable.
            items: arguments of the function. Items and results must be picklable.

        Raises:
            KinebenchError: a worker raised it, which ends the run. Any other exception is a bug: it counts as a crash
                if workers are separate processes, otherwise it propagates.
        """


@runtime_checkable
class SupportsDrain(Protocol):
    """Executor that can stop early without losing running items."""

    def drain(self) -> None:
        """Start no further items and let running ones finish. May be called by a signal handler during `run`."""


@runtime_checkable
class SupportsClose(Protocol):
    """Object with resources to release."""

    def close(self) -> None:
        """Release the resources."""


class Observer(Protocol):
    """Receiver of progress reports and warnings of long-running work."""

    def warn(self, message: str) -> None:
        """Report a condition the user should know about; the work continues."""
        return None

    def start(self, total: int, completed: int) -> None:
        """Report the number of items, and how many of them an earlier run completed."""
        return None

    def advance(self, line: str, *, ok: bool = True) -> None:
        """Report one processed item, described by `line`; `ok`: whether it counts as completed."""
        return None


@contextmanager
def open_worker(make_worker: MakeWorker[Item, Result]) -> Iterator[Callable[[Item], Result]]:
    """Create a worker and close it on exit if it has `close`."""
    work = make_worker()
    try:
        yield work
    finally:
        if isinstance(work, SupportsClose):
            work.close()


def create_executor(kind: ExecutorKind, jobs: int, address: str | None = None) -> Executor:
    """Return an executor with `jobs` workers.

    Args:
        address: address of a Ray cluster; only for Ray.

    Raises:
        UsageError: `jobs` is not positive, or an address is given for a local executor.
        SetupError: the package of the executor is not installed.
    """
    if jobs < 1:
        raise UsageError(f"$jobs is {jobs}, expected 1 or more")
    if kind is ExecutorKind.RAY:
        if find_spec("ray") is None:
            raise SetupError("$engine ray needs the package ray: pip install 'kinebench-drake[ray]'")
        from kinebench_drake.executors.ray import RayExecutor

        return RayExecutor(jobs=jobs, address=address)
    if address is not None:
        raise UsageError(f"$address {address} goes with $engine ray")
    from kinebench_drake.executors.local import LocalExecutor

    return LocalExecutor(jobs=jobs)
