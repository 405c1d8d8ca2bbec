"""Who sets up the stage that an episode needs."""

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.suites.rollout import Stage
from kinebench_drake.suites.tasks.card import Variant


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
