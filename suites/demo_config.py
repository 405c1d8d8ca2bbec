"""Configuration of a set of demonstrations: tasks, seeds, format and rendering."""

import math
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

import kinebench_drake
from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.results.metadata import Shard
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.clock import CLIP_FRAMES, CONTROL_PERIOD_S, STEPS_PER_FRAME
from kinebench_drake.suites.export import DatasetConfig

CLIP_STEPS = STEPS_PER_FRAME * CLIP_FRAMES
"""Control steps of a clip."""
FRAME_CHOICES = tuple(n + 1 for n in range(1, CLIP_STEPS + 1) if CLIP_STEPS % n == 0)
"""Possible numbers of frames of a clip: constant numbers of control steps apart, first and last included."""


class FormatKind(Enum):
    """Formats that `--format` can name."""

    MP4 = "mp4"
    LEROBOT = "lerobot-v3"


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderOptions:
    """Options of rendering demonstrations."""

    size: int = 384
    """Width and height [px]."""
    frames: int = CLIP_FRAMES + 1
    """Frames of a clip, of `FRAME_CHOICES`."""
    fps: float = 17.0
    """Playback rate of a video [frames/s]."""
    crf: int = 16
    """x264's quality."""
    with_depth: bool = False
    """Store depth and masks with the ground truth."""

    def __post_init__(self) -> None:
        """Check the numbers of frames.

        Raises:
            UsageError: the number of frames does not divide a clip's control steps, or the rate is not finite.
        """
        if not math.isfinite(self.fps):
            raise UsageError(f"$fps is {self.fps}, expected a positive number")
        if self.frames not in FRAME_CHOICES:
            raise UsageError(
                f"$frames is {self.frames}: a clip's {CLIP_STEPS} control steps can be rendered as "
                f"{', '.join(map(str, FRAME_CHOICES))} frames (49: every fourth step)"
            )

    @property
    def every(self) -> int:
        """Control steps between two frames."""
        return CLIP_STEPS // (self.frames - 1)

    @property
    def frame_period_s(self) -> float:
        """Task time between two frames."""
        return round(self.every * CONTROL_PERIOD_S, 6)

    @property
    def camera(self) -> Camera:
        """Benchmark camera at this size."""
        return benchmark_camera().resized(self.size, self.size)


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
        self.specs()

    @property
    def wanted(self) -> int:
        """Demonstrations of each task in this shard."""
        return self.episodes if self.shard is None else len(self.shard.take(range(self.episodes)))

    def attempts(self, task: str, tries: int) -> list[EpisodeSpec]:
        """Return the first `tries` episodes of a task in this shard; fewer at the end of the split."""
        first, end = self.suite.splits[self.split].seeds
        shards = 1 if self.shard is None else self.shard.count
        count = min(tries * shards, end - first - self.seed)
        specs = self.suite.specs(self.split, count, tasks=[task], offset=self.seed, variant=self.variant)
        return specs if self.shard is None else self.shard.take(specs)

    def settings(self) -> dict[str, Any]:
        """Return the settings that all demonstrations of a folder share, as JSON."""
        split = self.suite.splits[self.split]
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
            **video,
        }

    def request(self) -> dict[str, Any]:
        """Return the whole configuration as JSON."""
        return {**self.settings(), "tasks": list(self.tasks), "episodes_per_task": self.episodes}
