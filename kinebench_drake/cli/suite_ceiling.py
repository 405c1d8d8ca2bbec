"""`kinebench-drake suite ceiling`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from kinebench_drake.cli.suite_options import jobs_option

if TYPE_CHECKING:
    from kinebench_drake.suites.closedloop.tolerance import Attempt


@click.command(
    short_help="Hold runs against direct execution of the expert's track.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite run --suite 0 --world-model oracle --pixels-only --episodes 20 --out pixels/ --jobs 2\n"
    "  kinebench-drake suite ceiling pixels/ --out ceiling/ --jobs 2",
)
@click.argument("folders", metavar="DIR...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Write report.html, figure and table (csv, LaTeX) to this folder, too.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the intervals' resampling.")
@jobs_option
def ceiling(folders: tuple[Path, ...], out: Path | None, seed: int, jobs: int) -> None:
    """Execute the expert's own true track in the episodes of suite runs DIR, and compare each model with it.

    No model succeeds more often, but by chance: what is missing was lost between the imagined and the executed motion.
    For a run of the oracle that is the cost of grounding; for other models that of their videos, too.
    """
    from kinebench_drake.cli.progress import EpisodeView
    from kinebench_drake.cli.run import terminate_as_interrupt
    from kinebench_drake.engines import EngineKind, create_engine
    from kinebench_drake.suite_report import write_comparison
    from kinebench_drake.suite_report.ceiling import read_ceiling, share_lines
    from kinebench_drake.suite_report.comparison import comparison_lines

    with EpisodeView() as view, terminate_as_interrupt():

        def told(attempt: "Attempt", total: int) -> None:
            if not view.total:
                view.started(total, 0)
            view.advanced(attempt.episode.id if attempt.success else f"{attempt.episode.id}: {attempt.reason}")

        comparison = read_ceiling(folders, create_engine(EngineKind.LOCAL, jobs), seed, told=told)
    page = None if out is None else write_comparison(comparison, out)
    for line in (*comparison_lines(comparison.table), "", *share_lines(comparison.compared)):
        click.echo(line)
    if page is not None:
        click.echo(page)
