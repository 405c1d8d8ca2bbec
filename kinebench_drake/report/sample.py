"""One sample of a report: its verdict, its rank among the others, and all that the page shows of it."""

import base64
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json, as_object
from kinebench_drake.report.curves import draw_curves
from kinebench_drake.report.limit_table import LimitPeak, find_checks, find_peaks, in_unit, to_number
from kinebench_drake.report.timeline import anomalies_of
from kinebench_drake.report.verdict import VERDICT_LABELS, verdict_of
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import artifact_path
from kinebench_drake.results.trackfile import TrackFile, read_track
from kinebench_drake.segments import segments

_RANK = {verdict: rank for rank, verdict in enumerate(VERDICT_LABELS)}
_ROUNDING = 1e-6
"""Noise below which it is a rounding error [m], [rad]."""
_MAX_VIOLATIONS = 20
"""Violations that a sample's table lists, the first ones by cause."""
VIDEOS = {"rollouts": "Generated and executed, side by side", "overlays": "Video with the gripper's pose drawn on it"}


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleView:
    """One sample as the page shows it."""

    row: SampleRow
    thumbnail: str | None
    """Image as a data URI; None if there is none, or if it is not on the page."""
    peaks: Sequence[LimitPeak]
    """Limits broken, and the peaks against the others."""
    left_out: int
    """Violations that `peaks` leaves out."""
    plots: Sequence[Markup]
    summary: Sequence[tuple[str, str]]
    """Names and results of the checks."""
    checks: Mapping[str, Mapping[str, Json]]
    """Check of each rate limit, see `find_checks`: its window, bandwidth, noise and the ratio of each joint."""
    remarks: Sequence[tuple[str, str]]
    """Smoothness beside its noise floor, and why metrics have no value."""
    replay: str | None
    """Link to the 3D replay, relative to the page; None if there is none."""
    videos: Sequence[tuple[str, str]]
    """Labels and relative links of the videos beside the page."""
    viewable: bool
    """True if there is a track for `kinebench-drake view`."""


def numeric_value(row: SampleRow, name: str) -> float | None:
    """Return a metric, or a further key of the row, as a number; None if it is none."""
    value = row.metrics.get(name, row.extra.get(name))
    return float(value) if isinstance(value, bool | int | float) else None


def badness(row: SampleRow) -> tuple[float | str, ...]:
    """Return a sort key, the worst first: verdict, number of faults, share of frames tracked."""
    tracked = numeric_value(row, "tracked_fraction")
    faults = len(row.violations) + len(anomalies_of(row))
    return _RANK[verdict_of(row)], -faults, 1.0 if tracked is None else tracked, row.id


def goodness(row: SampleRow) -> tuple[float | str, ...]:
    """Return a sort key, the best first: the reverse of `badness`, then the least slow-down needed."""
    rank, faults, tracked, id = badness(row)
    slowdown = numeric_value(row, "slowdown_min")
    return -float(rank), -float(faults), -float(tracked), np.inf if slowdown is None else slowdown, id


def worst_samples(rows: Iterable[SampleRow], track: Callable[[str], Path], n: int) -> list[str]:
    """List the ids of the `n` worst samples that have a track, in the order of the report."""
    worst = (row.id for row in sorted(rows, key=badness) if track(row.id).is_file())
    return list(islice(worst, n))


def has_thumbnail(out: Path, row: SampleRow) -> bool:
    """Return whether the folder holds an image of the sample."""
    return artifact_path(out, "thumbnails", row.id).is_file()


def embed_thumbnail(out: Path, row: SampleRow) -> str:
    """Return the image of a sample as a data URI."""
    data = artifact_path(out, "thumbnails", row.id).read_bytes()
    return f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


def is_viewable(out: Path, row: SampleRow) -> bool:
    """Return whether `view` can show the sample: it has a track, in the base frame."""
    return _has_track(out, row) and "base_frame_reason" not in row.extra


def _has_track(out: Path, row: SampleRow) -> bool:
    return row.status is Status.OK and artifact_path(out, "tracks", row.id).is_file()


def relative_link(file: Path, folder: Path, anchor: str = "") -> str:
    """Return the address of a file, relative to the folder of a page, with an optional anchor."""
    return quote(Path(os.path.relpath(file, folder)).as_posix()) + (f"#{quote(anchor)}" if anchor else "")


def view_sample(out: Path, row: SampleRow, *, pictured: bool, drawn: bool) -> SampleView:
    """Collect everything that the page shows of a sample.

    Args:
        pictured: whether to include its image.
        drawn: whether to read its track and draw its curves.
    """
    viewable = is_viewable(out, row)
    file = read_track(artifact_path(out, "tracks", row.id)) if drawn and _has_track(out, row) else None
    links = {
        part: relative_link(path, out)
        for part in ("replays", *VIDEOS)
        if (path := artifact_path(out, part, row.id)).is_file()
    }
    peaks = find_peaks(row, file)
    violations = [peak for peak in peaks if peak.broken]
    return SampleView(
        row=row,
        thumbnail=embed_thumbnail(out, row) if pictured and has_thumbnail(out, row) else None,
        peaks=[*violations[:_MAX_VIOLATIONS], *(peak for peak in peaks if not peak.broken)],
        left_out=max(len(violations) - _MAX_VIOLATIONS, 0),
        plots=draw_curves(row, file) if file else [],
        summary=[*summarize_checks(row, file.track.t_s), *_repeated_frames(file)] if file else [],
        checks=find_checks(row.details) if drawn else {},
        remarks=list(_list_remarks(row)) if drawn else [],
        replay=links.get("replays") if viewable else None,
        videos=[(label, links[part]) for part, label in VIDEOS.items() if part in links],
        viewable=viewable,
    )


def _list_remarks(row: SampleRow) -> Iterator[tuple[str, str]]:
    """List smoothness beside its noise floor, and reasons of missing metrics."""
    for name in row.metrics:
        value, median, low, high = (
            numeric_value(row, name + suffix) for suffix in ("", "_floor_median", "_floor_low", "_floor_high")
        )
        if value is not None and median is not None and low is not None and high is not None:
            text = f"{value:.2f}; smoothed track with its noise {median:.2f} ({low:.2f} to {high:.2f})"
            yield name.replace("_", " "), text
    for name, reason in row.null_reasons.items():
        if "_floor_" not in name:
            yield f"no {re.sub('_(m|rad|s|px)$', '', name).replace('_', ' ')}", reason


def summarize_checks(row: SampleRow, t_s: Array | None) -> list[tuple[str, str]]:
    """Summarize noise, slow-down, fastest execution and optimised trajectory of a row, as far as it has them."""
    lines = [
        ("noise of the track", _noise(row)),
        ("slow-down needed", _slowdown(row, t_s)),
        ("fastest execution", _fastest(row, t_s)),
        ("smooth trajectory within all limits", _trajectory(row, t_s)),
    ]
    return [(name, text) for name, text in lines if text is not None]


def _repeated_frames(file: TrackFile) -> Iterator[tuple[str, str]]:
    """Name the frames of a video that repeat the one before."""
    repeated = file.curves.get("repeated")
    if repeated is not None and (runs := segments(repeated == 1.0)):
        spans = [f"{run.start} to {run.stop - 1}" if run.stop - run.start > 1 else str(run.start) for run in runs]
        more = f" and {len(spans) - 12} more runs" if len(spans) > 12 else ""
        text = f"{int(np.sum(repeated == 1.0))} of {len(repeated)}: {', '.join(spans[:12])}{more}"
        yield "frames that repeat the one before", text


def _noise(row: SampleRow) -> str | None:
    noise = as_object(row.details.get("noise"))
    units = {"position_m": (1000.0, "mm"), "rotation_rad": (180.0 / np.pi, "°")}
    values = {name: value for name in units if (value := to_number(noise.get(name))) is not None}
    text = ", ".join(
        f"{units[name][0] * v if v >= _ROUNDING else 0:.4g} {units[name][1]}" for name, v in values.items()
    )
    if not text:
        return None
    return f"{text} (assumed: the track is too short for an estimate)" if noise.get("assumed") is True else text


def _slowdown(row: SampleRow, t_s: Array | None) -> str | None:
    factor = to_number(row.metrics.get("slowdown_min"))
    limit = _format_limit(row.details.get("slowdown"), t_s)
    if factor is None:
        return None
    least_s = to_number(row.metrics.get("feasible_from_period_s"))
    period = "" if least_s is None else f"; feasible from a frame period of {least_s:.2g} s"
    return f"{'none, ' if factor <= 1.0 else ''}{factor:.3g}{limit and f', for {limit}'}{period}"


def _fastest(row: SampleRow, t_s: Array | None) -> str | None:
    scale = to_number(row.metrics.get("time_scale"))
    limit = _format_limit(row.details.get("time_scale"), t_s)
    return None if scale is None else f"{scale:.3g} of its own duration{limit and f', limited by {limit}'}"


def _trajectory(row: SampleRow, t_s: Array | None) -> str | None:
    feasible = row.metrics.get("trajopt_feasible")
    radius = to_number(row.metrics.get("trajopt_position_tube_m"))
    if not isinstance(feasible, bool):
        return None
    section = as_object(row.details.get("trajopt"))
    tube = to_number(section.get("tube_limit_m"))
    obstacle = section.get("against")
    bound = "" if tube is None else f" (allowed: {tube * 1000.0:.3g} mm)"
    text = f"within {radius * 1000.0:.3g} mm of the track{bound}" if radius is not None else f"none{bound}"
    if feasible or not isinstance(obstacle, Mapping):
        return text
    value = to_number(obstacle.get("value"))
    limit = to_number(obstacle.get("limit"))
    kind = str(obstacle.get("kind"))
    numbers = ""
    if value is not None and limit is not None:
        (shown, unit) = in_unit(kind, value)
        (most, _) = in_unit(kind, limit)
        numbers = f", {shown:.4g} against {most:.4g} {unit}".rstrip()
    return f"{text}; prevented by {_format_limit({**obstacle, 'limit': kind}, t_s)}{numbers}"


def _format_limit(details: Json, t_s: Array | None) -> str:
    """Format the limit, joint and time in the details of a check; empty if they name no limit."""
    limit, joint, frame = (as_object(details).get(key) for key in ("limit", "joint", "frame"))
    if limit is None:
        return ""
    when = ""
    if isinstance(frame, int):
        when = f" at {t_s[frame]:.2f} s" if t_s is not None and 0 <= frame < len(t_s) else f" in frame {frame}"
    return f"{str(limit).replace('_', ' ')}{'' if joint is None else f' of {joint}'}{when}"
