"""Tasks with drawers."""

from kinebench_drake.suites.tasks.task import Task

TASKS: tuple[Task, ...] = ()
"""Tasks of this family."""
