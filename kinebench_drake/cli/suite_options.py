"""Options that the commands of `suite` share."""

from pathlib import Path

import click

from kinebench_drake.errors import UsageError

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
