"""`kinebench-drake report` and `kinebench-drake compare`."""

from pathlib import Path

import click

from kinebench_drake.errors import InputError, UsageError


@click.command(epilog="\b\nExamples:\n  kinebench-drake report results/\n  kinebench-drake report results/ --figures")
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--figures", is_flag=True, help="Write figures (png, svg) and tables (csv) to DIR/figures/, too.")
def report(folders: tuple[Path, ...], figures: bool) -> None:
    """Write report.html anew in each output folder DIR, from the rows and tracks it holds."""
    from kinebench_drake.report import write_report
    from kinebench_drake.results.store import SAMPLES

    for folder in folders:
        if not (folder / SAMPLES).is_file():
            raise UsageError(f"{folder}: holds no {SAMPLES}, expected the output folder of a run")
        try:
            click.echo(write_report(folder))
            if figures:
                from kinebench_drake.report.figures import write_figures

                click.echo(write_figures(folder))
        except InputError as error:
            raise UsageError(str(error)) from None


@click.command(
    epilog="\b\nExamples:\n"
    "  kinebench-drake compare runs/wan/ runs/cogvideox/\n"
    "  kinebench-drake compare runs/*/ --out comparison/"
)
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Write report.html, figure and table (csv, LaTeX) to this folder, too.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the intervals' resampling.")
def compare(folders: tuple[Path, ...], out: Path | None, seed: int) -> None:
    """Compare models of suite runs DIR, two by two, on the episodes that both did.

    Success with Newcombe's 95 % interval and McNemar's exact test, progress with a bootstrap interval; all tasks
    together, then each.
    """
    from kinebench_drake.report.suite import read_comparison, write_comparison
    from kinebench_drake.report.suite.comparison import comparison_lines

    comparison = read_comparison(folders, seed)
    page = None if out is None else write_comparison(comparison, out)
    for line in comparison_lines(comparison.table):
        click.echo(line)
    if page is not None:
        click.echo(page)
