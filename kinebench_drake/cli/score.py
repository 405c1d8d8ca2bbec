"""`kinebench-drake score` and `kinebench-drake ground`."""

from typing import TYPE_CHECKING, Any

import click

from kinebench_drake.cli.options import PathParameter, judging_options, sample_options, video_options

if TYPE_CHECKING:
    from kinebench_drake.runs.score_config import ScoreConfig


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake score videos/ --out results/\n"
        "  kinebench-drake score videos/manifest.jsonl --out results/ --jobs 4 --tag run=7\n"
        "  kinebench-drake score episode.mp4 --out results/ --frame-period 0.2 --overlay\n"
        "  kinebench-drake score videos/ --out results/ --dry-run\n"
        "  kinebench-drake score lerobot-dataset/ --out results/ --camera-key observation.images.front\n"
        "  kinebench-drake score heldout/manifest.jsonl --out results/ --masks heldout --depth heldout"
    )
)
@click.argument("source", metavar="PATH", type=PathParameter())
@sample_options
@video_options
@judging_options
@click.pass_context
def score(ctx: click.Context, /, dry_run: bool, **options: Any) -> None:
    """Score the videos of PATH: gripper tracks, kinematic metrics, report.

    PATH is a video (mp4, mov, avi, gif, webm, mkv), a folder of videos or frame folders, a npy or npz file
    (T,H,W,3 uint8), an HDF5 file, a LeRobot dataset (v2 or v3), a VideoFolder with its metadata, a folder of EWMBench
    or WorldArena, or a manifest.jsonl. A camera.json beside the videos gives their camera (docs/formats.md).

    --masks, --depth and --poses replace stages of the grounding by results of other tools. Each DIR holds ID.npz,
    ID.npy or a folder ID/ for every video (docs/grounding.md), or is a demonstration folder with its truth.
    """
    from kinebench_drake.runs.score_config import ScoreConfig

    ctx.exit(_score(ScoreConfig(**options), dry_run=dry_run))


@click.command(
    epilog=(
        "\b\nExamples:\n"
        "  kinebench-drake ground videos/ --out tracks/ --overlay\n"
        "  kinebench-drake ground videos/ --out tracks/ --masks yolo/ --depth moge:model.pt\n"
        "  kinebench-drake ground videos/ --out tracks/ --poses foundationpose/"
    )
)
@click.argument("source", metavar="PATH", type=PathParameter())
@sample_options
@video_options
@click.pass_context
def ground(ctx: click.Context, /, dry_run: bool, **options: Any) -> None:
    """Extract the gripper track of each video of PATH, without judging it.

    PATH is as in `score`. Tracks are written to tracks/ID.npz in the output folder, videos with the tracked gripper
    to overlays/ID.mp4.

    --masks, --depth and --poses replace stages of the grounding by results of other tools. Each DIR holds ID.npz,
    ID.npy or a folder ID/ for every video (docs/grounding.md), or is a demonstration folder with its truth.
    """
    from kinebench_drake.runs.config import RunKind
    from kinebench_drake.runs.score_config import ScoreConfig

    ctx.exit(_score(ScoreConfig(kind=RunKind.GROUND, **options), dry_run=dry_run))


def _score(config: "ScoreConfig", *, dry_run: bool) -> int:
    """Carry out a run, or list what it would read; return the exit status."""
    from kinebench_drake.cli.run import ProgressView, run
    from kinebench_drake.results.inputs import input_lines
    from kinebench_drake.results.row import Status
    from kinebench_drake.runs.score import plan_videos, score_videos

    if not dry_run:
        return run(lambda observer: score_videos(config, observer), config.out)
    rows = []
    for row in plan_videos(config, ProgressView("samples")):
        rows.append(row)
        frames, width, height = (row.extra.get(key) for key in ("frames", "width", "height"))
        size = f"{frames} frames of {width} x {height} px" if row.status is Status.OK else str(row.reason)
        labels = [f"{key} {value}" for key, value in (("task", row.task), ("model", row.model)) if value is not None]
        click.echo("; ".join([f"{row.id}: {size}", *input_lines([row]), *labels]))
    readable = [row for row in rows if row.status is Status.OK]
    click.echo(f"{len(readable)} of {len(rows)} samples can be read; nothing was measured or written")
    for line in input_lines(readable):
        click.echo(line)
    return 0 if readable else 1
