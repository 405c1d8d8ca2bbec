"""Who sets up the stage that an episode needs, and tells what went wrong on it."""

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import KinebenchError, SetupError, UsageError, cause
from kinebench_drake.suites.stage import Stage
from kinebench_drake.suites.tasks.card import Variant


def failure(error: Exception) -> str:
    """Why an episode failed, of an error that its seed may cause each time; others are raised again."""
    if isinstance(error, SetupError | UsageError | MemoryError):
        raise error
    return str(error) if isinstance(error, KinebenchError) else f"unexpected {type(error).__name__}: {cause(error)}"


class Stagehand:
    """One stage at a time, rebuilt where task or variant change."""

    def __init__(self, size: int, *, renders: bool = True, make: type[Stage] = Stage) -> None:
        """Prepare.

        Args:
            size: width and height of the benchmark camera's pictures [px].
            renders: whether pictures can be taken.
            make: what stage to set up.
        """
        self._size, self._renders, self._make = size, renders, make
        self._stage: Stage | None = None
        self._built: tuple[str, Variant] | None = None

    def stage(self, task: str, variant: Variant) -> Stage:
        """The stage of a task."""
        if self._stage is None or self._built != (task, variant):
            if self._stage is not None:
                self._stage.close()
            camera = benchmark_camera().resized(self._size, self._size)
            self._stage = self._make(task, variant=variant, camera=camera, renders=self._renders)
            self._built = (task, variant)
        return self._stage
