"""Who sets up the stage that an episode needs, and tells what went wrong on it."""

from collections.abc import Callable
from typing import Generic, TypeVar

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import KinebenchError, SetupError, UsageError, cause
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.tasks.task import TaskVariant


def failure(error: Exception) -> str:
    """Why an episode failed, of an error that its seed may cause each time; others are raised again."""
    if isinstance(error, SetupError | UsageError | MemoryError):
        raise error
    return str(error) if isinstance(error, KinebenchError) else f"unexpected {type(error).__name__}: {cause(error)}"


S = TypeVar("S", bound=Simulator)


class SimulatorCache(Generic[S]):
    """One stage at a time, rebuilt where task or variant change."""

    def __init__(self, make: Callable[..., S], size: int, *, renders: bool = True) -> None:
        """Prepare.

        Args:
            make: what stage to set up; called with task, variant, camera and renders.
            size: width and height of the benchmark camera's pictures [px].
            renders: whether pictures can be taken.
        """
        self._make, self._size, self._renders = make, size, renders
        self._stage: S | None = None
        self._built: tuple[str, TaskVariant] | None = None

    def stage(self, task: str, variant: TaskVariant) -> S:
        """The stage of a task."""
        if self._stage is None or self._built != (task, variant):
            self.close()
            camera = benchmark_camera().resized(self._size, self._size)
            self._stage = self._make(task, variant=variant, camera=camera, renders=self._renders)
            self._built = (task, variant)
        return self._stage

    def close(self) -> None:
        """Free the stage."""
        if self._stage is not None:
            self._stage.close()
            self._stage = None
