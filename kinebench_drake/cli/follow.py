"""`kinebench-drake follow`."""

from typing import Any

import click

from kinebench_drake.cli.click_options import GroupedCommand, config_options
from kinebench_drake.cli.score import OPTION_GROUPS, source_argument
from kinebench_drake.runs.follow import FollowConfig

_UNFOLLOWED = ("format", "limits", "payload_kg", "obstacles", "replays", "fail_on", "sarif", "write_kept")
"""Options of `score` without a meaning where a motion is compared."""


@click.command(
    cls=GroupedCommand,
    groups=OPTION_GROUPS,
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake follow videos/ --actions actions/ --out results/     # videos/a.mp4, actions/a.npz\n"
        "  kinebench-drake follow videos/manifest.jsonl --out results/          # key actions of each line\n"
        "  kinebench-drake follow generated/ --reference real/ --out results/"
    ),
)
@source_argument
@config_options(FollowConfig, omit=("source", *_UNFOLLOWED))
@click.pass_context
def follow(ctx: click.Context, /, **options: Any) -> None:
    """Compare the videos of PATH with the actions, or the real clips, that they should show.

    PATH is as in `score`. The motion of the gripper is measured, and compared with the commanded one: how far it is
    from it, how late, how large, from which frame on it drifts, and whether it follows. The same is done with
    shuffled, reversed and still actions: what follows those as well proves nothing (docs/following.md).

    Actions are joint angles or poses of the TCP, one row per frame or with times (docs/formats.md); --reading states
    what their names leave open, also changes from frame to frame. The camera, if none is named, is fitted to the arm in
    the commanded postures, on frames that are not judged.
    """
    from kinebench_drake.cli.progress import run
    from kinebench_drake.runs.follow import follow_videos

    config = FollowConfig(replays=None, **options)
    ctx.exit(run(lambda observer: follow_videos(config, observer), config.out))
