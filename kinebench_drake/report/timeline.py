"""Faults of a sample over its frames: the state of each frame; violations, anomalies and lost frames as bars."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.geometry import Array
from kinebench_drake.io.jsonl import Json
from kinebench_drake.report.limit_table import format_frames, joint_limits, limit_ratios
from kinebench_drake.report.plot import WIDTH, FrameSpan, merge_spans, render_plot, round_ticks
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import segments
from kinebench_drake.track import IkStatus

MIN_CONFIDENCE = 0.5
"""Confidence below which a pose is doubtful."""
SEVERITY_UNITS = {
    AnomalyKind.VANISH.value: "frames",
    AnomalyKind.DUPLICATE.value: "of a gripper",
    AnomalyKind.TELEPORT.value: "m",
    AnomalyKind.FREEZE.value: "frames",
    AnomalyKind.CAMERA.value: "px",
    AnomalyKind.FINGERS.value: "m",
}
"""Unit of the severity by kind of anomaly; that of the others is relative."""
LEGEND = {
    "violation": "limit broken",
    "anomaly": "visual anomaly",
    "lost": "gripper not tracked",
    "unsure": "pose doubtful",
}
"""Classes of bars and their meaning, the most severe first."""
_LEFT = 118.0
_RIGHT = WIDTH - 8.0
_LANE = 19.0
_STRIP_WIDTH = 150.0
_STRIP_HEIGHT = 9.0


class FrameState(Enum):
    """State of a frame, by rising precedence."""

    OK = "ok"
    DOUBT = "doubt"
    """A limit is exceeded, or the pose missed, by no more than the noise explains; or the pose itself is doubtful."""
    UNTRACKED = "untracked"
    BROKEN = "broken"
    """Covered by a violation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultLane:
    """All spans of one fault."""

    label: str
    css: str
    """A key of LEGEND."""
    spans: tuple[FrameSpan, ...]


def anomalies_of(row: SampleRow) -> list[Mapping[str, Json]]:
    """Return the row's visual anomalies that have kind, frames and a numeric severity (or none)."""
    anomalies = row.metrics.get("anomalies")
    if not isinstance(anomalies, Sequence) or isinstance(anomalies, str):
        return []
    return [
        a
        for a in anomalies
        if isinstance(a, Mapping)
        and isinstance(a.get("kind"), str)
        and all(isinstance(a.get(key), int) for key in ("frame_start", "frame_end"))
        and isinstance(a.get("severity"), int | float | None)
    ]


def covered_frames(marks: Sequence[Mapping[str, Json]], n: int) -> NDArray[np.bool_]:
    """Return which of n frames any of some violations or anomalies covers."""
    covered = np.zeros(n, dtype=bool)
    for mark in marks:
        start = mark.get("frame_start")
        end = mark.get("frame_end")
        if isinstance(start, int) and isinstance(end, int):
            covered[max(start, 0) : max(end + 1, 0)] = True
    return covered


def frame_states(row: SampleRow, file: TrackFile) -> tuple[FrameState, ...]:
    """Return the state of each of the T frames."""
    track = file.track
    n = len(file.track.t_s)
    doubt = covered_frames(anomalies_of(row), n) | (track.confidence < MIN_CONFIDENCE)
    for ratio in limit_ratios(file, joint_limits(row)).values():
        doubt |= (np.nan_to_num(ratio) > 1.0).any(axis=-1)
    for name in ("joint_margin", "self_distance_m", "table_distance_m"):
        if name in file.curves:
            doubt |= np.nan_to_num(file.curves[name]) < 0.0
    if file.status is not None:
        doubt |= np.array([s not in (IkStatus.OK, IkStatus.NOT_TRACKED) for s in file.status], dtype=bool)
    broken = covered_frames(row.violations, n)
    states = np.full(n, FrameState.OK, dtype=object)
    for mask, state in ((doubt, FrameState.DOUBT), (~track.tracked, FrameState.UNTRACKED), (broken, FrameState.BROKEN)):
        states[mask] = state
    return tuple(states)


def fault_lanes(row: SampleRow, file: TrackFile | None) -> list[FaultLane]:
    """List the faults of a sample, a lane per kind: violations, visual anomalies, lost frames, doubtful frames."""
    lanes = [*_marked_lanes(row.violations, "violation"), *_marked_lanes(anomalies_of(row), "anomaly")]
    if file is not None:
        on = file.track.tracked.astype(bool)
        doubtful = on & (file.track.confidence < MIN_CONFIDENCE)
        for label, css, mask in (("not tracked", "lost", ~on), ("doubtful", "unsure", doubtful)):
            spans = tuple(FrameSpan(start=s.start, end=s.stop - 1, text=LEGEND[css]) for s in segments(mask))
            if spans:
                lanes.append(FaultLane(label=label, css=css, spans=spans))
    return lanes


def _marked_lanes(marks: Sequence[Mapping[str, Json]], css: str) -> Iterator[FaultLane]:
    kinds: dict[str, list[FrameSpan]] = {}
    for mark in marks:
        start = mark.get("frame_start")
        end = mark.get("frame_end")
        if isinstance(start, int) and isinstance(end, int) and end >= 0:
            kind = str(mark.get("kind")).replace("_", " ")
            joint = mark.get("joint")
            text = kind if joint is None else f"{kind} of {joint}"
            kinds.setdefault(kind, []).append(FrameSpan(start=max(start, 0), end=end, text=text))
    for kind, spans in kinds.items():
        yield FaultLane(label=kind, css=css, spans=tuple(merge_spans(spans)))


def frame_count(row: SampleRow, file: TrackFile | None, lanes: Sequence[FaultLane]) -> int:
    """Return the number of frames of a sample: of its track, else of its row, but at least up to the last fault."""
    if file is not None:
        return len(file.track.t_s)
    frames = row.extra.get("frames")
    return max([frames if isinstance(frames, int) else 1, *(span.end + 1 for lane in lanes for span in lane.spans)])


def draw_timeline(lanes: Sequence[FaultLane], n: int, t_s: Array | None = None) -> Markup:
    """Draw lanes over frames as a `<figure>`.

    Args:
        t_s: (n,) time [s], shown beside the frames; None if unknown.
    """
    height = _LANE * len(lanes) + 24.0
    wide = _RIGHT - _LEFT
    frames = [frame for frame in round_ticks(0.0, max(n - 1, 1)) if frame == int(frame)]
    spans = [
        [
            (*_place_bar(span, n, _LEFT, wide), f"{span.text}, {_format_frames(span, t_s)}")
            for span in merge_spans(lane.spans, int(n / wide))
        ]
        for lane in lanes
    ]
    return render_plot(
        "timeline",
        **{"height": height, "left": _LEFT, "right": _RIGHT, "bottom": height - 20.0},
        ticks=[(_LEFT + (frame + 0.5) / n * wide, f"{frame:.0f}") for frame in frames],
        lanes=[(lane.label, lane.css, 2.0 + k * _LANE, spans[k]) for k, lane in enumerate(lanes)],
        legend=[(css, text) for css, text in LEGEND.items() if any(lane.css == css for lane in lanes)],
    )


def draw_strip(lanes: Sequence[FaultLane], n: int) -> Markup:
    """Draw all lanes as one thin strip, the most severe on top."""
    spans = [
        (css, [(*_place_bar(span, n, 0.0, _STRIP_WIDTH), f"{lane.label}, {_format_frames(span)}") for span in merged])
        for css in reversed(LEGEND)
        for lane in lanes
        if lane.css == css
        for merged in [merge_spans(lane.spans, int(n / _STRIP_WIDTH))]
    ]
    return render_plot("strip", wide=_STRIP_WIDTH, tall=_STRIP_HEIGHT, lanes=spans)


def _place_bar(span: FrameSpan, n: int, left: float, wide: float) -> tuple[float, float]:
    """Return left end and width of a span of n frames."""
    start, end = (min(max(frame, 0), n - 1) for frame in (span.start, span.end))
    width = max((end + 1 - start) / n * wide, 3.0)  # width of the shortest bar, which would otherwise be invisible
    return min(left + start / n * wide, left + wide - width), width


def _format_frames(span: FrameSpan, t_s: Array | None = None) -> str:
    frames = format_frames(span.start, span.end)
    if t_s is None or span.end >= len(t_s):
        return frames
    return f"{frames} ({t_s[span.start]:.2f} to {t_s[span.end]:.2f} s)"
