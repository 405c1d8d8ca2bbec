"""A world model on a suite: every episode in closed loop, and what came of them."""

import hashlib
from contextlib import closing
from dataclasses import dataclass, field, replace

from kinebench_drake.closed_loop.loop import LoopOptions
from kinebench_drake.errors import UsageError
from kinebench_drake.evaluation.episode import EpisodeEvaluator, EpisodeSample
from kinebench_drake.evaluation.evaluator import RunKind
from kinebench_drake.evaluation.runner import NullRunObserver, RunConfig, RunObserver, RunSummary, run_samples
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.suites.suite import VERSION, Suite
from kinebench_drake.suites.tasks.card import TaskVariant
from kinebench_drake.suites.worldmodels.lazy_model import LazyWorldModel
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import Offline
from kinebench_drake.types import Json


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteConfig(RunConfig):
    """Everything a run of a suite is told. `seed`: number of the first of the split's seeds."""

    kind: RunKind = RunKind.SUITE
    suite: Suite
    split: str
    """Name of one of the suite's splits."""
    tasks: tuple[str, ...]
    """Plain task ids of the split."""
    episodes: int
    """Episodes of each task."""
    variant: TaskVariant = TaskVariant.PLAIN
    world_model: str
    """What to ask: see docs/worldmodels.md."""
    model_name: str | None = None
    """What the world model calls itself; `run_suite` asks it."""
    loop: LoopOptions = field(default_factory=LoopOptions)
    rollouts: bool = True
    """Write rollouts/ID.mp4."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            UsageError: one of them makes no sense.
        """
        RunConfig.__post_init__(self)
        if self.episodes < 1:
            raise UsageError(f"--episodes is {self.episodes}, expected 1 or more")

    @property
    def suite_version(self) -> str:
        """See `RunConfig`."""
        return VERSION

    def to_json(self) -> dict[str, Json]:
        """What results tell of the configuration."""
        known = parse(self.world_model).identity
        return {
            **RunConfig.to_json(self),
            "suite": self.suite.number,
            "split": self.split,
            "tasks": list(self.tasks),
            "episodes_per_task": self.episodes,
            "variant": self.variant.value,
            "world_model": self.model_name,
            # The spec itself may hold addresses, paths or keys.
            "world_model_sha256": hashlib.sha256(known.encode(errors="surrogateescape")).hexdigest(),
            "rounds": self.loop.rounds,
            "control": self.loop.control.value,
            "action_repeat": self.loop.action_repeat,
            "frame_period_s": self.loop.frame_period_s,
            "pixels_only": self.loop.pixels_only,
            "negative_prompt": self.loop.negative_prompt,
            "rollouts": self.rollouts,
        }


def run_suite(config: SuiteConfig, observer: RunObserver | None = None) -> RunSummary:
    """Run every episode of a suite's split with a world model and fill the output folder.

    Raises:
        UsageError: the configuration or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. What was finished is kept.
    """
    observer = observer or NullRunObserver()
    with closing(LazyWorldModel(config.world_model)) as held:
        model = held.get()
        name, offline = model.name, isinstance(model, Offline)
        if offline and config.loop.rounds > 1:
            observer.warn(f"{name} holds finished videos: they answer the first round only")
        if not offline and (config.jobs > 1 or config.engine is not ExecutorKind.LOCAL):
            held.close()  # the workers make their own, and may need the room
        measure = EpisodeEvaluator(
            kind=config.kind,
            out=config.out,
            stages=config.stages,
            stage_options=config.stage_options(),
            world_model=held,
            offline=offline,
            loop=config.loop,
            rollouts=config.rollouts,
        )
        samples = [
            EpisodeSample(draw=draw, model=config.model or name)
            for task in config.tasks
            for draw in config.suite.draws(
                config.split, task, config.episodes, offset=config.seed, variant=config.variant
            )
        ]
        return run_samples(replace(config, model_name=name), samples, measure, observer)
