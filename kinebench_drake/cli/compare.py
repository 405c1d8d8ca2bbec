"""`kinebench-drake compare`."""

from pathlib import Path

import click


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
    from kinebench_drake.suite_report import read_comparison, write_comparison
    from kinebench_drake.suite_report.comparison import comparison_lines

    comparison = read_comparison(folders, seed)
    page = None if out is None else write_comparison(comparison, out)
    for line in comparison_lines(comparison.table):
        click.echo(line)
    if page is not None:
        click.echo(page)
