"""Comparison of the models of score, audit and ground runs: numbers on shared samples, as text, page and files."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.errors import UsageError
from kinebench_drake.report.number import (
    NUMBERS,
    NumberComparison,
    compare_numbers,
    draw_numbers,
    number_lines,
    tabulate_numbers,
    value_of,
)
from kinebench_drake.report.pairing import ModelPair, ModelSample, label_samples, list_differences, pair_models
from kinebench_drake.report.parts import MissingPart, Part, choose_listed, list_links, write_parts
from kinebench_drake.report.run import Run, check_page_folder
from kinebench_drake.report.sample import GOOD_VERDICTS, verdict_of
from kinebench_drake.report.table import Column, Table


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleComparison:
    """Comparison of all pairs of models of some runs."""

    runs: Sequence[Run]
    samples: Sequence[ModelSample]
    pairs: Sequence[ModelPair]
    numbers: Sequence[NumberComparison]
    warnings: Sequence[str]
    """What else differs between paired samples, a line each."""


def compare_samples(runs: Sequence[Run], seed: int = 0) -> SampleComparison:
    """Compare the models of runs of one kind, two by two, on the samples that they share.

    Raises:
        UsageError: the runs are of different kinds, or no two models share a sample.
    """
    for run in runs[1:]:
        if run.kind != runs[0].kind:
            raise UsageError(
                f"{runs[0].path} is of a run of kind {runs[0].kind!r} and {run.path} of {run.kind!r}: compare runs of "
                "one kind"
            )
    samples = label_samples(runs)
    pairs = pair_models(samples)
    numbers = [
        c
        for pair in pairs
        for c in compare_numbers([((a,), (b,)) for a, b in pair.pairs], pair.first, pair.second, seed=seed)
    ]
    return SampleComparison(
        runs=runs, samples=samples, pairs=pairs, numbers=numbers, warnings=list(list_differences(pairs, runs))
    )


def sample_comparison_lines(comparison: SampleComparison) -> Iterator[str]:
    """Format a comparison for a terminal: how the samples are paired, then the numbers of all tasks together."""
    for pair in comparison.pairs:
        yield pair.title
    yield ""
    yield from number_lines(comparison.numbers)


def write_sample_comparison(comparison: SampleComparison, out: Path) -> Path:
    """Write a comparison: page, figure and tables; returns the page.

    Raises:
        UsageError: `out` is the folder of a run.
        SetupError: writing failed.
    """
    check_page_folder(out)
    figure: Part = draw_numbers(comparison.numbers) or MissingPart(
        title="Differences of the numbers", needs="a number that two models have for one sample, and at most 15 pairs"
    )
    listed = choose_listed(comparison.samples, lambda s: s.model, lambda s: verdict_of(s.row) in GOOD_VERDICTS)
    return write_parts(
        "comparison_page.html.j2",
        "Comparison of models",
        out,
        [tabulate_numbers(comparison.numbers), figure],
        _tabulate_samples(comparison.samples),
        comparison=comparison,
        lines=[(s, list_links(s.run.path, s.row, out)) for s in listed],
    )


def _tabulate_samples(samples: Sequence[ModelSample]) -> Table:
    """Build the table of all samples, one per row, for samples.csv."""
    keys = ("model", "folder", "id", "video", "task", "seed", "status", "reason", "verdict")
    return Table(
        name="samples",
        title="Samples",
        note="",
        columns=tuple(Column(key=key, label=key) for key in (*keys, *NUMBERS)),
        rows=tuple(
            (
                *(s.model, s.run.name, s.row.id, s.row.video, s.row.task),
                seed if isinstance(seed := s.row.extra.get("seed"), int) else None,
                *(s.row.status.value, s.row.reason, verdict_of(s.row)),
                *(value_of(s.row, name) for name in NUMBERS),
            )
            for s in samples
        ),
        latex=False,
    )
