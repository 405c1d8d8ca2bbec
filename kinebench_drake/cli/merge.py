"""`kinebench-drake merge`."""

from pathlib import Path

import click

from kinebench_drake.cli.run import ProgressView, run
from kinebench_drake.results.row import SampleRow


class MergeView(ProgressView):
    """Progress of a merge: samples are counted, not printed."""

    def finish(self, row: SampleRow, wall_s: float) -> None:
        """Count the sample."""
        self._count()


@click.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake merge part1/ part2/ part3/ part4/ --out results/\n"
    "  kinebench-drake merge parts/* --out results/"
)
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), required=True,
    help="Folder for all of it; made if absent, added to if it holds an earlier merge of the run.",
)  # fmt: skip
@click.pass_context
def merge(ctx: click.Context, /, folders: tuple[Path, ...], out: Path) -> None:
    """Join the output folders DIR of a run's shards (--shard I/N) into one, as if one run had done all of it.

    Rows, tracks, videos and the rest are copied, DIR is left as it is; numbers and report are made anew from all rows.
    Shards must agree in everything but --shard, --jobs, --engine and --limit. The same command without --shard and with
    the merged folder as --out goes on from there: it does what is still absent.
    """
    from kinebench_drake.evaluation.merge import merge_folders

    ctx.exit(run(lambda observer: merge_folders(folders, out, observer), out, MergeView("samples")))
