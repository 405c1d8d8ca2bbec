"""Orders of demonstrations, and a recording observer."""

from pathlib import Path

from kinebench_drake.executors.progress import NullObserver
from kinebench_drake.suites.formats.demo import FormatKind, Shots
from kinebench_drake.suites.order import DemoOrder
from kinebench_drake.suites.suite import load_suite
from kinebench_drake.suites.tasks.task import TaskVariant

TASK = "StackCube-v1"
FIRST = 1_000_000
"""The first seed for training."""


class Recorder(NullObserver):
    """Observer that keeps what it receives."""

    def __init__(self) -> None:
        self.total = self.completed = 0
        self.lines: list[str] = []

    def start(self, total: int, completed: int) -> None:
        self.total, self.completed = total, completed

    def advance(self, line: str, *, ok: bool = True) -> None:
        self.lines.append(line)


def an_order(out: Path, kind: FormatKind, episodes: int, shots: Shots | None = None) -> DemoOrder:
    return DemoOrder(
        suite=load_suite(0),
        split="train",
        tasks=(TASK,),
        episodes=episodes,
        seed=0,
        variant=TaskVariant.PLAIN,
        shots=shots or Shots(size=96),
        kind=kind,
        out=out,
    )
