"""Configuration of a set of demonstrations."""

from dataclasses import asdict, dataclass
from typing import Any

import kinebench_drake
from kinebench_drake.results.metadata import Shard
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.export import DatasetConfig
from kinebench_drake.suites.formats.demo import Content, FormatKind, RenderOptions, find_format


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoConfig(DatasetConfig):
    """Demonstrations to make."""

    options: RenderOptions
    kind: FormatKind
    shard: Shard | None = None
    """Share of the seeds to use; None: all."""

    def __post_init__(self) -> None:
        """Check the number of demonstrations.

        Raises:
            UsageError: the split has fewer seeds.
        """
        for task in self.tasks[:1]:  # all tasks have the same seeds
            self.suite.specs(self.split, task, self.episodes, offset=self.seed, variant=self.variant)

    @property
    def wanted(self) -> int:
        """Demonstrations of each task in this shard."""
        return self.episodes if self.shard is None else len(self.shard.take(range(self.episodes)))

    def specs(self, task: str, tries: int) -> list[EpisodeSpec]:
        """Return the first `tries` episodes of a task in this shard; fewer at the end of the split."""
        first, end = self.suite.splits[self.split].seeds
        shards = 1 if self.shard is None else self.shard.count
        count = min(tries * shards, end - first - self.seed)
        specs = self.suite.specs(self.split, task, count, offset=self.seed, variant=self.variant)
        return specs if self.shard is None else self.shard.take(specs)

    def settings(self) -> dict[str, Any]:
        """Return the settings that all demonstrations of a folder share, as JSON."""
        split, content = self.suite.splits[self.split], find_format(self.kind).content
        video = {"frame_period_s": self.options.frame_period_s, **asdict(self.options)}
        return {
            "version": kinebench_drake.__version__,
            "format": self.kind.value,
            "suite": self.suite.number,
            "split": self.split,
            "pool": split.pool.value,
            "variant": self.variant.value,
            "first_seed": split.seeds[0] + self.seed,
            "shard": None if self.shard is None else str(self.shard),
            **(video if Content.VIDEO in content else {}),
            **({"size": self.options.size} if Content.STILLS in content else {}),
        }

    def request(self) -> dict[str, Any]:
        """Return the whole configuration as JSON."""
        return {**self.settings(), "tasks": list(self.tasks), "episodes_per_task": self.episodes}
