"""Executors: where samples are processed (this process, worker processes, a Ray cluster)."""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from importlib.util import find_spec
from typing import Generic, Protocol, TypeVar, runtime_checkable

from kinebench_drake.errors import SetupError, UsageError

Item = TypeVar("Item")
Result = TypeVar("Result")


class EngineKind(Enum):
    """The engines a command line can name."""

    LOCAL = "local"
    RAY = "ray"


@dataclass(frozen=True, slots=True, kw_only=True)
class Done(Generic[Item, Result]):
    """An item whose work returned."""

    item: Item
    result: Result


@dataclass(frozen=True, slots=True, kw_only=True)
class Crashed(Generic[Item]):
    """An item whose worker died over it."""

    item: Item
    reason: str


class Engine(Protocol):
    """Runs one function over many items."""

    def run(
        self, make_worker: Callable[[], Callable[[Item], Result]], items: Sequence[Item]
    ) -> Generator[Done[Item, Result] | Crashed[Item], None, None]:
        """Yield outcomes as they come, in any order.

        Args:
            make_worker: called once in each process; what it returns is called for each item, and closed when there
                are no more if it can be. Must be picklable.
            items: what to work on. Must be picklable, as must be the results.

        Raises:
            KinebenchError: one raised by a worker: the run cannot go on. Any other exception is a fault of the program:
                it counts as a crash where workers are processes of their own, else it is raised as it is.
        """
        ...


@runtime_checkable
class Draining(Protocol):
    """An engine that can make an end of its own accord."""

    def drain(self) -> None:
        """Begin no more items; those at hand are finished. May be called amid `run`, by a signal's handler."""
        ...


@runtime_checkable
class Closable(Protocol):
    """What holds something that is to be freed."""

    def close(self) -> None:
        """Free it."""
        ...


@contextmanager
def hired(make_worker: Callable[[], Callable[[Item], Result]]) -> Iterator[Callable[[Item], Result]]:
    """A worker, closed in the end if it can be."""
    work = make_worker()
    try:
        yield work
    finally:
        if isinstance(work, Closable):
            work.close()


def create_engine(kind: EngineKind, jobs: int, address: str | None = None) -> Engine:
    """The engine of a name, with `jobs` workers.

    Args:
        kind: the engine.
        jobs: number of workers.
        address: of a Ray cluster; for that engine alone.

    Raises:
        UsageError: jobs is not positive, or an address is given that nobody needs.
        SetupError: the engine's package is not installed.
    """
    if jobs < 1:
        raise UsageError(f"--jobs is {jobs}, expected 1 or more")
    if kind is EngineKind.RAY:
        if find_spec("ray") is None:
            raise SetupError("--engine ray needs the package ray: pip install 'kinebench-drake[ray]'")
        from kinebench_drake.executors.ray import RayEngine

        return RayEngine(jobs=jobs, address=address)
    if address is not None:
        raise UsageError(f"--address {address} goes with --engine ray")
    from kinebench_drake.executors.local import LocalEngine

    return LocalEngine(jobs=jobs)
