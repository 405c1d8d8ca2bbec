"""Registry of all tasks and their experts."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kinebench_drake.errors import UsageError, suggestion
from kinebench_drake.plugin import load_class
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


class OwnTask(str):
    """Plain id of a task of the user's own; where it is unpickled, in another process, it loads its file there."""

    file: Path
    """File that defines the task."""
    class_name: str

    def __reduce__(self) -> tuple[Callable[[str], "OwnTask"], tuple[str]]:
        """Pickle the place of the class."""
        return load_task, (f"{self.file}:{self.class_name}",)


def load_task(spec: str) -> OwnTask:
    """Load the task `FILE.py:Class` of the user's own and register it, its method `expert` as its expert.

    Raises:
        UsageError: there is no such class, it is no task, or a shipped task has its id.
    """
    file, _, name = spec.rpartition(":")
    cls = load_class(spec, argument="tasks", method="layout", arguments="models, rng, variant")
    try:
        task = cls()
    except TypeError as error:  # an abstract method is missing
        raise UsageError(f"$tasks {spec}: {error}") from None
    if not isinstance(task, Task):
        raise UsageError(f"$tasks {spec}: expected a subclass of {Task.__module__}.{Task.__name__}")
    id = OwnTask(task.card.id)
    if id in TASKS and id not in _OWN:
        raise UsageError(f"$tasks {spec}: a shipped task has the id {id}; choose another one")
    id.file = Path(file).resolve()
    id.class_name = name
    TASKS[id] = task
    _OWN[id] = id
    if (expert := getattr(task, "expert", None)) is not None:
        EXPERTS[id] = expert
    return id


_OWN: dict[str, OwnTask] = {}
