"""Leaderboard of bundles: a page and its tables."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from kinebench_drake.errors import UsageError
from kinebench_drake.io.archive import hash_file
from kinebench_drake.report.number import ALL_TASKS, HEADLINES, NumberComparison, tabulate_numbers
from kinebench_drake.report.page import choose_gallery
from kinebench_drake.report.page_parts import Part, make_missing, write_parts
from kinebench_drake.report.run import Run, check_page_folder, read_runs
from kinebench_drake.report.sample import badness, embed_thumbnail
from kinebench_drake.report.sample_comparison import compare_samples, label_samples, tabulate_samples
from kinebench_drake.report.table import Table, Value, make_table
from kinebench_drake.results.aggregate import Estimate, estimate, estimate_executable, group_by
from kinebench_drake.results.bundle import open_bundle
from kinebench_drake.results.row import SampleRow, Status

PAGE = "index.html"
_IN_GALLERY = 3
"""Worst and best samples of a run that are shown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelEntry:
    """One model on one part of the suites, or on the samples of runs without suites."""

    part: str
    """Name of the part; empty without suites."""
    model: str
    runs: Sequence[Run]
    """Runs that have its rows."""
    rows: Sequence[SampleRow]
    corrected: Estimate | None = None
    """Success over that of the oracle in the shared episodes; None without an oracle."""
    ceiling: float | None = None
    """Success of the oracle in them."""

    @property
    def shares(self) -> dict[str, Estimate]:
        """Shares that were judged: success (unmeasured episodes are failures), executable, feasible."""
        rows = self.rows
        shares = dict[str, Estimate]()
        options: dict[str, Any] = {"total": len(rows), "episodes": [row.episode for row in rows]}
        if any(row.has("success") for row in rows):
            hits = [row.status is Status.OK and row.success is True for row in rows]
            shares["success"] = estimate(hits, **options)
        if any(row.executable is not None for row in rows):
            shares["executable"] = estimate_executable(rows)
        feasible = estimate([row.feasible if row.status is Status.OK else None for row in rows], **options)
        return {**shares, "feasible": feasible} if feasible.n else shares

    @property
    def rank(self) -> tuple[float, ...]:
        """Sort key, the best first."""
        success, executable = (self.shares.get(name) for name in ("success", "executable"))
        means = (self.corrected or success, success, executable)
        return tuple(1.0 if share is None or share.mean is None else -share.mean for share in means)

    @property
    def planned(self) -> int | None:
        """Samples of the inputs; None if unknown, or of several models."""
        counts = [run.planned if len({row.model for row in run.rows}) == 1 else None for run in self.runs]
        return None if None in counts else sum(n or 0 for n in counts)


Ranking: TypeAlias = tuple[Sequence[ModelEntry], Sequence[Part], Table]
"""Models, further tables, and the listing of all samples."""


def write_leaderboard(bundles: Sequence[Path], out: Path, rank_suites: Callable[[Sequence[Path]], Ranking]) -> Path:
    """Write the leaderboard of bundles of one kind; the same bundles give the same bytes.

    Args:
        rank_suites: returns the ranking of output folders of suite runs.

    Returns:
        The page.

    Raises:
        UsageError: two bundles have one name or are of different kinds.
    """
    check_page_folder(out)
    if double := [path for k, path in enumerate(bundles) if path.stem in [other.stem for other in bundles[:k]]]:
        raise UsageError(f"{double[0]}: two bundles have this name; give them names of their own")
    with ExitStack() as stack:
        folders = [stack.enter_context(open_bundle(path)).folder for path in bundles]
        runs = read_runs(folders)
        if kinds := {run.kind for run in runs} - {runs[0].kind}:
            raise UsageError(f"bundles of kind {runs[0].kind} and {min(kinds)}: one leaderboard has one kind")
        entries, parts, listing = rank_suites(folders) if runs[0].kind == "suite" else _rank_samples(runs)
        ranked = sorted(entries, key=lambda entry: (entry.part, entry.rank))
        return write_parts(
            "leaderboard.html.j2",
            "Leaderboard",
            out,
            [_tabulate(ranked), *parts],
            listing,
            page=PAGE,
            bundles=[(path.name, hash_file(path), run) for path, run in zip(bundles, runs, strict=True)],
            gallery=[(run, title, rows) for run in runs for title, rows in _gallery(run)],
        )


def _rank_samples(runs: Sequence[Run]) -> Ranking:
    """Return the ranking of runs without episodes."""
    samples = label_samples(runs)
    entries = [
        ModelEntry(
            part="",
            model=model,
            runs=list({sample.run.path: sample.run for sample in own}.values()),
            rows=[sample.row for sample in own],
        )
        for model, own in group_by(samples, lambda sample: sample.model).items()
    ]
    _, comparison = tabulate_headlines(lambda: compare_samples(runs).numbers)
    return entries, [comparison], tabulate_samples(samples)


def tabulate_headlines(
    numbers: Callable[[], Sequence[NumberComparison]],
) -> tuple[list[NumberComparison], Part]:
    """Return the headline numbers over all tasks, and their table without the columns that are for single tasks."""
    try:
        chosen = [n for n in numbers() if n.task == ALL_TASKS and n.metric.name in HEADLINES]
    except UsageError:  # one model, or none that share a sample
        return [], make_missing("pairs")
    table = tabulate_numbers(chosen)
    keys = [column.key for column in table.columns if column.key not in ("task", "metric")]
    return chosen, table.select(keys, range(len(table.rows)))


def _tabulate(entries: Sequence[ModelEntry]) -> Table:
    def cells(entry: ModelEntry) -> dict[str, Value]:
        shares = entry.shares
        n = len(entry.rows)
        optional = {"part": entry.part or None, "corrected": entry.corrected, "ceiling": entry.ceiling, **shares}
        if "executable" in shares:
            optional["executable_most"] = shares["executable"].upper
        measured = sum(row.status is Status.OK for row in entry.rows)
        present = {name: value for name, value in optional.items() if value is not None}
        return {**present, "model": entry.model, "coverage": measured / n, "samples": n, "planned": entry.planned}

    return make_table("leaderboard", map(cells, entries))


def _gallery(run: Run) -> list[tuple[str, list[tuple[SampleRow, str]]]]:
    """Return the worst and the best samples of a run with their images."""
    worst, best = choose_gallery(run.path, sorted(run.rows, key=badness), _IN_GALLERY)
    groups = (("worst", worst), ("best", best))
    return [(title, [(row, embed_thumbnail(run.path, row)) for row in rows]) for title, rows in groups if rows]
