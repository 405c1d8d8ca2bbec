"""Pages made of tables and figures about several runs, and these tables and figures as files."""

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.figures import ReportFigure, write_figure
from kinebench_drake.report.sample import relative_link
from kinebench_drake.report.table import Table, read_caption, sort_key, table_csv, table_latex, template_environment
from kinebench_drake.report.verdict import explain_verdict, name_verdict, verdict_of
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.store import REPORT, artifact_path

Item = TypeVar("Item")
LISTED = 2000
"""Samples on a page: more would make it slow to open."""
_FILES = {"rollout": "rollouts", "overlay": "overlays"}
"""Labels of links, and the artifacts that they lead to."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingPart:
    """A table or figure that cannot be made."""

    title: str
    needs: str
    """Data that would be needed."""


def make_missing(key: str, **values: object) -> MissingPart:
    """Name what a part of captions.toml needs, with `values` in its placeholders."""
    texts = read_caption("missing", key, **values)
    return MissingPart(title=texts["title"], needs=texts["needs"])


Part = Table | ReportFigure | MissingPart


def write_parts(
    template: str, title: str, out: Path, parts: Sequence[Part], listing: Table, *, page: str = REPORT, **context: Any
) -> Path:
    """Write a page, and its tables and figures as files; the same input gives the same bytes.

    Args:
        template: name of the page's template, an extension of `parts.html.j2`.
        listing: table of all samples, as a file only.

    Returns:
        The page.
    """
    for table in (listing, *(part for part in parts if isinstance(part, Table))):
        write_atomically(out / f"{table.name}.csv", table_csv(table).encode())
        if table.latex:
            write_atomically(out / f"{table.name}.tex", table_latex(table).encode())
    templates = template_environment()
    templates.filters |= {"key": sort_key}
    templates.filters |= {"verdict": verdict_of, "named": name_verdict, "explanation": explain_verdict}
    text = templates.get_template(template).render(
        title=title,
        parts=[
            (part, write_figure(part, out) if isinstance(part, ReportFigure) else None)
            for part in parts
            if not isinstance(part, MissingPart)
        ],
        missing=[part for part in parts if isinstance(part, MissingPart)],
        first=200,  # samples in its list until all are requested
        **context,
    )
    write_atomically(out / page, text.encode())
    return out / page


def list_links(folder: Path, row: SampleRow, out: Path) -> list[tuple[str, str]]:
    """List labels and addresses of a sample's files: rollout, overlay, video, entry in the run's own report.

    Only for runs in the parent folder of `out` or below it: other links would reveal paths of this machine and break
    when the page is moved.

    Args:
        folder: output folder of the run.
    """
    base = folder.resolve()
    home = out.resolve()
    if not base.is_relative_to(home.parent):
        return []
    files = (
        *((label, artifact_path(base, kind, row.id), "") for label, kind in _FILES.items()),
        ("video", base / row.video, ""),
        ("report", base / REPORT, row.id),
    )
    return [
        (label, relative_link(file, home, anchor))
        for label, file, anchor in files
        if file.is_file() and file.resolve().is_relative_to(home.parent)
    ]


def choose_listed(items: Sequence[Item], group: Callable[[Item], Hashable], good: Callable[[Item], bool]) -> list[Item]:
    """Choose LISTED samples, those that are not good first, evenly over the groups."""
    counts = Counter[Hashable]()
    turns = []
    for index, item in enumerate(items):
        key = (group(item), good(item))
        turns.append((good(item), counts[key], index))
        counts[key] += 1
    chosen = sorted(turns)[:LISTED]
    return [items[index] for _, index in sorted((is_good, index) for is_good, _, index in chosen)]
