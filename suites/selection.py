"""Selection of tasks by name and variant."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kinebench_drake.errors import UsageError

if TYPE_CHECKING:  # slow to import: help texts and usage errors do not need it
    from kinebench_drake.suites.families.task import TaskVariant
    from kinebench_drake.suites.suite import Suite

_PREFIX = "KineBench/"


def task_names(names: str | Sequence[str] | None) -> list[str] | None:
    """Parse task names into plain ids without duplicates; None if there are none.

    Args:
        names: list, or comma-separated; with or without ManiSkill's namespace.
    """
    if names is None:
        return None
    listed = names.split(",") if isinstance(names, str) else names
    return list(dict.fromkeys(name.strip().removeprefix(_PREFIX) for name in listed))


def with_variant(tasks: Sequence[str], variant: "TaskVariant", *, named: bool) -> list[str]:
    """Return the tasks that have a variant; tasks that the user named must have it.

    Raises:
        UsageError: a named task does not have it, or no task has.
    """
    from kinebench_drake.suites.families.registry import TASKS

    having = [task for task in tasks if variant in TASKS[task].card.variants]
    if not having or (named and len(having) < len(tasks)):
        which = ", ".join(task for task in tasks if task not in having) if named else "no task of this split"
        verb = "has no" if named else "has the"
        all_having = ", ".join(name for name, task in TASKS.items() if variant in task.card.variants)
        raise UsageError(f"{which} {verb} variant {variant.value!r}; tasks that have it: {all_having}")
    return having


def chosen_tasks(
    suite: "Suite", split: str, names: str | Sequence[str] | None, variant: "TaskVariant"
) -> tuple[str, ...]:
    """Return the named tasks of a split, or all that have the variant.

    Raises:
        UsageError: the split does not have the tasks, or they do not have the variant.
    """
    return tuple(with_variant(suite.tasks_of(split, task_names(names)), variant, named=names is not None))
