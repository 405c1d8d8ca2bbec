"""`kinebench-drake suite export` and `suite demos`."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from kinebench_drake.cli.click_options import SIZES, config_options, echo
from kinebench_drake.cli.progress import ProgressView, terminate_as_interrupt
from kinebench_drake.errors import UsageError, count_noun
from kinebench_drake.results.metadata import Shard
from kinebench_drake.suites.runs.suite_config import SuiteConfig

if TYPE_CHECKING:
    from kinebench_drake.suites.demo_config import FormatKind, RenderOptions

EPISODES = ("suite", "split", "tasks", "episodes", "seed", "variant")
"""Options that choose episodes of a suite."""


@click.command(
    short_help="Write first frames, prompts and camera for world models.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite export --suite 0 --episodes 10 --out suite0/\n"
    "  kinebench-drake suite export --suite 2 --split unseen --tasks StackCube-v1 --episodes 50 --out looks/ --jobs 2",
)
@config_options(SuiteConfig, *EPISODES)
@click.option("--size", type=SIZES, default=384, show_default=True, help="Width and height of the images.")
@config_options(SuiteConfig, "prompts", "out", "jobs")
def export(size: int, prompts: Path | None, jobs: int, **options: Any) -> None:
    """Write the inputs of world models: first frames, prompts, camera.

    ID.png is an episode's first frame. manifest.jsonl lists it with the prompt and the video expected beside it,
    ID.mp4: once these exist, `kinebench-drake score OUT/manifest.jsonl` judges them. episodes.jsonl holds the full
    description of the episodes. The same arguments give the same bytes.
    """
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.suites.export import ExportConfig, export_suite
    from kinebench_drake.suites.prompts import PromptTemplate

    config = ExportConfig(**read_dataset(**options), size=size, prompts=PromptTemplate.parse(prompts))
    with ProgressView() as view, terminate_as_interrupt():
        count = export_suite(config, create_executor(ExecutorKind.LOCAL, jobs), view)
    of = count_noun(len(config.tasks), "task")
    echo(f"{count_noun(count, 'episode')} of {of} (suite {config.suite.number}, {config.split})")
    echo(config.out / "manifest.jsonl")


def read_dataset(suite: int, split: str, tasks: str | None, variant: str, **others: Any) -> dict[str, Any]:
    """Return the fields of `DatasetConfig` from the options of the command line."""
    from kinebench_drake.suites.catalog import chosen_tasks, load_suite
    from kinebench_drake.suites.families.task import TaskVariant

    loaded = load_suite(suite)
    task_variant = TaskVariant(variant)
    chosen = chosen_tasks(loaded, split, tasks, task_variant)
    return {**others, "suite": loaded, "split": loaded.split_name(split), "tasks": chosen, "variant": task_variant}


@click.command(
    short_help="Write expert demonstrations with ground truth.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite demos --task StackCube-v1 --episodes 10 --out demos/ --format mp4\n"
    "  kinebench-drake suite demos --suite 2 --split train --episodes 50 --out train/ --format lerobot-v3 --jobs 2\n"
    "  kinebench-drake suite demos --suite 0 --episodes 100 --out part1/ --shard 1/4",
)
@config_options(SuiteConfig, *EPISODES, defaults={"suite": 0, "split": "train"})
@click.option(
    "--format", "kind", type=click.Choice(["mp4", "lerobot-v3"]), default="mp4",
    show_default=True, help="mp4: a video per clip, with captions.",
)  # fmt: skip
@click.option("--size", type=SIZES, help="Width and height of the videos.  [default: 384]", metavar="PX")
@click.option(
    "--fps", type=click.FloatRange(0.1, 1000), metavar="FPS",
    help="Playback rate of an mp4 [frames/s]; a LeRobot dataset keeps the task's time.  [default: 17]",
)  # fmt: skip
@click.option(
    "--frames", type=int, metavar="F",
    help="Frames of a clip of 9.6 s: 49 (every fourth control step), 25, 97, 193 ...  [default: 49]",
)  # fmt: skip
@click.option("--crf", type=click.IntRange(0, 51), help="x264's quality, 0 is lossless.  [default: 16]")
@click.option("--with-depth", is_flag=True, help="mp4: keep depth and gripper masks in truth/ (some MB a video).")
@config_options(SuiteConfig, "out", "jobs", "shard")
@click.pass_context
def demos(
    ctx: click.Context,
    /,
    kind: str,
    size: int | None,
    fps: float | None,
    frames: int | None,
    crf: int | None,
    with_depth: bool,
    jobs: int,
    shard: str | None,
    **dataset: Any,
) -> None:
    """Write demonstrations of the scripted experts, with ground truth, to train world models and policies.

    K successful demonstrations of each task: a seed with which the expert fails is recorded in demos.jsonl and replaced
    by the next one. A larger K begins with the demonstrations of a smaller one, in the same folder too. The same
    command resumes a run that was stopped.
    """
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.suites.demo_config import DemoConfig, FormatKind
    from kinebench_drake.suites.demos import make_demos

    form = FormatKind(kind)
    config = DemoConfig(
        **read_dataset(**dataset),
        options=_render_options(form, size, fps, frames, crf, with_depth),
        kind=form,
        shard=None if shard is None else Shard.parse(shard),
    )
    with ProgressView("demonstrations") as view, terminate_as_interrupt():
        result = make_demos(config, create_executor(ExecutorKind.LOCAL, jobs), view)
    failed = f"; the expert failed with {count_noun(result.failures, 'other seed')}" if result.failures else ""
    made = count_noun(result.demonstrations, "demonstration")
    echo(f"{made} of {count_noun(len(config.tasks), 'task')}{failed}")
    echo(config.out)
    for task, count in result.short.items():
        echo(f"{task}: given up with {count} demonstrations missing; demos.jsonl has the reasons", err=True)
    ctx.exit(1 if result.short else 0)


def _render_options(
    kind: "FormatKind", size: int | None, fps: float | None, frames: int | None, crf: int | None, with_depth: bool
) -> "RenderOptions":
    """Build the options of rendering; None takes the default."""
    from kinebench_drake.suites.demo_config import FormatKind, RenderOptions

    choices = {"size": size, "fps": fps, "frames": frames, "crf": crf}
    values: dict[str, Any] = {name: x for name, x in choices.items() if x is not None}
    if with_depth and kind is not FormatKind.MP4:
        raise UsageError(f"--with-depth: the truth of --format {kind.value} holds none; take mp4")
    if size is not None and size % 2:
        raise UsageError(f"--size is {size}, expected an even number of pixels")
    options = RenderOptions(**values, with_depth=with_depth)
    if kind is FormatKind.LEROBOT:
        rate = 1.0 / options.frame_period_s
        if fps is not None or rate != round(rate):
            raise UsageError(
                f"a LeRobot dataset keeps the task's time in whole frames per second: --frames {options.frames} is "
                f"{rate:g} a second; leave out --fps, and take --frames 49 (5 a second), 97 (10) or 193 (20)"
            )
        options = replace(options, fps=rate)
    return options
