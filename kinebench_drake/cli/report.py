"""`kinebench-drake report` and `kinebench-drake compare`."""

from pathlib import Path

import click

from kinebench_drake.errors import InputError, UsageError


@click.command(epilog="\b\nExamples:\n  kinebench-drake report results/\n  kinebench-drake report results/ --figures")
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--figures", is_flag=True, help="Also write figures (png, svg) and tables (csv) to DIR/figures/.")
def report(folders: tuple[Path, ...], figures: bool) -> None:
    """Write report.html in each output folder DIR again, from its rows and tracks."""
    from kinebench_drake.report.page import write_report
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
    help="Also write report.html, figure and table (csv, LaTeX) to this folder.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the bootstrap intervals.")
def compare(folders: tuple[Path, ...], out: Path | None, seed: int) -> None:
    """Compare models of suite runs DIR, two by two, on the episodes that both did.

    Success with Newcombe's 95 % interval and McNemar's exact test, progress with a bootstrap interval; for all tasks
    together, then for each task.
    """
    from kinebench_drake.report.suite.comparison import comparison_lines, read_comparison
    from kinebench_drake.report.suite.suite_page import write_comparison

    comparison = read_comparison(folders, seed)
    page = None if out is None else write_comparison(comparison, out)
    for line in comparison_lines(comparison.table):
        click.echo(line)
    if page is not None:
        click.echo(page)
