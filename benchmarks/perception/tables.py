"""Measurements as tables of text."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from benchmarks.markdown import table
from benchmarks.perception.errors import ClipErrors
from benchmarks.perception.summary import (
    ACCURACY,
    MORE,
    Reliability,
    Results,
    intervals,
    percentile,
    summarize,
)
from kinebench_drake.anomaly import Anomaly
from kinebench_drake.stats import IntervalEstimate

COMPARED = {
    "tracked_when_seen": "tracked",
    "position_median_mm": "mm median",
    "position_p95_mm": "mm p95",
    "rotation_median_deg": "deg median",
    "rotation_p95_deg": "deg p95",
    "tracked_frames_off_by_3_cm": "off by > 3 cm",
}
"""Columns of comparisons and their headings; tracked: of the frames that show at least 30 % of the gripper."""
_SHARES = frozenset({"tracked_fraction", "tracked_when_seen", "tracked_frames_off_by_3_cm"})


def video_line(e: ClipErrors) -> str:
    """Return the errors of one clip as one line; frames are 0-based."""
    position, rotation = (v[np.isfinite(v)] for v in (e.position_m * 1e3, np.rad2deg(e.rotation_rad)))
    parts = (
        f"{e.id:34s} tracked {e.tracked_fraction:.3f}",
        f"mm {percentile(position, 50):5.2f} {percentile(position, 95):6.2f}",
        f"deg {percentile(rotation, 50):5.2f} {percentile(rotation, 95):6.2f}",
        f"flip {e.longest_flip}  {e.cpu_s:4.1f} s",
        f"planted {_ranges(e.planted)}; found {_ranges(e.detected)}",
    )
    return "  ".join(parts)


def _ranges(anomalies: Sequence[Anomaly]) -> str:
    return ", ".join(f"{a.kind.value} {a.frame_start}-{a.frame_end}" for a in anomalies) or "-"


def by_task(results: Results) -> dict[str, list[ClipErrors]]:
    """Return the clips of each task, sorted by task."""
    groups: dict[str, list[ClipErrors]] = {}
    for e in results:
        groups.setdefault(e.task or "-", []).append(e)
    return dict(sorted(groups.items()))


def task_table(results: Results) -> list[str]:
    """Return one line per task."""
    columns = {
        "videos": "videos",
        "tracked_fraction": "tracked",
        **{name: heading for name, heading in COMPARED.items() if name.startswith(("position", "rotation"))},
        "finger_width_median_mm": "gap mm",
        "open_or_closed_right": "open/closed",
        "lasting_flips": "flips",
        "tracked_frames_off_by_3_cm": "off by > 3 cm",
    }
    rows = []
    for task, group in by_task(results).items():
        figures = summarize(group)
        rows.append([task, *(_number(name, figures[name]) for name in columns)])
    return table(["task", *columns.values()], rows)


def pooled_lines(results: Results, seed: int) -> Iterator[str]:
    """Yield all figures of all clips together, one a line; those over frames with intervals."""
    ranges = intervals(results, {**ACCURACY, **MORE}, seed)
    for name, value in summarize(results).items():
        at = ranges.get(name)
        between = f"  [{at.low:.4g}, {at.high:.4g}]" if at is not None and np.isfinite([at.low, at.high]).all() else ""
        yield f"{name:32s} {value:.4g}{between}"


def reliability_lines(curve: Reliability) -> Iterator[str]:
    """Yield the reliability curve, one bin a line."""
    yield f"expected calibration error {curve.error:.3f} over tracked frames"
    rows = [
        [f"{b.low:.1f}-{b.high:.1f}", str(b.frames), f"{b.confidence:.3f}", f"{b.good:.3f}",
         f"[{b.good_low:.3f}, {b.good_high:.3f}]"]
        for b in curve.bins
    ]  # fmt: skip
    yield from table(["confidence", "frames", "mean", "within 10 mm, 5 deg", "95 %"], rows)


def compared(results: Mapping[str, Results], seed: int) -> dict[str, dict[str, IntervalEstimate]]:
    """Return the figures of each condition that `comparison_table` shows."""
    chosen = {name: ACCURACY[name] for name in COMPARED}
    return {name: intervals(group, chosen, seed) for name, group in results.items()}


def comparison_table(figures: Mapping[str, Mapping[str, IntervalEstimate]]) -> list[str]:
    """Return one line per condition, its figures (see `compared`) with their intervals."""
    rows = [[name, *(_with_interval(column, row[column]) for column in COMPARED)] for name, row in figures.items()]
    return table(["", *COMPARED.values()], rows)


def _with_interval(name: str, figure: IntervalEstimate) -> str:
    value = _number(name, figure.value)
    if not np.isfinite([figure.low, figure.high]).all():
        return value
    return f"{value} [{_number(name, figure.low)}, {_number(name, figure.high)}]"


def _number(name: str, value: float) -> str:
    if not np.isfinite(value):
        return "-"
    if name in ("videos", "lasting_flips"):
        return f"{value:.0f}"
    return f"{value:.3f}" if name in _SHARES or name == "open_or_closed_right" else f"{value:.2f}"
