"""Options that commands share."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from kinebench_drake.errors import UsageError
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.results.metadata import Shard

Function = TypeVar("Function", bound=Callable[..., Any])


def _shard(ctx: click.Context, param: click.Parameter, value: str | None) -> Shard | None:
    return None if value is None else Shard.parse(value)


def _engine(ctx: click.Context, param: click.Parameter, value: str) -> ExecutorKind:
    return ExecutorKind(value)


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

_RUN = (
    click.option("--out", type=click.Path(path_type=Path), required=True, help="Output folder; made if absent."),
    click.option("--limit", type=_COUNT, help="Work on the first N samples only.", metavar="N"),
    click.option("--jobs", type=_COUNT, default=1, show_default=True, help="Worker processes.", metavar="N"),
    click.option("--shard", callback=_shard, help="Work on part I (1 to N) of N, for several machines.", metavar="I/N"),
    click.option(
        "--engine",
        type=click.Choice([kind.value for kind in ExecutorKind]),
        callback=_engine,
        default=ExecutorKind.LOCAL.value,
        show_default=True,
        help="Where workers run: processes of this machine, or a Ray cluster.",
    ),
    click.option(
        "--address",
        help="Ray cluster.  [default: RAY_ADDRESS, or that of this machine]",
        metavar="HOST:PORT",
    ),
    click.option(
        "--overwrite/--resume",
        default=False,
        help="Start anew, or keep finished samples whose input and settings are the same.  [default: resume]",
    ),
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Seed of the bootstrap behind intervals; of a suite also its first episode's.",
    ),
    click.option(
        "--model",
        help="World model behind the samples, where the input does not tell; of a suite its name in tables.",
        metavar="NAME",
    ),
    click.option("--tag", "tags", multiple=True, callback=_tags, help="Label kept in results.", metavar="KEY=VALUE"),
)

_TASK = click.option("--task", help="Task of the samples, where the input does not tell.", metavar="NAME")

_VIDEO = (
    click.option(
        "--frame-period",
        "frame_period_s",
        type=float,
        help="Task time between two frames; benchmark videos: 0.2.  [default: 1 / fps]",
        metavar="SECONDS",
    ),
    click.option(
        "--camera-key",
        help="Camera to take of a LeRobot dataset, HDF5 or npz file that has several, by its name or part of it.",
        metavar="NAME",
    ),
    click.option("--overlay/--no-overlay", default=False, help="Write videos with the gripper drawn in."),
    click.option(
        "--pixels-only",
        is_flag=True,
        help="Leave aside what the manifest tells of the first frame (its pose, or task and seed of an episode).",
    ),
    click.option(
        "--masks",
        type=click.Path(path_type=Path),
        help="Take the gripper's masks from here, not from the network.",
        metavar="DIR",
    ),
    click.option(
        "--depth",
        help="Take metric depth from files, from MoGe-2 or from a class of yours.",
        metavar="DIR|moge:CHECKPOINT|module:Class",
    ),
    click.option(
        "--depth-exact",
        is_flag=True,
        help="Trust the depth of --depth to a few millimetres (sensor, simulator), not as an estimate.",
    ),
    click.option(
        "--poses",
        type=click.Path(path_type=Path),
        help="Take poses of panda_hand in the camera frame from here, not from the tracker.",
        metavar="DIR",
    ),
)


_JUDGING = (
    click.option(
        "--table-height",
        "table_height_m",
        type=float,
        default=0.0,
        show_default=True,
        help="Height of the table's top in the robot's base frame.",
        metavar="METRES",
    ),
)

replays_option = click.option(
    "--replays",
    type=click.IntRange(min=0),
    default=3,
    show_default=True,
    help="Write 3D replays of the N worst samples (3 MB each); `view` writes one of any.",
    metavar="N",
)


def sample_options(function: Function) -> Function:
    """Add what `score`, `ground` and `audit` share."""
    return run_options(_TASK(function))


def run_options(function: Function) -> Function:
    """Add what these and `suite run` share."""
    for option in reversed(_RUN):
        function = option(function)
    return function


def judging_options(function: Function) -> Function:
    """Add what commands that hold tracks against the robot share."""
    for option in reversed(_JUDGING):
        function = option(function)
    return replays_option(function)


def video_options(function: Function) -> Function:
    """Add what commands that read videos share."""
    for option in reversed(_VIDEO):
        function = option(function)
    return function


tasks_option = click.option(
    "--tasks", "--task", "tasks", metavar="A,B", help="Tasks, comma-separated.  [default: all there are]"
)
episodes_option = click.option(
    "--episodes", type=click.IntRange(1), default=10, show_default=True, help="Episodes of each task.", metavar="K"
)
jobs_option = click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")
variant_option = click.option(
    "--variant",
    type=click.Choice(["plain", "obstacles"]),
    default="plain",
    show_default=True,
    help="Version of the scenes; without --tasks: of the tasks that have it.",
)
split_help = "Part of the suite; test: the part that models are judged on."
SPLITS = click.Choice(["train", "test", "seen", "unseen"])
SUITES = click.IntRange(0, 3)
SIZES = click.IntRange(128, 2048)
"""Sizes of pictures [px]: x264 writes films smaller than that with other bytes each time."""


def check_parent(option: str, path: Path) -> None:
    """Make sure, before long work, that a file can be written where the user wants it.

    Raises:
        UsageError: its folder is not there.
    """
    if not path.parent.is_dir():
        raise UsageError(f"{option} {path}: there is no folder {path.parent}; make it first")
