"""Carrying out a run from the command line."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from kinebench_drake.cli.progress import ProgressView
from kinebench_drake.row import Status
from kinebench_drake.run import Observer, RunSummary


def run(job: Callable[[Observer], RunSummary], out: Path, view: ProgressView | None = None) -> int:
    """Work through a run that fills the folder `out`, with progress shown; returns the exit status."""
    view = view or ProgressView()
    try:
        with view, terminate_as_interrupt():
            summary = job(view)
    except KeyboardInterrupt:
        told = f"with {view.done} of {view.total} samples finished" if view.total else "before any sample was begun"
        click.echo(f"interrupted {told}; run the same command again, without --overwrite, to go on", err=True)
        return 130
    _tell(out, summary)
    return 0 if summary.counts[Status.OK] else 1


def _tell(out: Path, summary: RunSummary) -> None:
    counted = ", ".join(f"{n} {status.value}" for status, n in summary.counts.items() if n)
    if not any(summary.counts.values()):
        click.echo("there was nothing to do: this shard holds no sample", err=True)
    elif not summary.counts[Status.OK]:
        click.echo(f"nothing could be measured ({counted}); {out / 'samples.jsonl'} has the reasons", err=True)
    else:
        click.echo(counted)
    for share, told in (
        (summary.success, "episodes reach their goal"),
        (summary.feasible, "judged samples are feasible"),
    ):
        if share is not None and share.mean is not None:
            click.echo(f"{share.mean:.0%} of {share.n} {told} (95% interval {share.low:.0%} to {share.high:.0%})")
    click.echo(summary.report or out / "results.json")


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Within this context a request to terminate ends the run as an interrupt does: rows kept, workers gone."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
