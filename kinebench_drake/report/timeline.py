"""When a sample goes wrong: its frames on an axis, violations, anomalies and lost frames as bars."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup, escape

from kinebench_drake.geometry import Array
from kinebench_drake.report.frames import SURE, anomalies_of
from kinebench_drake.report.plot import ticks
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.segments import segments
from kinebench_drake.types import Json

_WIDTH, _LEFT, _RIGHT, _LANE, _BAR, _BOTTOM = 430.0, 118.0, 8.0, 19.0, 11.0, 20.0
_STRIP_WIDTH, _STRIP_HEIGHT = 150.0, 9.0
_LEAST = 3.0
"""Width of the shortest bar, which would vanish otherwise."""
LEGEND = {
    "violation": "limit broken",
    "anomaly": "visual anomaly",
    "lost": "gripper not tracked",
    "unsure": "pose doubtful",
}
"""Classes of bars and what they mean."""
_OVER = ("unsure", "lost", "anomaly", "violation")
"""The same as a strip lays them one over another: the worst last."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Span:
    """A range of frames at fault."""

    start: int
    """First frame."""
    end: int
    """Last frame, inclusive."""
    text: str
    """What is wrong there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """All spans of one fault."""

    label: str
    css: str
    """A key of LEGEND."""
    spans: tuple[Span, ...]


def lanes_of(row: SampleRow, file: TrackFile | None) -> list[Lane]:
    """What goes wrong in a sample, a lane a kind: limits broken, visual anomalies, frames lost, frames doubtful."""
    lanes = [*_lanes(row.violations, "violation"), *_lanes(anomalies_of(row), "anomaly")]
    if file is not None:
        on = file.track.tracked.astype(bool)
        doubtful = on & (file.track.confidence < SURE)
        for label, css, mask in (("not tracked", "lost", ~on), ("doubtful", "unsure", doubtful)):
            spans = tuple(Span(start=s.start, end=s.stop - 1, text=LEGEND[css]) for s in segments(mask))
            if spans:
                lanes.append(Lane(label=label, css=css, spans=spans))
    return lanes


def frame_count(row: SampleRow, file: TrackFile | None, lanes: Sequence[Lane]) -> int:
    """Frames of a sample: those of its track, else as many as its row tells, else as far as faults reach."""
    if file is not None:
        return len(file.track.t_s)
    told = row.extra.get("frames")
    return max([told if isinstance(told, int) else 1, *(span.end + 1 for lane in lanes for span in lane.spans)])


def draw_timeline(lanes: Sequence[Lane], n: int, t_s: Array | None = None) -> Markup:
    """Lanes over frames as one `<figure>`.

    Args:
        lanes: what goes wrong.
        n: number of frames.
        t_s: (n,) time of each [s], told beside the frames; None where unknown.
    """
    height = _LANE * len(lanes) + _BOTTOM + 4.0
    wide = _WIDTH - _LEFT - _RIGHT
    parts = [f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" aria-label="Faults over frames">']
    for frame in ticks(0.0, max(n - 1, 1)):
        if frame == int(frame):
            x = _LEFT + (frame + 0.5) / n * wide
            parts.append(f'<path class="grid" d="M{x:.1f} 2V{height - _BOTTOM:.1f}"/>')
            parts.append(f'<text class="tick time" x="{x:.1f}" y="{height - 6:.1f}">{frame:.0f}</text>')
    for k, lane in enumerate(lanes):
        top = 2.0 + k * _LANE
        parts.append(f'<text class="tick" x="{_LEFT - 6:.0f}" y="{top + 12:.1f}">{escape(lane.label)}</text>')
        parts.append(f'<rect class="rail" x="{_LEFT:.0f}" y="{top + 3:.1f}" width="{wide:.0f}" height="{_BAR:.0f}"/>')
        for span in _merged(lane.spans, int(n / wide)):
            told = f"{span.text}, {_when(span, t_s)}"
            parts.append(_bar(span, n, _LEFT, wide, top + 3.0, _BAR, lane.css, told))
    key = "".join(
        f'<span class="lamp {css}">{text}</span>' for css, text in LEGEND.items() if any(x.css == css for x in lanes)
    )
    parts.append("</svg>")
    return Markup(
        f'<figure class="timeline"><figcaption>When it goes wrong [frames]{key}</figcaption>{"".join(parts)}</figure>'
    )


def draw_strip(lanes: Sequence[Lane], n: int) -> Markup:
    """All lanes as one thin strip, the graver over the lesser."""
    parts = [
        f'<svg class="strip" viewBox="0 0 {_STRIP_WIDTH:.0f} {_STRIP_HEIGHT:.0f}" preserveAspectRatio="none" '
        f'role="img" aria-label="faults over frames"><rect class="rail" width="{_STRIP_WIDTH:.0f}" '
        f'height="{_STRIP_HEIGHT:.0f}"/>'
    ]
    for css in _OVER:
        for lane in lanes:
            if lane.css == css:
                parts += [
                    _bar(span, n, 0.0, _STRIP_WIDTH, 0.0, _STRIP_HEIGHT, css, f"{lane.label}, {_when(span, None)}")
                    for span in _merged(lane.spans, int(n / _STRIP_WIDTH))
                ]
    return Markup(f"{''.join(parts)}</svg>")


def _lanes(marks: Sequence[Mapping[str, Json]], css: str) -> Iterator[Lane]:
    kinds: dict[str, list[Span]] = {}
    for mark in marks:
        start, end = mark.get("frame_start"), mark.get("frame_end")
        if isinstance(start, int) and isinstance(end, int) and end >= 0:
            kind = str(mark.get("kind")).replace("_", " ")
            joint = mark.get("joint")
            text = kind if joint is None else f"{kind} of {joint}"
            kinds.setdefault(kind, []).append(Span(start=max(start, 0), end=end, text=text))
    for kind, spans in kinds.items():
        yield Lane(label=kind, css=css, spans=tuple(_merged(spans)))


def _merged(spans: Sequence[Span], gap: int = 0) -> list[Span]:
    """Spans in order, those that overlap or lie up to `gap` frames apart as one: thousands of faults are a few bars."""
    merged: list[Span] = []
    for span in sorted(spans, key=lambda s: (s.start, s.end, s.text)):
        if merged and span.start <= merged[-1].end + gap:
            last = merged.pop()
            text = last.text if span.text in last.text or len(last.text) > 120 else f"{last.text}, {span.text}"
            span = Span(start=last.start, end=max(last.end, span.end), text=text)
        merged.append(span)
    return merged


def _bar(span: Span, n: int, left: float, wide: float, top: float, tall: float, css: str, told: str) -> str:
    start, end = (min(max(frame, 0), n - 1) for frame in (span.start, span.end))
    width = max((end + 1 - start) / n * wide, _LEAST)
    x = min(left + start / n * wide, left + wide - width)
    return (
        f'<rect class="bar-{css}" x="{x:.1f}" y="{top:.1f}" width="{width:.1f}" height="{tall:.0f}">'
        f"<title>{escape(told)}</title></rect>"
    )


def _when(span: Span, t_s: Array | None) -> str:
    frames = f"frame {span.start}" if span.start == span.end else f"frames {span.start} to {span.end}"
    if t_s is None or span.end >= len(t_s):
        return frames
    return f"{frames} ({t_s[span.start]:.2f} to {t_s[span.end]:.2f} s)"
