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
    help="Output folder; created if absent, extended if it holds an earlier merge of the run.",
)  # fmt: skip
@click.pass_context
def merge(ctx: click.Context, /, folders: tuple[Path, ...], out: Path) -> None:
    """Merge the output folders DIR of a run's shards (--shard I/N) into one, as if a single run had made them.

    Rows, tracks, videos and other files are copied, DIR is not changed; aggregates and report are computed from all
    rows. Shards must agree in all settings but --shard, --jobs, --engine and --limit. To complete a merged folder, run
    the original command without --shard and with the merged folder as --out: it processes the samples still absent.
    """
    from kinebench_drake.evaluation.merge import merge_folders

    ctx.exit(run(lambda observer: merge_folders(folders, out, observer), out, MergeView("samples")))
