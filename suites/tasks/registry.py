"""The tasks by id."""

from kinebench_drake.errors import UsageError
from kinebench_drake.suites.tasks import boxes, cubes, drawers, faucets, fruits, laptops, pegs
from kinebench_drake.suites.tasks.card import TaskVariant
from kinebench_drake.suites.tasks.task import Task

_FAMILIES = (boxes, cubes, drawers, faucets, fruits, laptops, pegs)
TASKS: dict[str, Task] = {
    task.card.id: task for task in sorted((t for f in _FAMILIES for t in f.TASKS), key=lambda task: task.card.id)
}
"""All tasks by plain id, in the order of their ids."""


def find_task(task: str, variant: TaskVariant = TaskVariant.PLAIN) -> Task:
    """The task of a plain id.

    Raises:
        UsageError: there is none, or it has no such variant.
    """
    if task not in TASKS:
        raise UsageError(f"no task {task!r}; there are {', '.join(TASKS)}")
    if variant not in TASKS[task].card.variants:
        raise UsageError(f"{task} has no variant {variant.value!r}")
    return TASKS[task]
