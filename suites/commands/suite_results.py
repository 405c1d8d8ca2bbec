"""`kinebench-drake suite report`, `ceiling` and `tolerance`."""

import json
from pathlib import Path

import click

from kinebench_drake.cli.click_options import PathParameter, check_parent, config_options, echo
from kinebench_drake.cli.outputs import comparison_out_option, folders_argument
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.suites.runs.suite_config import SuiteConfig


@click.command(
    short_help="Compare runs with direct execution of the expert's track.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite run --suite 0 --world-model oracle --pixels-only --episodes 20 --out pixels/ --jobs 2\n"
    "  kinebench-drake suite ceiling pixels/ --out ceiling/ --jobs 2",
)
@folders_argument
@comparison_out_option
@config_options(SuiteConfig, "jobs")
def ceiling(folders: tuple[Path, ...], out: Path | None, jobs: int) -> None:
    """Execute the expert's own true track in the episodes of suite runs DIR, and compare each model with it.

    No model succeeds more often, except by chance: the difference was lost between the generated and the executed
    motion. For a run of the oracle that is the cost of grounding; for other models their videos add to it.
    """
    from kinebench_drake.cli.progress import ProgressView, terminate_as_interrupt
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.report.number import number_lines
    from kinebench_drake.report.run import check_page_folder
    from kinebench_drake.suites.closed_loop.tolerance import run_attempts
    from kinebench_drake.suites.report.comparison import ceiling_lines, read_ceiling
    from kinebench_drake.suites.report.suite_page import write_comparison

    if out is not None:
        check_page_folder(out)
    executor = create_executor(ExecutorKind.LOCAL, jobs)
    with ProgressView() as view, terminate_as_interrupt():
        comparison = read_ceiling(folders, lambda episodes: run_attempts(executor, episodes, (), view))
    page = None if out is None else write_comparison(comparison, out)
    for line in (*ceiling_lines(comparison.numbers), "", *number_lines(comparison.numbers)):
        echo(line)
    if page is not None:
        echo(page)


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


@click.command(
    short_help="Measure the success of tasks under track errors.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite tolerance --suite 0 --episodes 10 --out tolerance.json --jobs 2\n"
    "  kinebench-drake suite tolerance --suite 0 --tasks StackCube-v1 --out stack.json",
)
@config_options(SuiteConfig, "suite", "split", "tasks", "episodes", "seed")
@click.option("--out", type=PathParameter(dir_okay=False), required=True, help="Output file of all attempts, JSON.")
@config_options(SuiteConfig, "jobs")
def tolerance(
    suite: int,
    split: str,
    tasks: str | None,
    episodes: int,
    seed: int,
    out: Path,
    jobs: int,
) -> None:
    """Execute the expert's true track, exact and with errors of graded size: success against error, task by task.

    The exact track has the success of a perfect video with perfect grounding. Poses have a constant displacement (bias)
    or independent ones per frame (jitter), with proportional rotations (5 degrees with 15 mm), or the fingers are
    delayed by some frames (finger_delay).
    """
    from kinebench_drake.cli.progress import ProgressView, terminate_as_interrupt
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.suites.catalog import chosen_tasks, load_suite
    from kinebench_drake.suites.closed_loop.tolerance import PoseError, run_attempts, table_json, table_lines
    from kinebench_drake.suites.families.task import TaskVariant

    check_parent("--out", out)
    loaded = load_suite(suite)
    chosen = chosen_tasks(loaded, split, tasks, TaskVariant.PLAIN)
    specs = loaded.specs(loaded.split_name(split), episodes, tasks=chosen, offset=seed)
    with ProgressView() as view, terminate_as_interrupt():
        todo = [spec.episode() for spec in specs]
        attempts = run_attempts(create_executor(ExecutorKind.LOCAL, jobs), todo, [*PoseError], view)
    write_atomically(out, (json.dumps(table_json(attempts), indent=1) + "\n").encode())
    for line in table_lines(attempts):
        echo(line)
