"""Kinds of runs, and the options common to all runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TypeVar

from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.metadata import Shard
from kinebench_drake.runs.tools import RobotOptions, Tools, ToolsFactory

MAX_SEED = 2**63 - 1
"""Largest seed: JSON readers take a larger integer for a float."""
_Sample = TypeVar("_Sample")


class RunKind(Enum):
    """What a run does with its samples."""

    SCORE = "score"
    GROUND = "ground"
    AUDIT = "audit"
    SUITE = "suite"

    @property
    def noun(self) -> str:
        """Plural noun for the samples of the run."""
        return {RunKind.AUDIT: "trajectories", RunKind.SUITE: "episodes"}.get(self, "videos")

    @property
    def judges(self) -> bool:
        """True if the run judges kinematics."""
        return self is not RunKind.GROUND


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Options common to all runs."""

    out: Path
    """Output folder, created if absent."""
    kind: RunKind
    limit: int | None = None
    """Evaluate only the first so many samples."""
    shard: Shard | None = None
    """Evaluate only this part of the samples."""
    jobs: int = 1
    """Worker processes."""
    engine: ExecutorKind = ExecutorKind.LOCAL
    address: str | None = None
    """Address of the Ray cluster."""
    overwrite: bool = False
    """Discard the content of `out` instead of resuming."""
    seed: int = 0
    """Seed of the bootstrap."""
    model: str | None = None
    """Model of samples whose input names none."""
    tags: Mapping[str, str] = field(default_factory=dict)
    """Labels kept in the results."""
    make_tools: ToolsFactory = Tools
    """Creates the tools of a worker process; picklable."""
    table_height_m: float = 0.0
    """Height of the table top in the robot base frame [m]."""
    replays: int | None = None
    """Number of 3D replays of the worst samples; None keeps those that `view` wrote and writes none."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            UsageError: one of them is invalid.
        """
        for name, value, least in (("limit", self.limit, 1), ("seed", self.seed, 0), ("replays", self.replays, 0)):
            if value is not None and value < least:
                raise UsageError(f"${name} is {value}, expected {least} or more")
        if self.seed > MAX_SEED:
            raise UsageError(f"$seed is {self.seed}, expected {MAX_SEED} or less")
        self.robot_options()

    @property
    def suite_version(self) -> str | None:
        """Version of the suites; None for runs without episodes."""
        return None

    def robot_options(self) -> RobotOptions:
        """Return robot and table.

        Raises:
            UsageError: they are invalid.
        """
        return RobotOptions(table_height_m=self.table_height_m)

    def select(self, samples: Sequence[_Sample]) -> list[_Sample]:
        """Return the samples of this run: those of its shard, up to the limit."""
        selected = list(samples[: self.limit])
        return self.shard.take(selected) if self.shard else selected

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json; paths by their last name only."""
        return {
            "kind": self.kind.value,
            "limit": self.limit,
            "shard": str(self.shard) if self.shard else None,
            "jobs": self.jobs,
            "engine": self.engine.value,
            "seed": self.seed,
            "model": self.model,
            "table_height_m": self.table_height_m,
            "replays": self.replays,
        }
