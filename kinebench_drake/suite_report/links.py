"""Links from a report to what runs left of their episodes."""

import os
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from kinebench_drake.results import REPORT, part_path
from kinebench_drake.suite_report.episode import Episode


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A file to look at."""

    label: str
    target: str
    """Address relative to the report."""


def links_of(episode: Episode, out: Path) -> list[Link]:
    """What there is to look at of an episode: its rollout, the first imagined clip, its place in the run's own report.

    Only of runs that lie beside the report, in the same parent folder or below it: links to elsewhere would tell paths
    of this machine and break as soon as the report is moved.
    """
    if episode.folder is None:
        return []
    base, home = episode.folder.resolve(), out.resolve()
    if not base.is_relative_to(home.parent):
        return []
    rollout = part_path(base, "rollouts", episode.row.id)
    found = [("rollout", rollout, ""), ("video", base / episode.row.video, "")]
    found.append(("report", base / REPORT, f"#{quote(episode.row.id)}"))
    return [
        Link(label=label, target=quote(Path(os.path.relpath(file, home)).as_posix()) + tail)
        for label, file, tail in found
        if file.is_file() and file.resolve().is_relative_to(home.parent)
    ]
