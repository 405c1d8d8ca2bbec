"""Running a job from the command line: progress, interrupts, closing lines."""

import re
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from kinebench_drake.anomaly import Anomaly
from kinebench_drake.cli.click_options import echo
from kinebench_drake.errors import count_noun, name_options, one_line
from kinebench_drake.executors.interrupt import ignore_interrupts
from kinebench_drake.metrics.executable import UNCHECKED, FailureVerdict, reason_kind
from kinebench_drake.metrics.trust import trust_lines
from kinebench_drake.report.verdict import describe_trust, describe_verdict, follow_lines
from kinebench_drake.results.aggregate import estimate, estimate_executable, estimate_passes
from kinebench_drake.results.drops import DROPS
from kinebench_drake.results.inputs import input_lines
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import REQUESTS
from kinebench_drake.runs.gate import passes
from kinebench_drake.runs.runner import RunObserver, RunSummary
from kinebench_drake.violation import Violation

_MOST_REASONS = 5  # in a closing line
_STYLES = {Status.OK: "green", Status.UNMEASURABLE: "yellow", Status.ERROR: "red"}


class ProgressView:
    """Observer that shows a progress bar on a terminal and log lines elsewhere, on standard error. Use as a context."""

    def __init__(self, unit: str = "episodes") -> None:
        """Prepare the display."""
        self.total = 0
        """Items in all."""
        self.completed = 0
        """Items completed, by this run or an earlier one."""
        self._unit = unit
        self._bar: Progress | None = None
        if sys.stderr.isatty():
            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
            )
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._task = self._bar.add_task(unit, total=None)

    def __enter__(self) -> Self:
        if self._bar:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar:
            self._bar.stop()

    def warn(self, message: str) -> None:
        """Print a warning."""
        self._print(f"warning: {message}", "yellow")

    def start(self, total: int, completed: int) -> None:
        """Set the length of the bar."""
        self.total = total
        self.completed = completed
        if completed:
            self._print(f"{completed} of {total} {self._unit} are finished already and kept")
        if self._bar:
            self._bar.update(self._task, total=total, completed=completed)

    def advance(self, line: str, *, ok: bool = True) -> None:
        """Count and print an item; on a terminal only print those that are not ok, which never count."""
        if ok:
            self._count()
        if self._bar is None or not ok:
            self._print(f"[{self.completed}/{self.total}] {line}", "" if ok else "yellow")

    def detail(self, line: str) -> None:
        """Show progress within a sample: on a terminal beside the bar, until the next line comes."""
        if self._bar:
            self._bar.update(self._task, description=f"{self._unit} ({one_line(line)})")
        else:
            self._print(f"[{self.completed}/{self.total}] {line}")

    def finish(self, row: SampleRow, wall_s: float) -> None:
        """Count and print a sample; on a terminal only print those that failed."""
        self._count()
        if self._bar is None or row.status is not Status.OK:
            trust = describe_trust(row)
            verdict = describe_verdict(row) + (f"; trust: {trust}" if trust else "")
            line = f"[{self.completed}/{self.total}] {row.id} {verdict} ({wall_s:.1f} s)"
            self._print(line, _STYLES[row.status])

    def _count(self) -> None:
        self.completed += 1
        if self._bar:
            self._bar.update(self._task, completed=self.completed, description=self._unit)

    def _print(self, line: str, style: str = "") -> None:
        text = Text(one_line(name_options(line)), style=style)
        if self._bar:
            self._bar.console.print(text, soft_wrap=True)
        else:
            echo(text.plain, err=True)


def run(job: Callable[[RunObserver], RunSummary], out: Path, view: ProgressView | None = None) -> int:
    """Execute a run that fills the folder `out`, showing its progress; return the exit status."""
    view = view or ProgressView("samples")
    try:
        with view, terminate_as_interrupt():
            summary = job(view)
    except KeyboardInterrupt:
        ignore_interrupts()
        progress = (
            f"with {view.completed} of {view.total} samples finished" if view.total else "before any sample was begun"
        )
        echo(f"interrupted {progress}; run the same command again, without --overwrite, to go on", err=True)
        return 130
    _print_summary(out, summary)
    for line in summary.missed:
        echo(f"bound missed: {line}", err=True)
    return 0 if passes(summary) else 1


def _print_summary(out: Path, summary: RunSummary) -> None:
    counts = ", ".join(f"{n} {status.value}" for status, n in summary.counts.items() if n)
    if not any(summary.counts.values()):
        echo("there was nothing to do: this shard holds no sample", err=True)
    elif not summary.counts[Status.OK] and not summary.pending:
        echo(f"nothing could be measured ({counts}); {out / 'samples.jsonl'} has the reasons", err=True)
    for line in summary_lines(summary.rows) if summary.rows else ():
        echo(line)
    if summary.drops:
        reasons = Counter(drop.reason.key for drop in summary.drops)
        dropped = count_noun(len({drop.id for drop in summary.drops}), "sample")
        echo(f"drop list: {dropped} ({', '.join(f'{n} {reason}' for reason, n in reasons.items())}): {out / DROPS}")
    if count := len(summary.pending):
        echo(
            f"next round of {count_noun(count, 'episode')}: generate the videos of "
            f"{out / REQUESTS / 'manifest.jsonl'}, put them to the others and run the same command again (or with "
            "fewer --rounds)"
        )
    echo(summary.report or out / "results.json")


def summary_lines(rows: Sequence[SampleRow]) -> Iterator[str]:
    """Describe a run's rows: verdicts, faults, what could not be measured, frame period and camera, a line each."""
    verdicts = [line for name in ("follows", "success", "executable", "feasible") if (line := _share(name, rows))]
    if verdicts:
        yield "; ".join(verdicts)
    yield from follow_lines(rows)
    if passes := estimate_passes(rows):
        yield "; ".join(
            f"pass@{k}: {share.mean:.0%} of {count_noun(share.n, 'episode')} (95% interval {share.low:.0%} to "
            f"{share.high:.0%})"
            for k, share in passes.items()
            if share.mean is not None
        )
    if causes := Counter(row.verdict for row in rows if row.success is False):
        n = causes.total()
        shares = (f"{cause.value} {causes[cause.value] / n:.0%} ({causes[cause.value]})" for cause in FailureVerdict)
        undecided = f", undecided {causes[None] / n:.0%} ({causes[None]})" if causes[None] else ""
        yield f"attribution of {count_noun(n, 'failure')}: {', '.join(shares)}{undecided}"
    is_video = any("anomalies" in row.metrics for row in rows)
    faults = [f"anomalies: {_count_samples(row.anomalies for row in rows)}"] if is_video else []
    if any(row.violations for row in rows) or not faults:
        faults.append(f"violated limits: {_count_samples(row.violations for row in rows)}")
    open_ = Counter(r for row in rows for r in row.executable_reasons if reason_kind(r) == UNCHECKED)
    faults += [
        f"{reason} limits, in {count_noun(n, 'sample')}: feasible as far as checked" for reason, n in open_.items()
    ]
    yield "; ".join(faults)
    yield "; ".join(
        f"{name}: {len(reasons)} of {count_noun(len(rows), 'sample')}{_list_reasons(reasons)}"
        for name, reasons in _open_rows(rows).items()
        if reasons or name == Status.UNMEASURABLE.value
    )
    yield from input_lines(rows)
    yield from trust_lines(rows)


def _open_rows(rows: Sequence[SampleRow]) -> dict[str, list[str]]:
    """Return the reasons of the rows that are undecided, unmeasurable or broken, by these words."""
    return {
        "feasible undecided": [
            reason for row in rows if row.status is Status.OK and (reason := row.null_reasons.get("feasible"))
        ],
        **{
            status.value: [row.reason or "no reason stored" for row in rows if row.status is status]
            for status in (Status.UNMEASURABLE, Status.ERROR)
        },
    }


def _share(name: str, rows: Sequence[SampleRow]) -> str:
    """Describe the share of a truth value; empty if no row has it. Open verdicts on execution count as no."""
    if name == "executable":
        share = estimate_executable(rows)
        n = len(rows)
        if share.low is None or all(row.executable is None for row in rows):
            return ""
        hits, open_ = (sum(row.executable is verdict for row in rows) for verdict in (True, None))
        upper = f"; at most {share.upper:.0%}, {open_} undecided" if open_ else ""
        interval = f"95% interval {share.low:.0%} to {share.high:.0%}"
        return f"executable: {hits} of {count_noun(n, 'sample')}, {share.mean:.0%} ({interval}{upper})"
    verdicts = [(row.value(name), row.episode) for row in rows if row.status is Status.OK]
    judged = [(value, episode) for value, episode in verdicts if isinstance(value, bool)]
    share = estimate([v for v, _ in judged], total=len(rows), episodes=[episode for _, episode in judged])
    if share.mean is None or share.low is None or share.high is None:
        return ""
    hits = sum(value is True for value, _ in judged)
    missing = share.total - share.n
    bound = f"; at least {hits / share.total:.0%} of all {share.total}" if missing else ""
    counted = count_noun(share.n, "judged sample" if missing else "sample")
    return f"{name}: {hits} of {counted}, {share.mean:.0%} (95% interval {share.low:.0%} to {share.high:.0%}{bound})"


def _count_samples(faults: Iterable[Sequence[Violation | Anomaly]]) -> str:
    """Count the samples with each kind of fault, the most frequent first."""
    kinds = Counter(kind for own in faults for kind in {fault.kind.value for fault in own})
    ranked = sorted(kinds.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{kind} in {count_noun(n, 'sample')}" for kind, n in ranked) or "none"


def _list_reasons(reasons: Sequence[str]) -> str:
    """Return the most frequent reasons with their counts; those that differ in numbers alone are counted together."""
    kinds = [re.sub(r"[0-9.]+", "#", reason) for reason in reasons]
    ranked = Counter(kinds).most_common()
    if len(ranked) == 1:
        return f": {one_line(reasons[0])}"
    texts = [f"{n} x {one_line(reasons[kinds.index(kind)])}" for kind, n in ranked[:_MOST_REASONS]]
    more = [f"{len(ranked) - _MOST_REASONS} more reasons"] if len(ranked) > _MOST_REASONS else []
    return f" ({'; '.join(texts + more)})" if texts else ""


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Return a context in which SIGTERM ends the run as an interrupt does: rows kept, workers ended."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
