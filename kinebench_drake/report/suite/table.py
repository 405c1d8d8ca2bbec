"""A table once, for every way of writing it: values with intervals, and how each column is shown."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from kinebench_drake.results.aggregate import Estimate

Value: TypeAlias = str | int | float | Estimate | None
DASH = "–"
"""Stands where there is nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column of a table."""

    key: str
    """Its name in files."""
    label: str
    """Its name for a reader."""
    pattern: str = "{}"
    """Format of its numbers."""
    meaning: str = ""
    """One clause for the reader."""
    estimated: bool = False
    """Whether it holds estimates: files then have columns for the interval and the number behind it, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table."""

    name: str
    """Its name in file names."""
    title: str
    note: str
    """What it says and how it is to be read."""
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    bold: frozenset[tuple[int, int]] = field(default_factory=frozenset)
    """Rows and columns of the cells that stand out."""
    latex: bool = True
    """Whether it is written as LaTeX, too."""

    def __post_init__(self) -> None:
        """Check that rows and columns fit.

        Raises:
            ValueError: a row has another number of cells.
        """
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: a row of {len(row)} cells under {len(self.columns)} columns")


def shown(value: Value, column: Column) -> str:
    """A value in its column's format; of an estimate the mean."""
    if isinstance(value, Estimate):
        value = value.mean
    if value is None:
        return DASH
    return value if isinstance(value, str) else column.pattern.format(value)


def shown_interval(value: Value, column: Column) -> str | None:
    """The interval of an estimate; None where there is none."""
    if not isinstance(value, Estimate) or value.low is None or value.high is None:
        return None
    return f"{column.pattern.format(value.low)} to {column.pattern.format(value.high)}"


def sort_key(value: Value) -> str:
    """What a reader's sorting goes by; empty where there is nothing."""
    if isinstance(value, Estimate):
        value = value.mean
    return "" if value is None else str(value)


def is_numeric(table: Table, index: int) -> bool:
    """Whether a column holds numbers."""
    return not any(isinstance(row[index], str) for row in table.rows)


def csv_text(table: Table) -> str:
    """The table as CSV (RFC 4180, line feeds), numbers in full; an estimate is mean, interval and number of values."""
    heads: list[str] = []
    for column in table.columns:
        tails = ("", "_low", "_high", "_n") if column.estimated else ("",)
        heads += [column.key + tail for tail in tails]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    for row in table.rows:
        cells: list[str | int | float | None] = []
        for column, value in zip(table.columns, row, strict=True):
            cells += _cells(value) if column.estimated else [None if isinstance(value, Estimate) else value]
        writer.writerow(cells)
    return text.getvalue()


def lines(table: Table) -> Iterator[str]:
    """The table to print, its columns aligned."""
    texts = [[column.label for column in table.columns]]
    for row in table.rows:
        pairs = zip(table.columns, row, strict=True)
        texts.append([" ".join(filter(None, (shown(v, c), _bracketed(v, c)))) for c, v in pairs])
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    right = [is_numeric(table, k) for k in range(len(table.columns))]
    for text in texts:
        cells = zip(text, widths, right, strict=True)
        yield "  ".join(
            cell.rjust(width) if to_right else cell.ljust(width) for cell, width, to_right in cells
        ).rstrip()


def _bracketed(value: Value, column: Column) -> str | None:
    interval = shown_interval(value, column)
    return None if interval is None else f"[{interval}]"


def _cells(value: Value) -> list[str | int | float | None]:
    if isinstance(value, Estimate):
        return [value.mean, value.low, value.high, value.n]
    return [value, None, None, None]


_SPECIAL = {
    "\\": r"\textbackslash{}",
    **{char: "\\" + char for char in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "[": "{[}",
    "]": "{]}",
    '"': r"\textquotedbl{}",
    DASH: "--",
    "−": "$-$",
}


def latex_text(table: Table) -> str:
    """A `table` environment that needs the package booktabs; intervals stand behind their numbers in small type."""
    align = "".join("r" if is_numeric(table, k) else "l" for k in range(len(table.columns)))
    heads = " & ".join(escape(column.label) for column in table.columns)
    body = []
    for i, row in enumerate(table.rows):
        cells = [
            _cell(value, column, (i, k) in table.bold)
            for k, (column, value) in enumerate(zip(table.columns, row, strict=True))
        ]
        body.append("    " + " & ".join(cells) + r" \\")
    return "\n".join(
        [
            "% needs \\usepackage{booktabs}",
            r"\begin{table}[t]",
            r"  \centering",
            f"  \\caption{{{escape(table.title)}. {escape(table.note)}}}",
            f"  \\label{{tab:{table.name.replace('_', '-')}}}",
            f"  \\begin{{tabular}}{{{align}}}",
            r"    \toprule",
            f"    {heads} \\\\",
            r"    \midrule",
            *body,
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def escape(text: str) -> str:
    """Text in which nothing is a LaTeX command."""
    return "".join(_SPECIAL.get(char, char) for char in " ".join(text.split()))


def _cell(value: Value, column: Column, bold: bool) -> str:
    text = escape(shown(value, column))
    interval = shown_interval(value, column)
    text = f"\\textbf{{{text}}}" if bold else text
    return text if interval is None else f"{text} {{\\scriptsize ({escape(interval)})}}"
