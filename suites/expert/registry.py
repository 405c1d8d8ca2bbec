"""Registry of all experts."""

from collections.abc import Callable, Sequence

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.blocks import expert as blocks
from kinebench_drake.suites.families.boxes import expert as boxes
from kinebench_drake.suites.families.drawers import expert as drawers
from kinebench_drake.suites.families.faucets import expert as faucets
from kinebench_drake.suites.families.fruits import expert as fruits
from kinebench_drake.suites.families.laptops import expert as laptops
from kinebench_drake.suites.families.task import Scene

Expert = Callable[[Scene], Sequence[Waypoint]]
"""Function from the current scene to the waypoints of the next clip in B; empty if nothing is left to do."""

_FAMILIES = (blocks, boxes, drawers, faucets, fruits, laptops)
EXPERTS: dict[str, Expert] = {task: expert for family in _FAMILIES for task, expert in family.EXPERTS.items()}
"""Experts by plain task id."""


def find_expert(task: str) -> Expert:
    """Return the expert of a task.

    Raises:
        UsageError: the task has no expert.
    """
    if task not in EXPERTS:
        raise UsageError(f"no expert for task {task!r}; there are {', '.join(EXPERTS)}")
    return EXPERTS[task]
