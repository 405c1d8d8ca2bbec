"""Pages made of tables and figures about several runs, and these tables and figures as files."""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from itertools import count
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
FIRST = 200
"""Samples that the list of a page shows until all are requested."""
_FILES = {"rollout": "rollouts", "overlay": "overlays"}
"""Labels of links, and the artifacts that they lead to."""


def make_missing(key: str, **values: object) -> str:
    """Name a part of captions.toml that cannot be made, and what it needs, with `values` in its placeholders."""
    texts = read_caption("missing", key, **values)
    return f"{texts['title']}: {texts['needs']}"


Part = Table | ReportFigure | str
"""A table, a figure, or the text in place of a part that cannot be made."""


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
    templates.filters |= {
        "key": sort_key,
        "verdict": verdict_of,
        "named": name_verdict,
        "explanation": explain_verdict,
    }
    text = templates.get_template(template).render(
        title=title,
        parts=[
            (part, write_figure(part, out) if isinstance(part, ReportFigure) else None)
            for part in parts
            if not isinstance(part, str)
        ],
        missing=[part for part in parts if isinstance(part, str)],
        first=FIRST,
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
    places = defaultdict[Hashable, Iterator[int]](count)
    turns = [(good(item), next(places[group(item), good(item)])) for item in items]
    chosen = sorted(range(len(items)), key=turns.__getitem__)[:LISTED]
    return [items[k] for k in sorted(chosen, key=lambda k: (turns[k][0], k))]
