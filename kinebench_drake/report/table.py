"""Tables of values with intervals: from captions.toml; as CSV, as LaTeX, as text; and the number formats of pages."""

import csv
import io
import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Any, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined

from kinebench_drake.errors import count_noun
from kinebench_drake.io.figure import shorten
from kinebench_drake.report.metric import BY_NAME
from kinebench_drake.results.aggregate import Estimate

Value: TypeAlias = str | int | float | Estimate | None
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_TAILS = ("", "_low", "_high", "_n", "_bound")  # of the columns of an estimate in a CSV file
DASH = "–"
"""Text of a missing value."""
FIRST = "$first"
SECOND = "$second"
"""Places of the names of two models in the headings of a table that compares models."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """One column of a table."""

    key: str
    """Name in files."""
    label: str
    """Name on pages."""
    pattern: str = "{}"
    """Format of the numbers."""
    meaning: str = ""
    """Tooltip of the heading: one clause."""
    estimated: bool = False
    """True if the values are estimates: CSV files then have columns for the interval and the sample count."""
    signed: bool = False
    """True if numbers have a sign in any case, as differences do."""


def plain_columns(**labels: str) -> tuple[Column, ...]:
    """Return columns of texts and counts from their labels by key."""
    return tuple(Column(key=key, label=label) for key, label in labels.items())


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with its caption."""

    name: str
    """Stem of the file names."""
    title: str
    note: str
    """Contents, and how to read them."""
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    bold: frozenset[tuple[int, int]] = field(default_factory=frozenset)
    """(row, column) of the cells set in bold."""
    latex: bool = True
    """True if a LaTeX file is written, too."""
    patterns: tuple[str, ...] = ()
    """Format of each row's estimates where rows are different quantities; empty: the columns' formats."""

    def __post_init__(self) -> None:
        """Check that every row has as many cells as there are columns, and a format if any row has one.

        Raises:
            ValueError: it has not.
        """
        if self.patterns and len(self.patterns) != len(self.rows):
            raise ValueError(f"table {self.name}: {len(self.patterns)} formats of {len(self.rows)} rows")
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: a row of {len(row)} cells under {len(self.columns)} columns")

    @property
    def numeric(self) -> list[bool]:
        """True for each column that holds no text."""
        return [not any(isinstance(row[k], str) for row in self.rows) for k in range(len(self.columns))]

    def pattern(self, row: int, column: int) -> str:
        """Return the format of a cell's number."""
        head = self.columns[column]
        pattern = self.patterns[row] if self.patterns and head.estimated else head.pattern
        return pattern.replace("{:", "{:+", 1) if head.signed else pattern

    def select(self, keys: Sequence[str], rows: Sequence[int]) -> "Table":
        """Return a table of some columns and some rows."""
        shown = [k for k, column in enumerate(self.columns) if column.key in keys]
        return replace(
            self,
            columns=tuple(self.columns[k] for k in shown),
            rows=tuple(tuple(self.rows[i][k] for k in shown) for i in rows),
            patterns=tuple(self.patterns[i] for i in rows) if self.patterns else (),
            bold=frozenset(
                (i, k) for i, row in enumerate(rows) for k, column in enumerate(shown) if (row, column) in self.bold
            ),
        )

    def by_pair(self, letters: int = 28) -> list["Table"]:
        """Return a table for each two models, named in headings and title; of a table of other things, the table.

        Args:
            letters: letters of a model's name in a heading; more where two names would be equal.
        """
        keys = [column.key for column in self.columns]
        if "first" not in keys:
            return [self]
        heads = [keys.index(key) for key in ("first", "second", "part") if key in keys]
        others = [key for key in keys if key not in ("first", "second", "part")]
        groups: dict[tuple[str, ...], list[int]] = {}
        for i, row in enumerate(self.rows):
            groups.setdefault(tuple(str(row[k]) for k in heads), []).append(i)
        tables = []
        for number, ((first, second, *part), rows) in enumerate(groups.items()):
            own = self.select(others, rows)
            room = letters
            while (one := shorten(first, room)) == (other := shorten(second, room)) and first != second:
                room += letters
            columns = [replace(c, label=c.label.replace(FIRST, one).replace(SECOND, other)) for c in own.columns]
            title = f"{self.title}: {first} and {second}" + "".join(f", {text}" for text in part)
            name = f"{self.name}_{number + 1}" if number else self.name
            tables.append(replace(own, name=name, title=title, columns=tuple(columns)))
        return tables


@cache
def _read_captions() -> Mapping[str, Any]:
    return tomllib.loads(files("kinebench_drake.report").joinpath("captions.toml").read_text(encoding="utf-8"))


def read_caption(kind: str, key: str, **values: object) -> dict[str, Any]:
    """Return a part's texts in captions.toml, with `values` in their placeholders.

    Args:
        kind: tables, figures or missing.
        key: the part.
        values: by name of the placeholder.
    """
    texts = {"name": key, **_read_captions()[kind][key]}
    return {name: text.format(**values) if isinstance(text, str) else text for name, text in texts.items()}


def make_table(
    key: str,
    rows: Iterable[Mapping[str, Value]],
    *,
    more: Sequence[tuple[Column, Sequence[Value]]] = (),
    note: str = "",
    bold: Iterable[tuple[int, str]] = (),
    patterns: Iterable[str] = (),
    **values: object,
) -> Table:
    """Make a table of captions.toml.

    Args:
        key: its name there.
        rows: cells by key of their column; absent ones are None.
        more: columns that follow those of the file, with a cell for each row.
        note: sentences that follow its note.
        bold: row and key of the cells set in bold.
        patterns: format of each row's estimates, where rows are different quantities.
        values: by name of the placeholder.
    """
    rows = list(rows)
    caption = read_caption("tables", key, **values)
    own = list(_list_columns(caption.pop("columns"), rows, values))
    columns = (*own, *(column for column, _ in more))
    places = {column.key: k for k, column in enumerate(columns)}
    return Table(
        **{**caption, "note": caption["note"] + note},
        columns=columns,
        rows=tuple(
            (*(row.get(column.key) for column in own), *(cells[i] for _, cells in more)) for i, row in enumerate(rows)
        ),
        bold=frozenset((i, places[name]) for i, name in bold),
        patterns=tuple(patterns),
    )


def _list_columns(
    definitions: Sequence[Any], rows: Sequence[Mapping[str, Value]], values: Mapping[str, object]
) -> Iterator[Column]:
    shared = _read_captions()["columns"]
    for definition in definitions:
        if isinstance(definition, str) and definition in shared["lists"]:
            yield from _list_columns(shared["lists"][definition], rows, values)
            continue
        texts = {"key": definition, **shared[definition]} if isinstance(definition, str) else definition
        if metric := BY_NAME.get(texts.get("metric", "")):
            texts = {"key": metric.name, **asdict(metric), **texts}
        if not texts.get("optional") or any(texts["key"].format(**values) in row for row in rows):
            names = {name: texts.get(name, "").format(**values) for name in ("key", "label", "meaning")}
            yield Column(**names, **{name: texts[name] for name in ("pattern", "estimated", "signed") if name in texts})


def make_listing(name: str, keys: Sequence[str], rows: Iterable[Sequence[Value]]) -> Table:
    """Make a table for a file only: columns are named by their keys."""
    columns = tuple(Column(key=key, label=key) for key in keys)
    return Table(name=name, title="", note="", columns=columns, rows=tuple(map(tuple, rows)), latex=False)


def format_value(value: Value, pattern: str) -> str:
    """Format a number, or the mean of an estimate; a dash if it is missing."""
    if isinstance(value, Estimate):
        value = value.mean
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return DASH
    return value if isinstance(value, str) else pattern.format(value)


def format_interval(value: Value, pattern: str) -> str | None:
    """Format the interval of an estimate; None if there is none."""
    if not isinstance(value, Estimate) or value.low is None or value.high is None:
        return None
    return f"{pattern.format(value.low)} to {pattern.format(value.high)}"


def format_bound(value: Value, pattern: str) -> str | None:
    """Format the bound of an estimate that lacks values; None if there is none."""
    if not isinstance(value, Estimate) or value.bound is None or value.n == value.total:
        return None
    return f"{value.n} of {value.total}, bound {pattern.format(value.bound)}"


def sort_key(value: Value) -> str:
    """Return the text by which a page sorts a value; empty if it is missing."""
    if isinstance(value, Estimate):
        value = value.mean
    return "" if value is None else str(value)


def template_environment() -> Environment:
    """Return the templates of this package, with escaping and the number formats of all pages."""
    templates = Environment(
        loader=PackageLoader("kinebench_drake.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters.update(number=format_value, interval=format_interval, counted=count_noun, bound=format_bound)
    return templates


def format_csv(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Format rows as CSV (RFC 4180 with line feeds), numbers with all digits.

    Text that a spreadsheet would run as a formula begins with an apostrophe.
    """

    def inert(cell: object) -> object:
        return f"'{cell}" if isinstance(cell, str) and cell.startswith(_FORMULA) else cell

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(inert, heads))
    writer.writerows([inert(cell) for cell in row] for row in rows)
    return text.getvalue()


def table_csv(table: Table) -> str:
    """Format a table as CSV; an estimate takes five columns: mean, interval, number of values, bound."""
    heads = [c.key + tail for c in table.columns for tail in (_TAILS if c.estimated else ("",))]

    def cells(value: Value, column: Column) -> list[object]:
        if isinstance(value, Estimate):
            return [value.mean, value.low, value.high, value.n, value.bound] if column.estimated else [None]
        return [value, None, None, None, None] if column.estimated else [value]

    return format_csv(
        heads, ([x for v, c in zip(row, table.columns, strict=True) for x in cells(v, c)] for row in table.rows)
    )


def table_lines(table: Table) -> Iterator[str]:
    """Format a table as text for a terminal, its columns aligned; means have no interval beside a signed difference."""
    compared = any(column.signed for column in table.columns)

    def cell(value: Value, i: int, k: int) -> str:
        pattern = table.pattern(i, k)
        interval = format_interval(value, pattern) if table.columns[k].signed or not compared else None
        mark = "* " if (i, k) in table.bold else ""
        return mark + format_value(value, pattern) + (f" [{interval}]" if interval else "")

    texts = [[column.label for column in table.columns]]
    texts += [[cell(v, i, k) for k, v in enumerate(row)] for i, row in enumerate(table.rows)]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    for text in texts:
        aligned = zip(text, widths, table.numeric, strict=True)
        yield "  ".join(t.rjust(width) if right else t.ljust(width) for t, width, right in aligned).rstrip()


_LATEX = {
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


def escape_latex(text: str) -> str:
    """Escape all characters that are commands in LaTeX; those that cannot be printed become question marks."""
    return "".join(_LATEX.get(char, char if char.isprintable() else "?") for char in " ".join(text.split()))


def table_latex(table: Table) -> str:
    """Format a table as a LaTeX `table` environment (package booktabs), one for each two models that it compares.

    Intervals, and where values are missing their number and the bound, follow the means in small type.
    """
    return "\n".join(map(_latex, table.by_pair()))


def _latex(table: Table) -> str:
    def cell(value: Value, pattern: str, bold: bool) -> str:
        text = escape_latex(format_value(value, pattern))
        small = [part for part in (format_interval(value, pattern), format_bound(value, pattern)) if part]
        text = f"\\textbf{{{text}}}" if bold else text
        return f"{text} {{\\scriptsize ({escape_latex('; '.join(small))})}}" if small else text

    body = [
        [cell(v, table.pattern(i, k), (i, k) in table.bold) for k, v in enumerate(row)]
        for i, row in enumerate(table.rows)
    ]
    return "\n".join(
        [
            r"% needs \usepackage{booktabs}",
            r"\begin{table}[t]",
            r"  \centering",
            f"  \\caption{{{escape_latex(table.title)}. {escape_latex(table.note)}}}",
            f"  \\label{{tab:{table.name.replace('_', '-')}}}",
            f"  \\begin{{tabular}}{{{''.join('r' if numeric else 'l' for numeric in table.numeric)}}}",
            r"    \toprule",
            f"    {' & '.join(escape_latex(column.label) for column in table.columns)} \\\\",
            r"    \midrule",
            *(f"    {' & '.join(cells)} \\\\" for cells in body),
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
            "",
        ]
    )
