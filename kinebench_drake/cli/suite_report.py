"""`kinebench-drake suite report`."""

from pathlib import Path

import click


@click.command(
    short_help="Report on suite runs.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite report runs/wan-suite0/ runs/wan-suite2/ --out report/\n"
    "  kinebench-drake suite report scaling/*/ --out report/",
)
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder to write to.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the intervals' resampling.")
def report(folders: tuple[Path, ...], out: Path, seed: int) -> None:
    """Put output folders DIR of `suite run` together: report.html, figures (png, svg), tables (csv, LaTeX).

    Runs of one model on one suite are one run, as shards are, unless their tags or settings differ.
    """
    from kinebench_drake.suite_report import write_suite_report

    click.echo(write_suite_report(folders, out, seed))
