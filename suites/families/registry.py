"""Registry of all tasks and their experts."""

from collections.abc import Callable, Sequence

from kinebench_drake.errors import UsageError, suggestion
from kinebench_drake.suites.expert.motion import Waypoint
from kinebench_drake.suites.families.blocks import expert as blocks_expert
from kinebench_drake.suites.families.blocks import task as blocks
from kinebench_drake.suites.families.boxes import expert as boxes_expert
from kinebench_drake.suites.families.boxes import task as boxes
from kinebench_drake.suites.families.drawers import expert as drawers_expert
from kinebench_drake.suites.families.drawers import task as drawers
from kinebench_drake.suites.families.faucets import expert as faucets_expert
from kinebench_drake.suites.families.faucets import task as faucets
from kinebench_drake.suites.families.fruits import expert as fruits_expert
from kinebench_drake.suites.families.fruits import task as fruits
from kinebench_drake.suites.families.laptops import expert as laptops_expert
from kinebench_drake.suites.families.laptops import task as laptops
from kinebench_drake.suites.families.task import Scene, Task, TaskVariant

Expert = Callable[[Scene], Sequence[Waypoint]]
"""Function from the current scene to the waypoints of the next clip in B; empty if nothing is left to do."""

_TASKS = (blocks, boxes, drawers, faucets, fruits, laptops)
_EXPERTS = (blocks_expert, boxes_expert, drawers_expert, faucets_expert, fruits_expert, laptops_expert)
TASKS: dict[str, Task] = {
    task.card.id: task for task in sorted((t for f in _TASKS for t in f.TASKS), key=lambda task: task.card.id)
}
"""All tasks by plain id, sorted by id."""
EXPERTS: dict[str, Expert] = {task: expert for family in _EXPERTS for task, expert in family.EXPERTS.items()}
"""Experts by plain task id."""


def find_task(task: str, variant: TaskVariant = TaskVariant.PLAIN) -> Task:
    """Return the task with a plain id.

    Raises:
        UsageError: the id is unknown, or the task has no such variant.
    """
    if task not in TASKS:
        raise UsageError(f"no task {task!r}{suggestion(task, TASKS)}; there are {', '.join(TASKS)}")
    if variant not in TASKS[task].card.variants:
        raise UsageError(f"{task} has no variant {variant.value!r}")
    return TASKS[task]


def find_expert(task: str) -> Expert:
    """Return the expert of a task.

    Raises:
        UsageError: the task has no expert.
    """
    if task not in EXPERTS:
        raise UsageError(f"no expert for task {task!r}; there are {', '.join(EXPERTS)}")
    return EXPERTS[task]
