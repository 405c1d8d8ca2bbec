"""`suite run`: a world model on the episodes of a suite in closed loop."""

import hashlib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from typing import Any

from kinebench_drake.closed_loop.loop import Condition, LoopOptions
from kinebench_drake.errors import UsageError, count_noun, member_of
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.io.jsonl import Json
from kinebench_drake.results.row import SampleRow
from kinebench_drake.runs.config import RunConfig, RunKind
from kinebench_drake.runs.episode import EpisodeEvaluator, EpisodeSample
from kinebench_drake.runs.requests import write_requests
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary, run_samples
from kinebench_drake.suites.catalog import VERSION, Suite, chosen_tasks, load_suite
from kinebench_drake.suites.clock import ClipTiming
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.prompts import PROMPT_OPTIONS, prompt_template
from kinebench_drake.suites.simulator import Control
from kinebench_drake.suites.worldmodels.factory import LazyWorldModel
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import OfflineModel


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteConfig(RunConfig):
    """Options of a run over the episodes of a suite. `seed`: number of the first of the split's seeds."""

    kind: RunKind = RunKind.SUITE
    suite: Suite
    split: str
    """Name of one of the suite's splits."""
    tasks: tuple[str, ...]
    """Plain task ids of the split."""
    episodes: int
    """Episodes of each task."""
    samples: int = 1
    """Samples of each episode: closed loops from the same scene, with another seed of the world model."""
    variant: TaskVariant = TaskVariant.PLAIN
    world_model: str
    """Spec of the world model (docs/worldmodels.md)."""
    model_name: str | None = None
    """Name of the world model; filled in by `run_suite`."""
    loop: LoopOptions = field(default_factory=LoopOptions)
    rollouts: bool = True
    """Write rollouts/ID.mp4."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            UsageError: one of them is invalid.
        """
        RunConfig.__post_init__(self)
        if self.episodes < 1:
            raise UsageError(f"$episodes is {self.episodes}, expected 1 or more")
        if self.samples < 1:
            raise UsageError(f"$samples is {self.samples}, expected 1 or more")

    @property
    def suite_version(self) -> str:
        """Version of the suites."""
        return VERSION

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json."""
        identity = parse(self.world_model).identity
        return {
            **RunConfig.to_json(self),
            "suite": self.suite.number,
            "split": self.split,
            "tasks": list(self.tasks),
            "episodes_per_task": self.episodes,
            "samples_per_episode": self.samples,
            "variant": self.variant.value,
            "world_model": self.model_name,
            # The spec itself may hold addresses, paths or keys.
            "world_model_sha256": hashlib.sha256(identity.encode(errors="surrogateescape")).hexdigest(),
            **self.loop.to_json(),
            "rollouts": self.rollouts,
        }


def suite_config(
    number: int,
    *,
    split: str = "test",
    tasks: str | Sequence[str] | None = None,
    episodes: int = 10,
    variant: str = TaskVariant.PLAIN.value,
    control: str = Control.JOINTS.value,
    clip_timing: str | None = None,
    condition: str = Condition.NONE.value,
    **options: Any,
) -> SuiteConfig:
    """Build the configuration of a run from the values of command line or Python interface.

    Args:
        number: number of the suite.
        split: name of the split.
        tasks: plain task ids, in a list or comma-separated; None: all of the split.
        episodes: episodes of each task.
        variant: name of a task variant.
        control: name of a controller.
        clip_timing: name of a timing; None: by the model.
        condition: name of a `Condition`.
        **options: arguments of `prompt_template`, and further fields of `SuiteConfig` and `LoopOptions`.

    Raises:
        UsageError: a value is invalid.
    """
    suite = load_suite(number)
    task_variant = member_of(TaskVariant, variant, "variant")
    timing = None if clip_timing is None else member_of(ClipTiming, clip_timing, "clip_timing")
    prompts = prompt_template(**{name: options.pop(name) for name in PROMPT_OPTIONS if name in options})
    loop = {f.name: options.pop(f.name) for f in fields(LoopOptions) if f.name in options and f.name != "seed"}
    return SuiteConfig(
        suite=suite,
        split=suite.split_name(split),
        tasks=chosen_tasks(suite, split, tasks, task_variant),
        episodes=episodes,
        variant=task_variant,
        loop=LoopOptions(
            control=member_of(Control, control, "control"),
            clip_timing=timing,
            condition=member_of(Condition, condition, "condition"),
            prompts=prompts,
            **loop,
        ),
        **options,
    )


def run_suite(config: SuiteConfig, observer: RunObserver | None = None) -> RunSummary:
    """Run every episode of a suite's split with a world model and fill the output folder.

    Raises:
        UsageError: the configuration or the output folder cannot be used.
        SetupError: something is missing on this machine, or the disk is full. Finished samples are kept.
    """
    observer = observer or NullRunObserver()
    with closing(LazyWorldModel(config.world_model)) as world_model:
        model = world_model.get()
        name, offline = model.name, isinstance(model, OfflineModel)
        if not offline and (config.jobs > 1 or config.engine is not ExecutorKind.LOCAL):
            world_model.close()  # workers load their own, and may need the memory
        evaluator = EpisodeEvaluator(
            config=replace(config, model_name=name),
            world_model=world_model,
            offline=offline,
            loop=config.loop,
            rollouts=config.rollouts,
            subject={"suite": config.suite.number, "split": config.split},
        )
        samples = [
            EpisodeSample(spec=spec, index=index, model=config.model or name)
            for spec in config.suite.specs(
                config.split, config.episodes, tasks=config.tasks, offset=config.seed, variant=config.variant
            )
            for index in range(config.samples)
        ]
        summary = run_samples(samples, evaluator, observer)
        write_requests(config.out, summary.pending)
        _warn_of_lengths(summary.rows, config.loop, observer)
        return summary


def _warn_of_lengths(rows: Sequence[SampleRow], loop: LoopOptions, observer: RunObserver) -> None:
    """Warn of clips that do not have the requested number of frames, and say how they were used."""
    period_s, expected = loop.frame_period_s, loop.num_frames
    clip_s = period_s * (expected - 1)
    uses = {
        ClipTiming.UNIFORM: f"each was sampled evenly over {clip_s:g} s ($clip_timing native: {period_s:g} s a frame)",
        ClipTiming.NATIVE: f"{period_s:g} s a frame were taken ($clip_timing uniform: {clip_s:g} s a clip)",
    }
    for timing, use in uses.items():
        lengths = [row.extra.get("clip_frames") for row in rows if row.extra.get("clip_timing") == timing.value]
        others = [{*clips} - {expected} for clips in lengths if isinstance(clips, list)]
        if frames := sorted({n for clips in others for n in clips}):
            count = sum(bool(clips) for clips in others)
            observer.warn(
                f"{count_noun(count, 'episode')} with clips of {_range(frames)} frames in place of {expected}: {use}"
            )


def _range(numbers: Sequence[int]) -> str:
    """Return the least and the greatest of sorted numbers as text."""
    return f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
