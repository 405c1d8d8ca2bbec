"""The experts by task id."""

from collections.abc import Callable, Sequence

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.experts import boxes, cubes, drawers, faucets, fruits, laptops, pegs
from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.tasks.task import Scene

Expert = Callable[[Scene], Sequence[Waypoint]]
"""From a scene as it is now to the moves of the next clip, gripper poses in B; none if nothing is left to do."""

_FAMILIES = (boxes, cubes, drawers, faucets, fruits, laptops, pegs)
EXPERTS: dict[str, Expert] = {task: expert for family in _FAMILIES for task, expert in family.EXPERTS.items()}
"""Experts by plain task id."""


def find_expert(task: str) -> Expert:
    """The expert of a task.

    Raises:
        UsageError: there is none.
    """
    if task not in EXPERTS:
        raise UsageError(f"no expert for task {task!r}; there are {', '.join(EXPERTS)}")
    return EXPERTS[task]
