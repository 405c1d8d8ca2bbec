"""Configuration of a run over the episodes of a suite."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from kinebench_drake.clip_timing import ClipTiming
from kinebench_drake.io.jsonl import Json
from kinebench_drake.runs.config import RunConfig, RunKind
from kinebench_drake.runs.option import Option
from kinebench_drake.suites.clock import FRAME_PERIOD_S, Control
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import Condition

if TYPE_CHECKING:  # ManiSkill and Drake take seconds to load
    from kinebench_drake.suites.catalog import Suite
    from kinebench_drake.suites.closed_loop.loop import LoopOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteConfig(RunConfig):
    """Options of a run over the episodes of a suite. `seed`: number of the first of the split's seeds."""

    kind: RunKind = RunKind.SUITE
    suite: Annotated[int, Option("Number of the suite.", least=0, most=3, metavar="N")]
    split: Annotated[
        str,
        Option(
            "Split of the suite; test: the split on which models are evaluated.",
            choices=("train", "test", "seen", "unseen"),
        ),
    ] = "test"
    tasks: Annotated[
        str | Sequence[str] | None,
        Option(
            "Tasks, comma-separated; FILE.py:CLASS is one of your own (docs/tasks.md).  [default: all]",
            metavar="A,B",
            also="--task",
        ),
    ] = None
    episodes: Annotated[int, Option("Episodes of each task.", least=1, metavar="K", key="episodes_per_task")] = 10
    samples: Annotated[
        int,
        Option(
            "Closed loops of each episode, each with another seed of the world model.",
            least=1,
            metavar="K",
            key="samples_per_episode",
        ),
    ] = 1
    variant: Annotated[TaskVariant, Option("Variant of the scenes; without $tasks: of the tasks that have it.")] = (
        TaskVariant.PLAIN
    )
    world_model: Annotated[
        str,
        Option(
            "World model: folder:DIR, http://..., command:..., dashscope:, minimax:, diffusers:..., oracle, still, "
            "random, module:Class, FILE.py:Class (docs/worldmodels.md).",
            metavar="SPEC",
        ),
    ]
    rounds: Annotated[int, Option("Largest number of clips per episode.", least=1, key=None)] = 3
    control: Annotated[Control, Option("Commands of the robot: joint angles from Drake, or poses.", key=None)] = (
        Control.JOINTS
    )
    frame_period_s: Annotated[float, Option("Task time between two frames.", metavar="SECONDS", key=None)] = (
        FRAME_PERIOD_S
    )
    clip_timing: Annotated[
        ClipTiming | None,
        Option(
            "Frames of a clip: evenly over the 48 frame periods that were requested, or one frame period apart.  "
            "[default: uniform for models that choose the number of frames (folder, services, diffusers with frames=), "
            "else native]",
            key=None,
        ),
    ] = None
    condition: Annotated[
        Condition,
        Option(
            "State the expert's track in requests, for action-conditioned models, and measure how far videos follow "
            "it.",
            key=None,
        ),
    ] = Condition.NONE
    pixels_only: Annotated[bool, Option("Do not use the robot's own pose as a prior for first frames.", key=None)] = (
        False
    )
    prompts: Annotated[
        Path | Mapping[str, str] | None,
        Option(
            "JSON object of texts in place of the instructions (docs/closedloop.md).",
            metavar="FILE",
            key=None,
        ),
    ] = None
    rollouts: Annotated[
        bool, Option("Write videos of the generated and executed motion side by side.", also="--no-rollouts", key=None)
    ] = True
    model_name: str | None = None
    """Name of the world model; filled in by `run_suite`."""
    loop: "LoopOptions" = field(init=False)
    """Options of the closed loop."""

    def __post_init__(self) -> None:
        """Convert and check the options; find the tasks and read the prompts.

        Raises:
            UsageError: one of them is invalid.
        """
        from kinebench_drake.suites.catalog import chosen_tasks
        from kinebench_drake.suites.closed_loop.loop import LoopOptions
        from kinebench_drake.suites.prompts import PromptTemplate

        RunConfig.__post_init__(self)
        suite = self.load_suite()
        shared = {option.name: getattr(self, option.name) for option in fields(LoopOptions)}
        loop = LoopOptions(**{**shared, "prompts": PromptTemplate.parse(self.prompts)})
        tasks = chosen_tasks(suite, self.split, self.tasks, self.variant)
        for name, value in (("loop", loop), ("tasks", tasks), ("split", suite.split_name(self.split))):
            object.__setattr__(self, name, value)

    def load_suite(self) -> "Suite":
        """Return the suite."""
        from kinebench_drake.suites.catalog import load_suite

        return load_suite(self.suite)

    @property
    def suite_version(self) -> str:
        """Version of the suites."""
        from kinebench_drake.suites.catalog import VERSION

        return VERSION

    def to_json(self) -> dict[str, Json]:
        """Serialize into `config` of results.json."""
        identity = parse(self.world_model).identity
        return {
            **RunConfig.to_json(self),
            "world_model": self.model_name,
            # The spec itself may hold addresses, paths or keys.
            "world_model_sha256": hashlib.sha256(identity.encode(errors="surrogateescape")).hexdigest(),
            **self.loop.to_json(),
            "rollouts": self.rollouts,
        }
