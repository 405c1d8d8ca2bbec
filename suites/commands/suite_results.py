"""`kinebench-drake suite report`."""

from pathlib import Path

import click

from kinebench_drake.cli.click_options import PathParameter, echo
from kinebench_drake.cli.outputs import folders_argument


@click.command(
    short_help="Report on suite runs.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite report runs/wan-suite0/ runs/wan-suite2/ --out report/\n"
    "  kinebench-drake suite report scaling/*/ --out report/",
)
@folders_argument
@click.option(
    "--paper",
    is_flag=True,
    help="Only what the KineBench paper shows: success and kinematics by suite and model, their correlation, the loss "
    "from seen to unseen, scaling.",
)
@click.option("--out", type=PathParameter(file_okay=False), required=True, help="Folder to write to.")
def report(folders: tuple[Path, ...], out: Path, paper: bool) -> None:
    """Report on output folders DIR of `suite run`: report.html, figures (png, svg), tables (csv, LaTeX).

    Folders of one model on one suite are pooled, such as shards, unless their tags or settings differ.
    """
    from kinebench_drake.suites.report.suite_page import write_suite_report

    echo(write_suite_report(folders, out, warn=lambda message: echo(f"warning: {message}", err=True), paper=paper))
