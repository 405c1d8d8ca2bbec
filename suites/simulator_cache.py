"""Reuse of simulators between episodes of a task, and classification of their errors."""

from collections.abc import Callable
from typing import Generic, TypeVar

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import KinebenchError, SetupError, UsageError, cause
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.simulator import Simulator

S = TypeVar("S", bound=Simulator)


class SimulatorCache(Generic[S]):
    """One simulator at a time, rebuilt when task or variant change."""

    def __init__(self, make: Callable[..., S], size: int, *, renders: bool = True) -> None:
        """Create an empty cache.

        Args:
            make: simulator class; called with task, variant, camera and renders.
            size: width and height of the benchmark camera's images [px].
            renders: whether images can be rendered.
        """
        self._make, self._size, self._renders = make, size, renders
        self._simulator: S | None = None
        self._key: tuple[str, TaskVariant] | None = None

    def get(self, task: str, variant: TaskVariant) -> S:
        """Return the simulator of a task."""
        if self._simulator is None or self._key != (task, variant):
            self.close()
            camera = benchmark_camera().resized(self._size, self._size)
            self._simulator = self._make(task, variant=variant, camera=camera, renders=self._renders)
            self._key = (task, variant)
        return self._simulator

    def close(self) -> None:
        """Release the simulator."""
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None


class SimulatorWorker(Generic[S]):
    """Base of the workers that handle episodes one after the other, each on the simulator of its task."""

    def __init__(self, simulators: SimulatorCache[S]) -> None:
        """Take over the cache."""
        self._simulators = simulators

    def close(self) -> None:
        """Release the simulator."""
        self._simulators.close()


def failure_reason(error: Exception) -> str:
    """Return the reason of a failed episode; errors that are not of the episode (setup, usage, memory) are raised."""
    if isinstance(error, SetupError | UsageError | MemoryError):
        raise error
    return str(error) if isinstance(error, KinebenchError) else f"unexpected {type(error).__name__}: {cause(error)}"
