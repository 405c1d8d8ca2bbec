"""Options shared by several commands."""

import errno
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.results.metadata import Shard
from kinebench_drake.suites.clock import ClipTiming

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class PathParameter(click.Path):
    """Path on the command line. An empty one, as of an unset variable, is refused: it would be the current folder."""

    def __init__(self, **options: Any) -> None:
        """Create the type; `options` are those of `click.Path`."""
        super().__init__(path_type=Path, **options)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; fails if it is empty, or not as the options demand."""
        if not os.fspath(value):
            self.fail("the path is empty", param, ctx)
        try:
            os.stat(value)
        except OSError as error:
            if error.errno in (errno.ENAMETOOLONG, errno.ELOOP):
                self.fail(f"{os.fspath(value)[:60]}...: {error.strerror}", param, ctx)
        return super().convert(value, param, ctx)


def _combine(*options: Decorator) -> Decorator:
    """Return a decorator that adds several options, shown in this order."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            function = option(function)
        return function

    return add


def _tags(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    tags = {}
    for value in values:
        match = re.fullmatch(r"([^=]+)=(.*)", value, re.DOTALL)
        if not match:
            raise click.BadParameter(f"{value!r} is not of the form KEY=VALUE", ctx, param)
        if match[1] in tags:
            raise click.BadParameter(f"{match[1]!r} is given twice, expected each KEY once", ctx, param)
        tags[match[1]] = match[2]
    return tags


_COUNT = click.IntRange(min=1)

run_options = _combine(
    click.option("--out", type=PathParameter(), required=True, help="Output folder; created if absent."),
    click.option("--limit", type=_COUNT, help="Evaluate only the first N samples.", metavar="N"),
    click.option("--jobs", type=_COUNT, default=1, show_default=True, help="Worker processes.", metavar="N"),
    click.option(
        "--shard",
        callback=lambda ctx, param, value: None if value is None else Shard.parse(value),
        help="Evaluate only part I of N, for several machines.",
        metavar="I/N",
    ),
    click.option(
        "--engine",
        type=click.Choice([kind.value for kind in ExecutorKind]),
        callback=lambda ctx, param, value: ExecutorKind(value),
        default=ExecutorKind.LOCAL.value,
        show_default=True,
        help="Where workers run: processes of this machine, or a Ray cluster.",
    ),
    click.option(
        "--address", help="Ray cluster.  [default: RAY_ADDRESS, or that of this machine]", metavar="HOST:PORT"
    ),
    click.option(
        "--overwrite/--resume",
        default=False,
        help="Start anew, or keep finished samples whose input and options are unchanged.  [default: resume]",
    ),
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Seed of the bootstrap; of `suite` commands also the number of the first of the split's seeds.",
    ),
    click.option(
        "--model",
        help="World model behind the samples, where the input does not name it; of `suite run` its name in tables.",
        metavar="NAME",
    ),
    click.option("--tag", "tags", multiple=True, callback=_tags, help="Label kept in results.", metavar="KEY=VALUE"),
)
"""Options of `score`, `ground`, `audit` and `suite run`."""

sample_options = _combine(
    run_options, click.option("--task", help="Task of the samples, where the input does not name it.", metavar="NAME")
)
"""Options of `score`, `ground` and `audit`."""


def clip_timing_option(meaning: str) -> Decorator:
    """Return the option for the timing of clips."""
    return click.option("--clip-timing", type=click.Choice([timing.value for timing in ClipTiming]), help=meaning)


video_options = _combine(
    click.option(
        "--frame-period",
        "frame_period_s",
        type=float,
        help="Task time between two frames; benchmark videos: 0.2.  [default: 1 / fps]",
        metavar="SECONDS",
    ),
    clip_timing_option(
        "Frames of a video: evenly over the task's duration, sampled every frame period, or one frame period apart.  "
        "[default: native; uniform with --task-duration]"
    ),
    click.option(
        "--task-duration",
        "task_duration_s",
        type=float,
        help="Task time that each video shows, whatever its number of frames.  [default with uniform: 9.6]",
        metavar="SECONDS",
    ),
    click.option(
        "--camera-key",
        help="Camera to use of a LeRobot dataset, HDF5 or npz file that has several, by its name or part of it.",
        metavar="NAME",
    ),
    click.option(
        "--camera",
        default="auto",
        show_default=True,
        help="Camera of videos that name none: auto takes the benchmark camera where the arm confirms it and "
        "estimates it from the arm elsewhere, benchmark insists on the former; a camera.json is that of all videos.",
        metavar="auto|benchmark|FILE",
    ),
    click.option(
        "--mirrored", is_flag=True, help="The pictures show the scene mirrored: turn them left-right first (LIBERO)."
    ),
    click.option(
        "--gripper",
        type=click.Choice(["auto", "franka", "robotiq-2f85", "none"]),
        default="auto",
        show_default=True,
        help="Gripper on the arm. With another one than Franka's the links give the flange, with robotiq-2f85 also its "
        "contours; the opening is unknown. auto does so where the arm is seen without a Franka hand, links first.",
    ),
    click.option(
        "--dry-run",
        is_flag=True,
        help="List samples, frame periods and cameras; measure and write nothing.",
    ),
    click.option("--overlay/--no-overlay", default=False, help="Write videos with the tracked gripper drawn in."),
    click.option(
        "--pixels-only",
        is_flag=True,
        help="Ignore the initial state in the manifest (pose of the first frame, or task and seed of an episode).",
    ),
    click.option("--masks", type=PathParameter(), help="Gripper masks that replace the network's.", metavar="DIR"),
    click.option(
        "--depth",
        help="Metric depth that replaces the network's: files, MoGe-2 or a class of yours.",
        metavar="DIR|moge:CHECKPOINT|module:Class",
    ),
    click.option(
        "--depth-exact",
        is_flag=True,
        help="Treat the depth of --depth as accurate to a few millimetres (sensor, simulator).",
    ),
    click.option(
        "--poses",
        type=PathParameter(),
        help="Poses of panda_hand in the camera frame that replace the tracker's.",
        metavar="DIR",
    ),
)
"""Options of commands that read videos."""

replays_option = click.option(
    "--replays",
    type=click.IntRange(min=0),
    default=3,
    show_default=True,
    help="Write 3D replays of the N worst samples (3 MB each); `view` writes one of any.",
    metavar="N",
)


judging_options = _combine(
    replays_option,
    click.option(
        "--table-height",
        "table_height_m",
        type=float,
        default=0.0,
        show_default=True,
        help="Height of the table top in the robot base frame.",
        metavar="METRES",
    ),
)
"""Options of commands that judge kinematics."""

tasks_option = click.option("--tasks", "--task", "tasks", metavar="A,B", help="Tasks, comma-separated.  [default: all]")
episodes_option = click.option(
    "--episodes", type=click.IntRange(1), default=10, show_default=True, help="Episodes of each task.", metavar="K"
)
jobs_option = click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")
variant_option = click.option(
    "--variant",
    type=click.Choice(["plain", "obstacles"]),
    default="plain",
    show_default=True,
    help="Variant of the scenes; without --tasks: of the tasks that have it.",
)
first_seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Number of the first of the split's seeds."
)
prompt_options = _combine(
    click.option(
        "--prompt-preset",
        type=click.Choice(["visual-lock"]),
        help="Prefix and negative prompt that ask for a fixed camera and unchanged robot and objects.",
    ),
    click.option("--prompt-prefix", metavar="TEXT", help="Text before each prompt; replaces that of the preset."),
    click.option("--prompt-suffix", metavar="TEXT", help="Text after each prompt."),
    click.option(
        "--prompts",
        type=PathParameter(),
        metavar="FILE",
        help='JSON object of texts by task in place of the instruction; "{prompt}" in a text stands for it.',
    ),
    click.option("--negative-prompt", metavar="TEXT", help="Content to avoid; replaces that of the preset."),
)
"""Options of the prompts of world models."""
SPLITS = click.Choice(["train", "test", "seen", "unseen"])
SIZES = click.IntRange(128, 2048)
"""Side lengths of images [px]."""


def suite_options(*, number: int | None = None, split: str = "test") -> Decorator:
    """Return the options that choose episodes of a suite.

    Args:
        number: suite by default; None: the user must name one.
        split: split by default.
    """
    return _combine(
        click.option(
            "--suite", "number", type=click.IntRange(0, 3), help="Number of the suite.", metavar="N",
            **({"required": True} if number is None else {"default": number, "show_default": True}),
        ),
        click.option(
            "--split", type=SPLITS, default=split, show_default=True,
            help="Split of the suite; test: the split on which models are evaluated.",
        ),
        tasks_option,
        episodes_option,
    )  # fmt: skip


def check_parent(option: str, path: Path) -> None:
    """Check, before long work, that the folder of an output file exists.

    Raises:
        UsageError: it does not.
    """
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: there is no folder {path.parent}; create it first")


def check_suffix(option: str, path: Path | None, *suffixes: str) -> None:
    """Check, before long work, that the name of an output file ends in one of `suffixes`; None for no file.

    Raises:
        UsageError: it does not.
    """
    if path is not None and path.suffix.lower() not in suffixes:
        raise UsageError(f"{option} {path.name}: expected a name that ends in {' or '.join(suffixes)}")
