"""`kinebench-drake suite tolerance`."""

import json
from pathlib import Path

import click

from kinebench_drake.cli.suite_options import (
    SPLITS,
    SUITES,
    check_parent,
    episodes_option,
    jobs_option,
    split_help,
    tasks_option,
)
from kinebench_drake.storage import write_atomically
from kinebench_drake.suites.selection import chosen_tasks

_ERRORS = ("bias", "jitter", "finger_delay")


@click.command(
    short_help="Measure how much error in a track each task forgives.",
    epilog="\b\nExamples:\n"
    "  kinebench-drake suite tolerance --suite 0 --episodes 10 --out tolerance.json --figure tolerance.png --jobs 2\n"
    "  kinebench-drake suite tolerance --suite 0 --tasks StackCube-v1 --errors bias --out stack.json",
)
@click.option("--suite", "number", type=SUITES, required=True, help="Number of the suite.", metavar="N")
@click.option("--split", type=SPLITS, default="test", show_default=True, help=split_help)
@tasks_option
@episodes_option
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Number of the first of the split's seeds."
)
@click.option("--errors", default=",".join(_ERRORS), show_default=True, help="Which ones to plant.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="Figures, as JSON.")
@click.option("--figure", type=click.Path(path_type=Path, dir_okay=False), help="Draw the curves (png, svg, pdf).")
@jobs_option
def tolerance(
    number: int,
    split: str,
    tasks: str | None,
    episodes: int,
    seed: int,
    errors: str,
    out: Path,
    figure: Path | None,
    jobs: int,
) -> None:
    """Execute the expert's own true track, exact and with errors of graded size: success against error, task by task.

    The exact track's success is what a perfect video with perfect grounding would reach. Poses are off by a constant
    displacement (bias) or by one of their own each frame (jitter), rotations in proportion (5 degrees with 15 mm), or
    the fingers move so many frames late (finger_delay).
    """
    from kinebench_drake.cli.progress import EpisodeView
    from kinebench_drake.cli.run import terminate_as_interrupt
    from kinebench_drake.engines import EngineKind, create_engine
    from kinebench_drake.errors import UsageError
    from kinebench_drake.suites.closedloop.tolerance import Attempt, Error, run_attempts
    from kinebench_drake.suites.closedloop.tolerance_table import table_json, table_lines
    from kinebench_drake.suites.suite import load_suite
    from kinebench_drake.suites.tasks.card import Variant

    names = errors.split(",")
    if unknown := [name for name in names if name not in _ERRORS]:
        raise UsageError(f"--errors {errors}: no {unknown[0]!r}; there are {', '.join(_ERRORS)}")
    for option, path in (("--out", out), ("--figure", figure)):
        if path is not None:
            check_parent(option, path)
    suite = load_suite(number)
    chosen = chosen_tasks(suite, split, tasks, Variant.PLAIN)
    order = suite.episodes(suite.split_name(split), episodes, tasks=chosen, offset=seed)
    attempts: list[Attempt] = []
    with EpisodeView() as view, terminate_as_interrupt():
        view.started(len(order), 0)
        for done in run_attempts(create_engine(EngineKind.LOCAL, jobs), order, [Error(name) for name in names]):
            attempts += done
            view.advanced(done[0].episode.id)
    attempts.sort(key=lambda a: a.episode.id)
    write_atomically(out, (json.dumps(table_json(attempts), indent=1) + "\n").encode())
    for line in table_lines(attempts):
        click.echo(line)
    if figure is not None:
        from kinebench_drake.drawing import save
        from kinebench_drake.suites.closedloop.tolerance_figure import draw_tolerance

        save(draw_tolerance(attempts), figure)
