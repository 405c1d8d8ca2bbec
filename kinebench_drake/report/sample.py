"""One sample as the report shows it."""

import base64
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from kinebench_drake.report.curves import draw_curves
from kinebench_drake.report.details import Fact, Resolution, list_facts, resolutions, summarize_checks
from kinebench_drake.report.frames import anomalies_of
from kinebench_drake.report.moments import Moment, worst_moments
from kinebench_drake.report.timeline import draw_strip, frame_count, lanes_of
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.types import Json

FAILURES = {cause: f"failed: {cause}" for cause in ("grounding", "generation", "execution", "task")}
"""Verdicts of episodes that failed, and how they are shown."""
RANK = {
    name: rank
    for rank, name in enumerate(("error", "infeasible", *FAILURES, "unmeasurable", "unjudged", "feasible", "success"))
}
"""Verdicts, the worst first."""
GOOD = ("feasible", "success")
"""Verdicts without blame."""
MOST_BROKEN = 20
"""Broken limits that a sample's table lists, the first ones."""
_FILMS = {"rollouts": "Imagined and executed, side by side", "overlays": "Video with the gripper's pose drawn on it"}
_SHOWN_ELSEWHERE = ("limits", "checks")


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleView:
    """One sample as the page shows it."""

    row: SampleRow
    verdict: str
    """A key of RANK."""
    told: str
    """Why there is no result, or why the episode failed; empty where there is nothing to tell."""
    anomalies: Sequence[Mapping[str, Json]]
    thumbnail: str | None
    """Picture as a data URI; None where there is none, or where it is not put on the page."""
    strip: Markup | None
    """When it goes wrong, in small; None if nothing does."""
    moments: Sequence[Moment]
    left_out: int
    """Limits broken that `moments` leaves out, being too many."""
    plots: Sequence[Markup]
    summary: Sequence[Fact]
    """What the checks came to."""
    resolutions: Sequence[Resolution]
    """How well each kind of limit could be looked at."""
    facts: Sequence[Fact]
    """What else stands behind the verdict."""
    replay: str | None
    """Link to the 3D replay, relative to the page; None if none was written."""
    films: Sequence[tuple[str, str]]
    """What each film beside the page shows, and its relative link."""
    viewable: bool
    """Whether there is a track that `kinebench-drake view` can replay."""

    def value(self, name: str) -> float | None:
        """A metric, or a further key of the row, as a number; None where it has none."""
        return number_of(self.row, name)


def verdict_of(row: SampleRow) -> str:
    """The key of RANK that a row deserves: of an episode in closed loop, how it ended."""
    if row.status is not Status.OK:
        return str(row.status.value)
    if "verdict" in row.extra:
        cause = row.extra["verdict"]
        return "success" if row.extra.get("success") is True else cause if cause in FAILURES else "unjudged"
    return "unjudged" if row.feasible is None else "feasible" if row.feasible else "infeasible"


def badness(row: SampleRow) -> tuple[float | str, ...]:
    """Sorts the worst first."""
    tracked = number_of(row, "tracked_fraction")
    faults = len(row.violations) + len(anomalies_of(row))
    return RANK[verdict_of(row)], -faults, 1.0 if tracked is None else tracked, row.id


def worst_samples(rows: Iterable[SampleRow], track: Callable[[str], Path], n: int) -> list[str]:
    """Ids of the `n` worst samples that have a track, in the order of the report.

    Args:
        rows: the samples.
        track: where the track of an id lies.
        n: how many at most.
    """
    worst = (row.id for row in sorted(rows, key=badness) if track(row.id).is_file())
    return list(islice(worst, n))


def goodness(row: SampleRow) -> tuple[float | str, ...]:
    """Sorts the best first; among equals that which keeps the greatest distance to the limits of the joints' rates."""
    rank, faults, tracked, id = badness(row)
    slowdown = number_of(row, "slowdown_min")
    return -float(rank), -float(faults), -float(tracked), np.inf if slowdown is None else slowdown, id


def has_picture(out: Path, row: SampleRow) -> bool:
    """Whether the folder holds a picture of the sample."""
    return artifact_path(out, "thumbnails", row.id).is_file()


def view_sample(out: Path, row: SampleRow, *, drawn: bool, pictured: bool = True) -> SampleView:
    """Gather a sample's findings from an output folder.

    Args:
        out: the folder.
        row: the sample's row.
        drawn: whether to draw its curves and list its findings; else the row alone is used.
        pictured: whether to take its picture along.

    Raises:
        InputError: the track's file is damaged.
    """
    uri = None
    if pictured and has_picture(out, row):
        data = artifact_path(out, "thumbnails", row.id).read_bytes()
        uri = f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"
    track = artifact_path(out, "tracks", row.id)
    replay = artifact_path(out, "replays", row.id)
    cause = row.extra.get("cause")
    viewable = row.status is Status.OK and track.is_file()
    file = read_track(track) if viewable and drawn else None
    details = {name: value for name, value in row.details.items() if name not in _SHOWN_ELSEWHERE}
    reasons = {f"no {name}": reason for name, reason in row.null_reasons.items() if "_floor_" not in name}
    moments = worst_moments(row, file)
    broken = [moment for moment in moments if moment.broken]
    lanes = lanes_of(row, file)
    return SampleView(
        row=row,
        verdict=verdict_of(row),
        told=row.reason or (str(cause.get("text") or "") if isinstance(cause, Mapping) else ""),
        anomalies=anomalies_of(row),
        thumbnail=uri,
        strip=draw_strip(lanes, frame_count(row, file, lanes)) if lanes else None,
        moments=[*broken[:MOST_BROKEN], *(moment for moment in moments if not moment.broken)],
        left_out=max(len(broken) - MOST_BROKEN, 0),
        plots=draw_curves(row, file) if file else [],
        summary=summarize_checks(row, file.track.t_s) if file else [],
        resolutions=resolutions(row) if drawn else [],
        facts=[*list_facts(details), *_floors(row), *list_facts(reasons)] if drawn else [],
        replay=f"replays/{quote(row.id)}.html" if viewable and replay.is_file() else None,
        films=[
            (told, f"{part}/{quote(row.id)}.mp4")
            for part, told in _FILMS.items()
            if artifact_path(out, part, row.id).is_file()
        ],
        viewable=viewable,
    )


def _floors(row: SampleRow) -> Iterator[Fact]:
    """Smoothness beside what this track's motion would score with its noise."""
    for name in row.metrics:
        value = number_of(row, name)
        median, low, high = (number_of(row, f"{name}_floor_{part}") for part in ("median", "low", "high"))
        if value is not None and median is not None and low is not None and high is not None:
            text = f"{value:.2f}; smoothed and with its noise {median:.2f} ({low:.2f} to {high:.2f})"
            yield Fact(depth=0, name=name.replace("_", " "), text=text)


def number_of(row: SampleRow, name: str) -> float | None:
    """A metric, or a further key of the row, as a number; None where it has none."""
    value = row.metrics.get(name, row.extra.get(name))
    return float(value) if isinstance(value, bool | int | float) else None
