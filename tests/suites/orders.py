"""Orders of demonstrations, and a recording observer."""

from pathlib import Path

from kinebench_drake.executors.base import Observer
from kinebench_drake.suites.catalog import load_suite
from kinebench_drake.suites.demo_config import DemoConfig, FormatKind, RenderOptions
from kinebench_drake.suites.families.task import TaskVariant

TASK = "StackCube-v1"
FIRST = 1_000_000
"""The first seed for training."""


class Recorder(Observer):
    """Observer that keeps what it receives."""

    def __init__(self) -> None:
        self.total = self.completed = 0
        self.lines: list[str] = []

    def start(self, total: int, completed: int) -> None:
        self.total = total
        self.completed = completed

    def advance(self, line: str, *, ok: bool = True) -> None:
        self.lines.append(line)


def an_order(out: Path, kind: FormatKind, episodes: int, options: RenderOptions | None = None) -> DemoConfig:
    return DemoConfig(
        suite=load_suite(0),
        split="train",
        tasks=(TASK,),
        episodes=episodes,
        seed=0,
        variant=TaskVariant.PLAIN,
        options=options or RenderOptions(size=96),
        kind=kind,
        out=out,
    )
