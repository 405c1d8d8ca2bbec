"""Faults of a sample over its frames: the state of each frame; violations, anomalies and lost frames as bars."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.geometry import Array
from kinebench_drake.report.limit_table import format_frames, joint_limits, limit_ratios
from kinebench_drake.report.plot import WIDTH, FrameSpan, merge_spans, render_plot, round_ticks
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import segments
from kinebench_drake.track import IkStatus
from kinebench_drake.violation import Violation

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


def covered_frames(marks: Iterable[Violation | Anomaly], n: int) -> NDArray[np.bool_]:
    """Return which of n frames any of some violations or anomalies covers."""
    covered = np.zeros(n, dtype=bool)
    for mark in marks:
        covered[max(mark.frame_start, 0) : max(mark.frame_end + 1, 0)] = True
    return covered


def frame_states(row: SampleRow, file: TrackFile) -> tuple[FrameState, ...]:
    """Return the state of each of the T frames."""
    track = file.track
    n = len(file.track.t_s)
    doubt = covered_frames(row.anomalies, n) | (track.confidence < MIN_CONFIDENCE)
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
    lanes = [*_marked_lanes(row.violations, "violation"), *_marked_lanes(row.anomalies, "anomaly")]
    if file is not None:
        on = file.track.tracked.astype(bool)
        doubtful = on & (file.track.confidence < MIN_CONFIDENCE)
        for label, css, mask in (("not tracked", "lost", ~on), ("doubtful", "unsure", doubtful)):
            spans = tuple(FrameSpan(start=s.start, end=s.stop - 1, text=LEGEND[css]) for s in segments(mask))
            if spans:
                lanes.append(FaultLane(label=label, css=css, spans=spans))
    return lanes


def _marked_lanes(marks: Iterable[Violation | Anomaly], css: str) -> Iterator[FaultLane]:
    kinds: dict[str, list[FrameSpan]] = {}
    for mark in marks:
        kind = mark.kind.value.replace("_", " ")
        joint = mark.joint if isinstance(mark, Violation) else None
        text = kind if joint is None else f"{kind} of {joint}"
        span = FrameSpan(start=max(mark.frame_start, 0), end=mark.frame_end, text=text)
        kinds.setdefault(kind, []).append(span)
    for kind, spans in kinds.items():
        yield FaultLane(label=kind, css=css, spans=tuple(merge_spans(spans)))


def frame_count(row: SampleRow, file: TrackFile | None, lanes: Sequence[FaultLane]) -> int:
    """Return the number of frames of a sample: of its track, else of its row, but at least up to the last fault."""
    if file is not None:
        return len(file.track.t_s)
    return max([row.frames or 1, *(span.end + 1 for lane in lanes for span in lane.spans)])


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
