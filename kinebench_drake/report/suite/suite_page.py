"""The html page: tables, figures, what is missing, and every episode."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from markupsafe import Markup

from kinebench_drake.report.page import environment
from kinebench_drake.report.suite.episode import EpisodeResult, group
from kinebench_drake.report.suite.folders import RunFolder
from kinebench_drake.report.suite.table import Table, is_numeric, shown, shown_interval, sort_key
from kinebench_drake.results.store import REPORT, artifact_path


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeLink:
    """A file to look at."""

    label: str
    target: str
    """Address relative to the report."""


def links_of(episode: EpisodeResult, out: Path) -> list[EpisodeLink]:
    """What there is to look at of an episode: its rollout, the first imagined clip, its place in the run's own report.

    Only of runs that lie beside the report, in the same parent folder or below it: links to elsewhere would tell paths
    of this machine and break as soon as the report is moved.
    """
    if episode.folder is None:
        return []
    base, home = episode.folder.resolve(), out.resolve()
    if not base.is_relative_to(home.parent):
        return []
    rollout = artifact_path(base, "rollouts", episode.row.id)
    found = [("rollout", rollout, ""), ("video", base / episode.row.video, "")]
    found.append(("report", base / REPORT, f"#{quote(episode.row.id)}"))
    return [
        EpisodeLink(label=label, target=quote(Path(os.path.relpath(file, home)).as_posix()) + tail)
        for label, file, tail in found
        if file.is_file() and file.resolve().is_relative_to(home.parent)
    ]


LISTED = 2000
"""Episodes on the page: more would make it slow to open."""
SHOWN = 200
"""Episodes in its list until more are asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A figure on the page."""

    name: str
    title: str
    caption: str
    svg: Markup


@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """A table or a figure that could not be made."""

    title: str
    needs: str
    """What would be needed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PageLine:
    """One episode on the page."""

    episode: EpisodeResult
    outcome: str
    told: str
    """Cause of a failure, or the reason why there is no outcome."""
    links: tuple[EpisodeLink, ...]


def build_page(
    title: str,
    folders: Sequence[RunFolder],
    episodes: Sequence[EpisodeResult],
    out: Path,
    *,
    parts: Sequence[Table | Drawn],
    missing: Sequence[Missing] = (),
) -> str:
    """The page's html; the same input gives the same bytes.

    Args:
        title: its heading.
        folders: the runs it is about.
        episodes: the episodes to list.
        out: folder that it will lie in, for links.
        parts: tables and figures in their order.
        missing: what could not be made.
    """
    templates = environment("kinebench_drake.report.suite")
    templates.filters.update(shown=shown, interval=shown_interval, key=sort_key)
    templates.tests["table"] = lambda part: isinstance(part, Table)
    return templates.get_template("page.html.j2").render(
        title=title,
        folders=folders,
        episodes=len(episodes),
        parts=parts,
        numeric={part.name: _numeric(part) for part in parts if isinstance(part, Table)},
        missing=missing,
        lines=[_line(e, out) for e in _listed(episodes)],
        left_out=max(len(episodes) - LISTED, 0),
        first=SHOWN,
    )


def _listed(episodes: Sequence[EpisodeResult]) -> list[EpisodeResult]:
    """The episodes that have room, those without success first, of every model on every part as many as of another."""
    turns = {
        id(e): (e.success is True, turn)
        for own in group(episodes, lambda e: (e.part, e.model, e.success is True)).values()
        for turn, e in enumerate(own)
    }
    chosen = sorted(episodes, key=lambda e: turns[id(e)])[:LISTED]
    kept = {id(e) for e in chosen}
    return sorted((e for e in episodes if id(e) in kept), key=lambda e: e.success is True)


def _numeric(table: Table) -> list[bool]:
    return [is_numeric(table, k) for k in range(len(table.columns))]


def _line(episode: EpisodeResult, out: Path) -> PageLine:
    row = episode.row
    cause = row.extra.get("cause")
    told = cause.get("text") if isinstance(cause, Mapping) else row.reason
    outcome = row.status.value if episode.success is None else "success" if episode.success else "failure"
    return PageLine(
        episode=episode,
        outcome="not told" if outcome == "ok" else outcome,
        told=str(told or ""),
        links=tuple(links_of(episode, out)),
    )
