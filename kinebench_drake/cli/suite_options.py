"""Options that the commands of `suite` share."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from kinebench_drake.errors import UsageError

if TYPE_CHECKING:
    from kinebench_drake.suites.suite import Suite
    from kinebench_drake.suites.tasks.card import Variant

_PREFIX = "KineBench/"

tasks_option = click.option(
    "--tasks", "--task", "tasks", metavar="A,B", help="Tasks, comma-separated.  [default: all there are]"
)
episodes_option = click.option(
    "--episodes", type=click.IntRange(1), default=10, show_default=True, help="Episodes of each task.", metavar="K"
)
jobs_option = click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")
variant_option = click.option(
    "--variant",
    type=click.Choice(["plain", "obstacles"]),
    default="plain",
    show_default=True,
    help="Version of the scenes; without --tasks: of the tasks that have it.",
)
split_help = "Part of the suite; test: the part that models are judged on."
SPLITS = click.Choice(["train", "test", "seen", "unseen"])
SUITES = click.IntRange(0, 3)
SIZES = click.IntRange(128, 2048)
"""Sizes of pictures [px]: x264 writes films smaller than that with other bytes each time."""


def task_names(names: str | None) -> list[str] | None:
    """Plain ids of tasks named by a user, each once, with or without ManiSkill's namespace; None if none were."""
    return None if names is None else list(dict.fromkeys(n.strip().removeprefix(_PREFIX) for n in names.split(",")))


def with_variant(tasks: Sequence[str], variant: "Variant", *, named: bool) -> list[str]:
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


def chosen_tasks(suite: "Suite", split: str, names: str | None, variant: "Variant") -> tuple[str, ...]:
    """Tasks of a split that are named, or all that have the variant.

    Raises:
        UsageError: the split has no such tasks, or they have no such variant.
    """
    return tuple(with_variant(suite.tasks_of(split, task_names(names)), variant, named=names is not None))


def check_parent(option: str, path: Path) -> None:
    """Make sure, before long work, that a file can be written where the user wants it.

    Raises:
        UsageError: its folder is not there.
    """
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: there is no folder {path.parent}; make it first")
