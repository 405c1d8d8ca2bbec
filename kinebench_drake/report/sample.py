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
from kinebench_drake.report.curves import draw_curves
from kinebench_drake.report.limit_table import LimitPeak, find_checks, find_peaks, in_unit
from kinebench_drake.report.verdict import VERDICT_LABELS, verdict_of
from kinebench_drake.results.details import Details, LimitPlace, RateCheck, read_details
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
    checks: Mapping[str, RateCheck]
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
    """Return a verdict, an outcome or a metric as a number; None if it is not measured."""
    value = row.value(name)
    return None if value is None else float(value)


def badness(row: SampleRow) -> tuple[float | str, ...]:
    """Return a sort key, the worst first: verdict, number of faults, share of frames tracked."""
    tracked = row.metrics.tracked_fraction
    faults = len(row.violations) + len(row.anomalies)
    return _RANK[verdict_of(row)], -faults, 1.0 if tracked is None else tracked, row.id


def goodness(row: SampleRow) -> tuple[float | str, ...]:
    """Return a sort key, the best first: the reverse of `badness`, then the least slow-down needed."""
    rank, faults, tracked, id = badness(row)
    slowdown = row.metrics.slowdown_min
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


def _has_track(out: Path, row: SampleRow) -> bool:
    is_shown = row.status is Status.OK and row.arms is None
    return is_shown and artifact_path(out, "tracks", row.id).is_file()


def relative_link(file: Path, folder: Path, anchor: str = "") -> str:
    """Return the address of a file, relative to the folder of a page, with an optional anchor."""
    return quote(Path(os.path.relpath(file, folder)).as_posix()) + (f"#{quote(anchor)}" if anchor else "")


def view_sample(out: Path, row: SampleRow, *, pictured: bool, drawn: bool) -> SampleView:
    """Collect everything that the page shows of a sample.

    Args:
        pictured: whether to include its image.
        drawn: whether to read its track and draw its curves.
    """
    viewable = _has_track(out, row) and row.base_frame_reason is None
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
        checks=find_checks(row) if drawn else {},
        remarks=list(_list_remarks(row)) if drawn else [],
        replay=links.get("replays") if viewable else None,
        videos=[(label, links[part]) for part, label in VIDEOS.items() if part in links],
        viewable=viewable,
    )


def _list_remarks(row: SampleRow) -> Iterator[tuple[str, str]]:
    """List what an audit checks, smoothness beside its noise floor, and reasons of missing metrics."""
    if row.followed is not None:
        yield "checked of the poses", row.followed
    if row.arms is not None:
        yield (
            "arms",
            f"{' and '.join(row.arms)}, each as one arm, and their collisions; metrics are the worse ones",
        )
    for name in row.metrics.numbers:
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
    details = read_details(row)
    lines = [
        ("noise of the track", _noise(details)),
        ("slow-down needed", _slowdown(row, details, t_s)),
        ("fastest execution", _fastest(row, details, t_s)),
        ("smooth trajectory within all limits", _trajectory(row, details, t_s)),
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


def _noise(details: Details) -> str | None:
    noise = details.noise
    units = [(noise.position_m, 1000.0, "mm"), (noise.rotation_rad, 180.0 / np.pi, "°")]
    text = ", ".join(f"{k * v if v >= _ROUNDING else 0:.4g} {unit}" for v, k, unit in units if v is not None)
    if not text:
        return None
    return f"{text} (assumed: the track is too short for an estimate)" if noise.assumed else text


def _slowdown(row: SampleRow, details: Details, t_s: Array | None) -> str | None:
    factor = row.metrics.slowdown_min
    limit = _format_limit(details.slowdown, t_s)
    if factor is None:
        return None
    least_s = row.metrics.feasible_from_period_s
    period = "" if least_s is None else f"; feasible from a frame period of {least_s:.2g} s"
    return f"{'none, ' if factor <= 1.0 else ''}{factor:.3g}{limit and f', for {limit}'}{period}"


def _fastest(row: SampleRow, details: Details, t_s: Array | None) -> str | None:
    scale = row.metrics.time_scale
    limit = _format_limit(details.time_scale, t_s)
    return None if scale is None else f"{scale:.3g} of its own duration{limit and f', limited by {limit}'}"


def _trajectory(row: SampleRow, details: Details, t_s: Array | None) -> str | None:
    feasible = row.metrics.trajopt_feasible
    radius = row.metrics.trajopt_position_tube_m
    if feasible is None:
        return None
    tube = details.trajopt.tube_limit_m
    obstacle = details.trajopt.against
    bound = "" if tube is None else f" (allowed: {tube * 1000.0:.3g} mm)"
    text = f"within {radius * 1000.0:.3g} mm of the track{bound}" if radius is not None else f"none{bound}"
    if feasible or obstacle is None:
        return text
    value, unit = in_unit(obstacle.kind, obstacle.value)
    limit, _ = in_unit(obstacle.kind, obstacle.limit)
    numbers = f", {value:.4g} against {limit:.4g} {unit}".rstrip() if np.isfinite([value, limit]).all() else ""
    place = LimitPlace(limit=obstacle.kind, joint=obstacle.joint, frame=obstacle.frame)
    return f"{text}; prevented by {_format_limit(place, t_s)}{numbers}"


def _format_limit(place: LimitPlace | None, t_s: Array | None) -> str:
    """Format a limit, its joint and its time; empty if there is none."""
    if place is None or place.limit is None:
        return ""
    when = ""
    if place.frame is not None:
        inside = t_s is not None and 0 <= place.frame < len(t_s)
        when = f" at {t_s[place.frame]:.2f} s" if inside else f" in frame {place.frame}"  # type: ignore[index]
    return f"{place.limit.replace('_', ' ')}{'' if place.joint is None else f' of {place.joint}'}{when}"
