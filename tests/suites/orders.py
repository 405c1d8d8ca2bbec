"""Orders of demonstrations, and who watches them made."""

from pathlib import Path

from kinebench_drake.suites.formats.demo import FormatKind, Shots
from kinebench_drake.suites.order import DemoOrder
from kinebench_drake.suites.suite import load_suite
from kinebench_drake.suites.tasks.card import TaskVariant

TASK = "StackCube-v1"
FIRST = 1_000_000
"""The first seed for training."""


class Watcher:
    """A watcher that remembers."""

    def __init__(self) -> None:
        self.kept = 0
        self.lines: list[str] = []

    def started(self, total: int, kept: int) -> None:
        self.kept = kept

    def advanced(self, line: str, *, good: bool = True) -> None:
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
