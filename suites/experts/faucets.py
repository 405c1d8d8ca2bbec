"""Experts for the tasks with faucets."""

from collections.abc import Callable

from kinebench_drake.suites.experts.motion import Waypoint
from kinebench_drake.suites.tasks.task import Scene

EXPERTS: dict[str, Callable[[Scene], list[Waypoint]]] = {}
"""Experts of this family by task id."""
