"""Reuse of simulators between episodes of a task, and classification of their errors."""

from collections.abc import Callable
from typing import Generic, TypeVar

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import KinebenchError, SetupError, UsageError, cause
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.simulator import Simulator

S = TypeVar("S", bound=Simulator)
Item = TypeVar("Item", Episode, EpisodeSpec)
Result = TypeVar("Result")


class SimulatorCache(Generic[S]):
    """One simulator at a time, rebuilt when task or variant change.

    Args:
        make: simulator class; called with task, variant, camera and renders.
        size: width and height of the benchmark camera's images [px]; None: the benchmark's.
    """

    def __init__(self, make: Callable[..., S], size: int | None = None, *, renders: bool = True) -> None:
        self._make = make
        self._renders = renders
        camera = benchmark_camera()
        self._camera = camera if size is None else camera.resized(size, size)
        self._simulator: S | None = None
        self._key: tuple[str, TaskVariant] | None = None

    def get(self, task: str, variant: TaskVariant) -> S:
        """Return the simulator of a task."""
        if self._simulator is None or self._key != (task, variant):
            self.close()
            self._simulator = self._make(task, variant=variant, camera=self._camera, renders=self._renders)
            self._key = (task, variant)
        return self._simulator

    def close(self) -> None:
        """Release the simulator."""
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None


class SimulatorWorker(Generic[S, Item, Result]):
    """Worker of an executor that calls a function for each episode with the simulator of its task."""

    def __init__(self, work: Callable[[S, Item], Result], simulators: SimulatorCache[S]) -> None:
        self._work: Callable[[S, Item], Result] = work
        self._simulators = simulators

    def __call__(self, item: Item) -> Result:
        """Return the result of an episode."""
        return self._work(self._simulators.get(item.task, item.variant), item)

    def close(self) -> None:
        """Release the simulator."""
        self._simulators.close()


def failure_reason(error: Exception) -> str:
    """Return the reason of a failed episode; errors that are not of the episode (setup, usage, memory) are raised."""
    if isinstance(error, SetupError | UsageError | MemoryError):
        raise error
    return str(error) if isinstance(error, KinebenchError) else f"unexpected {type(error).__name__}: {cause(error)}"
