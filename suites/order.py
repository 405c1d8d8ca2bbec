"""An order of demonstrations: which ones, and how they are filmed and written."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import kinebench_drake
from kinebench_drake.results.metadata import Shard
from kinebench_drake.suites.formats.demo import Content, FormatKind, Shots
from kinebench_drake.suites.formats.format import find_format
from kinebench_drake.suites.suite import EpisodeSpec, Suite
from kinebench_drake.suites.tasks.task import TaskVariant


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOrder:
    """Which demonstrations to make."""

    suite: Suite
    split: str
    """Name of one of the suite's splits."""
    tasks: tuple[str, ...]
    """Plain task ids of the split."""
    episodes: int
    """Successful demonstrations of each task."""
    seed: int
    """Number of the first of the split's seeds."""
    variant: TaskVariant
    """Version of the scenes."""
    shots: Shots
    kind: FormatKind
    out: Path
    """Folder to write to."""
    shard: Shard | None = None
    """The part of the seeds to use; all of them if None."""

    def __post_init__(self) -> None:
        """Check the number of demonstrations.

        Raises:
            UsageError: the split has not as many seeds.
        """
        for task in self.tasks[:1]:  # all have the same
            self.suite.draws(self.split, task, self.episodes, offset=self.seed, variant=self.variant)

    def wanted(self) -> int:
        """Demonstrations of each task that are this part's."""
        return self.episodes if self.shard is None else len(self.shard.take(range(self.episodes)))

    def draws(self, task: str, tries: int) -> list[EpisodeSpec]:
        """The first `tries` episodes of a task that are this part's; fewer where the split ends."""
        first, end = self.suite.splits[self.split].seeds
        parts = 1 if self.shard is None else self.shard.count
        count = min(tries * parts, end - first - self.seed)
        all_draws = self.suite.draws(self.split, task, count, offset=self.seed, variant=self.variant)
        return all_draws if self.shard is None else self.shard.take(all_draws)

    def settings(self) -> dict[str, Any]:
        """What all demonstrations of a folder have in common, as JSON."""
        split, content = self.suite.splits[self.split], find_format(self.kind).content
        return {
            "version": kinebench_drake.__version__,
            "format": self.kind.value,
            "suite": self.suite.number,
            "split": self.split,
            "pool": split.pool.value,
            "variant": self.variant.value,
            "first_seed": split.seeds[0] + self.seed,
            "shard": None if self.shard is None else str(self.shard),
            **({"frame_period_s": self.shots.frame_period_s, **asdict(self.shots)} if Content.FILM in content else {}),
            **({"size": self.shots.size} if Content.STILLS in content else {}),
        }

    def request(self) -> dict[str, Any]:
        """All of the order, as JSON."""
        return {**self.settings(), "tasks": list(self.tasks), "episodes_per_task": self.episodes}
