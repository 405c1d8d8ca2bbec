"""Tasks with boxes with hinged lids."""

from kinebench_drake.suites.tasks.task import Task

TASKS: tuple[Task, ...] = ()
"""Tasks of this family."""
