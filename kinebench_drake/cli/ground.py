"""`kinebench-drake ground`."""

from pathlib import Path
from typing import Any

import click

from kinebench_drake.cli.options import sample_options, video_options


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake ground videos/ --out tracks/ --overlay\n"
        "  kinebench-drake ground videos/ --out tracks/ --masks yolo/ --depth moge:model.pt\n"
        "  kinebench-drake ground videos/ --out tracks/ --poses foundationpose/"
    )
)
@click.argument("source", metavar="PATH", type=click.Path(path_type=Path))
@sample_options
@video_options
@click.pass_context
def ground(ctx: click.Context, /, **options: Any) -> None:
    """Take the gripper's track from each video of PATH, without judging it.

    PATH is what `score` takes. Tracks go to tracks/ID.npz in the output folder, videos with the gripper drawn in to
    overlays/ID.mp4.

    --masks, --depth and --poses put results of other tools in place of stages of the grounding. Each DIR holds
    ID.npz, ID.npy or a folder ID/ for every video (docs/grounding.md), or is a demonstration folder with its truth.
    """
    from kinebench_drake.cli.run import run
    from kinebench_drake.measure import Kind
    from kinebench_drake.score import ScoreConfig, score_videos

    config = ScoreConfig(kind=Kind.GROUND, **options)
    ctx.exit(run(lambda observer: score_videos(config, observer), config.out))
