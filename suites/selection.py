"""Which tasks a user means who names some, or none."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kinebench_drake.errors import UsageError

if TYPE_CHECKING:  # heavy: helps and usage errors should not wait for it
    from kinebench_drake.suites.suite import Suite
    from kinebench_drake.suites.tasks.task import TaskVariant

_PREFIX = "KineBench/"


def task_names(names: str | Sequence[str] | None) -> list[str] | None:
    """Plain ids of tasks named by a user, each once, with or without ManiSkill's namespace; None if none were.

    Args:
        names: a list, or comma-separated.
    """
    if names is None:
        return None
    listed = names.split(",") if isinstance(names, str) else names
    return list(dict.fromkeys(name.strip().removeprefix(_PREFIX) for name in listed))


def with_variant(tasks: Sequence[str], variant: "TaskVariant", *, named: bool) -> list[str]:
    """Those of some tasks that have a variant; all of them have to if the user named them.

    Raises:
        UsageError: a named one has not, or none has.
    """
    from kinebench_drake.suites.tasks.registry import TASKS

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
    """Tasks of a split that are named, or all that have the variant.

    Raises:
        UsageError: the split has no such tasks, or they have no such variant.
    """
    return tuple(with_variant(suite.tasks_of(split, task_names(names)), variant, named=names is not None))
