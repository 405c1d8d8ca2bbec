"""Running a job from the command line: progress, interrupts, closing lines."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from kinebench_drake.errors import one_line
from kinebench_drake.evaluation.runner import Observer, RunSummary
from kinebench_drake.results.row import SampleRow, Status

_STYLES = {Status.OK: "green", Status.UNMEASURABLE: "yellow", Status.ERROR: "red"}


class _View:
    """A bar on a terminal, or nothing, and lines above it. Use as a context."""

    def __init__(self, what: str) -> None:
        self.total = 0
        """Things to be done in all."""
        self.done = 0
        """Things done, those kept from before included."""
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._task = self._bar.add_task(what, total=None)

    def __enter__(self) -> Self:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar:
            self._bar.stop()

    def _begin(self, total: int, kept: int, what: str) -> None:
        self.total, self.done = total, kept
        if kept:
            self._say(Text(f"{kept} of {total} {what} are finished already and kept"))
        if self._bar:
            self._bar.update(self._task, total=total, completed=kept)

    def _advance(self) -> None:
        self.done += 1
        if self._bar:
            self._bar.update(self._task, completed=self.done)

    def _say(self, text: Text) -> None:
        if self._bar:
            self._bar.console.print(text, soft_wrap=True)
        else:
            click.echo(text.plain, err=True)


class ProgressView(_View):
    """An observer of runs that writes to standard error. Use as a context."""

    def __init__(self) -> None:
        super().__init__("samples")

    def warned(self, message: str) -> None:
        """Tell a warning."""
        self._say(Text(one_line(f"warning: {message}"), style="yellow"))

    def started(self, total: int, kept: int) -> None:
        """Begin to count."""
        self._begin(total, kept, "samples")

    def finished(self, row: SampleRow, wall_s: float) -> None:
        """Tell of a sample; on a terminal only of those that failed."""
        self._advance()
        reason = f": {row.reason}" if row.reason else ""
        if self._bar is None or row.status is not Status.OK:
            line = f"[{self.done}/{self.total}] {row.id} {row.status.value}{reason} ({wall_s:.1f} s)"
            self._say(Text(one_line(line), style=_STYLES[row.status]))


class EpisodeView(_View):
    """A watcher of work on episodes that writes to standard error. Use as a context."""

    def __init__(self, what: str = "episodes") -> None:
        super().__init__(what)
        self._what = what

    def started(self, total: int, kept: int) -> None:
        """Begin to count."""
        self._begin(total, kept, self._what)

    def advanced(self, line: str, *, good: bool = True) -> None:
        """Tell of an episode; on a terminal only of those that failed, which do not count."""
        if good:
            self._advance()
        if self._bar is None or not good:
            self._say(Text(f"[{self.done}/{self.total}] {line}", style="" if good else "yellow"))


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
