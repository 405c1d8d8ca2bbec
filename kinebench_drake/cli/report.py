"""`kinebench-drake report`."""

from pathlib import Path

import click

from kinebench_drake.errors import InputError, UsageError


@click.command(epilog="\b\nExample:\n  kinebench-drake report results/")
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
def report(folders: tuple[Path, ...]) -> None:
    """Write report.html anew in each output folder DIR, from the rows and tracks it holds."""
    from kinebench_drake.report import write_report

    for folder in folders:
        if not (folder / "samples.jsonl").is_file():
            raise UsageError(f"{folder}: holds no samples.jsonl, expected the output folder of a run")
        try:
            click.echo(write_report(folder))
        except InputError as error:
            raise UsageError(str(error)) from None
