"""`kinebench-drake report`."""

from pathlib import Path

import click

from kinebench_drake.errors import InputError, UsageError


@click.command(epilog="\b\nExamples:\n  kinebench-drake report results/\n  kinebench-drake report results/ --figures")
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--figures", is_flag=True, help="Write figures (png, svg) and tables (csv) to DIR/figures/, too.")
def report(folders: tuple[Path, ...], figures: bool) -> None:
    """Write report.html anew in each output folder DIR, from the rows and tracks it holds."""
    from kinebench_drake.report import write_report
    from kinebench_drake.results import SAMPLES

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
