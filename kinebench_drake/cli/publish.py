"""Commands that publish results: `bundle`, `verify`, `leaderboard`."""

from pathlib import Path

import click
import numpy as np

from kinebench_drake.cli.click_options import PathParameter, check_parent, check_suffix, echo
from kinebench_drake.errors import UsageError, count_noun


@click.command(epilog="\b\nExample:\n  kinebench-drake bundle results/ --out results.zip")
@click.argument("run", metavar="RUN", type=PathParameter())
@click.option("--out", type=PathParameter(dir_okay=False), required=True, metavar="FILE.zip", help="File to write.")
def bundle(run: Path, out: Path) -> None:
    """Pack the finished output folder RUN into one zip: rows, results, tracks, thumbnails, configuration, hashes.

    bundle.json in it has the SHA-256 of every file and of every video that was measured. Equal folders give equal
    bytes. Print the SHA-256 of the bundle, by which others can name it.
    """
    from kinebench_drake.io.archive import hash_file
    from kinebench_drake.results.bundle import write_bundle

    check_suffix("--out", out, ".zip")
    check_parent("--out", out)
    write_bundle(run, out)
    echo(f"{hash_file(out)}  {out}")


@click.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake verify results.zip\n"
    "  kinebench-drake verify results.zip --samples 50 --videos videos/"
)
@click.argument("file", metavar="FILE.zip", type=PathParameter())
@click.option(
    "--samples", type=click.IntRange(0), default=20, show_default=True, metavar="N", help="Samples to measure anew."
)
@click.option("--videos", type=PathParameter(), metavar="DIR", help="The videos: ground those samples anew, too.")
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Seed of the choice of samples.  [default: random]")
@click.pass_context
def verify(ctx: click.Context, /, file: Path, samples: int, videos: Path | None, seed: int | None) -> None:
    """Check whether the numbers of a bundle follow from its tracks; exit with 1 and name those that do not.

    The hashes of all files, the aggregates of all rows, and of N random samples the verdict and every number of the
    track, within 0.1 %. With --videos the videos of these samples must be those that were measured, and give the same
    track: within 10 mm and 5 degrees in all but 5 % of the frames.
    """
    from kinebench_drake.results.bundle import open_bundle
    from kinebench_drake.runs.verify import verify_bundle

    if videos is not None and not videos.exists():
        raise UsageError(f"--videos {videos}: there is no such file or folder")
    seed = int(np.random.default_rng().integers(2**31)) if seed is None else seed
    with open_bundle(file) as opened:
        outcome = verify_bundle(opened, samples, seed, videos)
    for fault in outcome.faults:
        echo(fault)
    n = len(outcome.measured)
    source = "tracks" if videos is None else "tracks and videos"
    echo(
        f"{file}: {'does not hold' if outcome.faults else 'holds'}: hashes and aggregates of "
        f"{count_noun(outcome.samples, 'sample')}, {n} of {outcome.candidates} measurable ones anew from {source} "
        f"(--seed {seed})"
    )
    ctx.exit(1 if outcome.faults else 0)


@click.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake leaderboard wan.zip cogvideox.zip --out leaderboard/\n"
    "  kinebench-drake leaderboard oracle.zip wan.zip cogvideox.zip --out leaderboard/"
)
@click.argument("files", metavar="FILE.zip...", nargs=-1, required=True, type=PathParameter())
@click.option("--out", type=PathParameter(file_okay=False), required=True, help="Folder to write to.")
def leaderboard(files: tuple[Path, ...], out: Path) -> None:
    """Rank the models of bundles of one kind: a static page, index.html, with its tables (csv, LaTeX).

    Success is corrected by that of the oracle, if there is its bundle with the same episodes. Executable shares have
    a lower and an upper bound; models are compared by paired tests.
    """
    from kinebench_drake.report.leaderboard import write_leaderboard
    from kinebench_drake.runs.benchmark_registry import load_benchmark

    echo(write_leaderboard(files, out, load_benchmark().rank))
