"""Samples of one output folder as a table, a row per sample."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from kinebench_drake.report.sample import badness
from kinebench_drake.report.verdict import describe_trust, describe_verdict, verdict_of
from kinebench_drake.results.row import OUTCOMES, SampleRow
from kinebench_drake.results.store import read_rows

_VERDICTS = ("verdict", "verdict_text", "trust", "status", "reason", "executable", "feasible")
_LABELS = ("id", "video", "task", "model", *_VERDICTS)
_LISTS = ("executable_reasons", "violations", "anomalies")


def read_samples(out: Path) -> Any:
    """Read the samples of an output folder as a `pyarrow.Table`: labels, verdicts, faults, metrics, the worst first."""
    import pyarrow

    rows = sorted(read_rows(out).values(), key=badness)
    metrics = dict.fromkeys(name for row in rows for name in row.metrics.numbers)
    metrics |= dict.fromkeys(name for name in OUTCOMES if any(row.has(name) for row in rows))
    heads = [*_LABELS, *_LISTS, *metrics]
    lines = [_cells(row, metrics) for row in rows]
    return pyarrow.table({head: _column([line[k] for line in lines]) for k, head in enumerate(heads)})


def _cells(row: SampleRow, metrics: Iterable[str]) -> list[object]:
    values = {
        "verdict": verdict_of(row),
        "verdict_text": describe_verdict(row),
        "trust": describe_trust(row) or None,
        "status": row.status.value,
    }
    kinds = [sorted({mark.kind.value for mark in marks}) for marks in (row.violations, row.anomalies)]
    return [
        *(values[label] if label in values else getattr(row, label) for label in _LABELS),
        *("; ".join(texts) for texts in (row.executable_reasons, *kinds)),
        *(row.value(name) for name in metrics),
    ]


def _column(values: Sequence[object]) -> Any:
    """Return a column of texts, of truth values, or of numbers."""
    import pyarrow

    if any(isinstance(value, str) for value in values):
        return pyarrow.array([None if value is None else str(value) for value in values], pyarrow.string())
    if all(value is None or isinstance(value, bool) for value in values):
        return pyarrow.array(values, pyarrow.bool_())
    numbers = [float(value) if isinstance(value, bool | int | float) else None for value in values]
    return pyarrow.array(numbers, pyarrow.float64())
