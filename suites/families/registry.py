"""Registry of all tasks."""

from kinebench_drake.errors import UsageError, suggestion
from kinebench_drake.suites.families.blocks import task as blocks
from kinebench_drake.suites.families.boxes import task as boxes
from kinebench_drake.suites.families.drawers import task as drawers
from kinebench_drake.suites.families.faucets import task as faucets
from kinebench_drake.suites.families.fruits import task as fruits
from kinebench_drake.suites.families.laptops import task as laptops
from kinebench_drake.suites.families.task import Task, TaskVariant

_FAMILIES = (blocks, boxes, drawers, faucets, fruits, laptops)
TASKS: dict[str, Task] = {
    task.card.id: task for task in sorted((t for f in _FAMILIES for t in f.TASKS), key=lambda task: task.card.id)
}
"""All tasks by plain id, sorted by id."""


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
