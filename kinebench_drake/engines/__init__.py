"""Where samples are worked on: this process or several."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

from kinebench_drake.errors import UsageError

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
            make_worker: called once in each process; what it returns is called for each item. Must be picklable.
            items: what to work on. Must be picklable, as must be the results.

        Raises:
            KinebenchError: one raised by a worker: the run cannot go on. Any other exception counts as a crash.
        """
        ...


def create_engine(kind: EngineKind, jobs: int) -> Engine:
    """The engine of a name, with `jobs` workers.

    Raises:
        UsageError: the engine is not available, or jobs is not positive.
    """
    if kind is EngineKind.RAY:
        raise UsageError(
            "--engine ray is not available in this version; use --engine local with --jobs N or --shard I/N"
        )
    if jobs < 1:
        raise UsageError(f"--jobs is {jobs}, expected 1 or more")
    from kinebench_drake.engines.local import LocalEngine

    return LocalEngine(jobs=jobs)
