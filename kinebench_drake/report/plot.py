"""Plots as inline SVG, coloured by the page's style sheet: curves over time and histograms of metrics."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from kinebench_drake.errors import count_noun
from kinebench_drake.geometry import Array
from kinebench_drake.report.metric import Metric
from kinebench_drake.report.table import format_interval
from kinebench_drake.results.aggregate import Estimate

WIDTH = 430.0
"""Width of all plots."""
_HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 128.0, 44.0, 8.0, 8.0, 20.0
"""Height and margins of plots over time."""
_MAX_POINTS = 240


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """One line of a plot."""

    label: str
    values: Array
    """(T,) values; NaN interrupts the line."""
    css: str
    """Class of the colour."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSpan:
    """A range of frames with a fault."""

    start: int
    """First frame."""
    end: int
    """Last frame, inclusive."""
    text: str
    """Name of the fault."""


def merge_spans(spans: Iterable[FrameSpan], gap: int = 0) -> list[FrameSpan]:
    """Sort spans, and join those that overlap or lie up to `gap` frames apart."""
    merged: list[FrameSpan] = []
    for span in sorted(spans, key=lambda s: (s.start, s.end, s.text)):
        if merged and span.start <= merged[-1].end + gap:
            last = merged.pop()
            text = last.text if span.text in last.text or len(last.text) > 120 else f"{last.text}, {span.text}"
            span = FrameSpan(start=last.start, end=max(last.end, span.end), text=text)
        merged.append(span)
    return merged


def draw_plot(
    title: str,
    t_s: Array,
    curves: Sequence[Curve],
    bands: Mapping[str, Sequence[FrameSpan]] | None = None,
    *,
    limits: tuple[float, float] | None = None,
    lines: Sequence[float] = (),
) -> Markup:
    """Draw curves over time as one `<figure>`.

    Args:
        title: caption with the unit.
        t_s: (T,) time [s].
        curves: the lines.
        bands: frames to shade behind the curves, by class of the colour.
        limits: range of the vertical axis; None fits the values.
        lines: values to mark, such as limits.
    """
    low, high = limits or _value_range([c.values for c in curves], lines)
    t_first, t_last = float(t_s[0]), float(t_s[-1])
    span = (t_last - t_first) or 1.0
    half_frame = span / max(len(t_s) - 1, 1) / 2.0

    def x(t: float) -> float:
        return _LEFT + (min(max(t, t_first), t_last) - t_first) / span * (WIDTH - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return _TOP + (high - min(max(value, low), high)) / (high - low) * (_HEIGHT - _TOP - _BOTTOM)

    parts = []
    for css, band in ((css, band) for css, some in (bands or {}).items() for band in some):
        start, end = (min(max(frame, 0), len(t_s) - 1) for frame in (band.start, band.end))
        left, right = x(t_s[start] - half_frame), x(t_s[end] + half_frame)
        parts.append(
            f'<rect class="band {css}" x="{left:.1f}" y="{_TOP:.0f}" width="{max(right - left, 1.5):.1f}" '
            f'height="{_HEIGHT - _TOP - _BOTTOM:.0f}"><title>{escape(band.text)}</title></rect>'
        )
    parts += [draw_grid_line(_LEFT, _RIGHT, y(value), f"{value:.4g}") for value in round_ticks(low, high)]
    parts += [draw_tick(x(time), _HEIGHT, f"{time:.4g}") for time in round_ticks(t_first, t_last)]
    parts += [f'<path class="limit" d="M{_LEFT:.0f} {y(line):.1f}H{WIDTH - _RIGHT:.0f}"/>' for line in lines]
    for curve in curves:
        tooltip = f"<title>{escape(curve.label)}</title>" if len(curves) > 1 else ""
        for piece in finite_pieces(t_s, curve.values):
            parts.append(draw_line([(x(t), y(v)) for t, v in piece], curve.css, tooltip))
    key = "".join(f'<span class="key {c.css}">{escape(c.label)}</span>' for c in curves if len(curves) > 1)
    return wrap_svg(parts, _HEIGHT, title, f"{escape(title)}{key}")


def wrap_svg(parts: Iterable[str], height: float, label: str, caption: str, css: str = "") -> Markup:
    """Wrap SVG elements into a `<figure>` with an accessible label (text) and a caption (markup)."""
    svg = f'<svg viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'
    opening = f'<figure class="{css}">' if css else "<figure>"
    return Markup(f"{opening}<figcaption>{caption}</figcaption>{svg}</figure>")


def draw_grid_line(left: float, right: float, y: float, text: str) -> str:
    """Draw a horizontal grid line between two margins, with its value on the left."""
    return (
        f'<path class="grid" d="M{left:.0f} {y:.1f}H{WIDTH - right:.0f}"/>'
        f'<text class="tick" x="{left - 5:.0f}" y="{y + 3.5:.1f}">{text}</text>'
    )


def draw_tick(x: float, height: float, text: str) -> str:
    """Draw a value of the horizontal axis at the bottom of a plot."""
    return f'<text class="tick time" x="{x:.1f}" y="{height - 5:.0f}">{text}</text>'


def draw_line(points: Sequence[tuple[float, float]], css: str, tooltip: str = "") -> str:
    """Draw a line through points; a single point as a dot."""
    if len(points) == 1:
        ((x, y),) = points
        return f'<circle class="dot {css}" cx="{x:.1f}" cy="{y:.1f}" r="1.8"/>'
    text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline class="curve {css}" points="{text}">{tooltip}</polyline>'


def _value_range(values: Sequence[Array], lines: Sequence[float]) -> tuple[float, float]:
    """Return a range that holds all finite values and the marked ones, with a margin, never empty."""
    finite = np.concatenate([*(v[np.isfinite(v)] for v in values), np.asarray(lines, dtype=np.float64)])
    if not finite.size:
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = 0.08 * (high - low) or max(abs(high) * 0.1, 1e-3)
    return low - margin, high + margin


def round_ticks(low: float, high: float) -> list[float]:
    """Return three to six round values within a range."""
    if high <= low:
        return [low]
    step = 10.0 ** np.floor(np.log10((high - low) / 2.0))
    step *= next(m for m in (5.0, 2.0, 1.0) if (high - low) / (step * m) >= 2.0 or m == 1.0)
    first = int(np.ceil(low / step - 1e-9))
    return [float(f"{k * step:.6g}") for k in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def finite_pieces(x: Array, values: Array) -> list[list[tuple[float, float]]]:
    """Split a curve into runs of finite points, thinned where there are more than can be distinguished."""
    kept = _thin(values)
    finite = kept[np.isfinite(values[kept])]
    breaks = np.flatnonzero([not np.isfinite(values[a:b]).all() for a, b in pairwise(finite)])
    runs = np.split(finite, breaks + 1)
    return [[(float(x[k]), float(values[k])) for k in run] for run in runs if len(run)]


def _thin(values: Array) -> NDArray[np.intp]:
    """Return indices of at most _MAX_POINTS values: minimum and maximum of each stretch, so that peaks are kept."""
    n = len(values)
    if n <= _MAX_POINTS:
        return np.arange(n)
    edges = np.linspace(0, n, _MAX_POINTS // 2 + 1).astype(int)
    kept: set[int] = set()
    for start, end in pairwise(edges):
        finite = np.flatnonzero(np.isfinite(values[start:end]))
        if len(finite):
            part = values[start:end][finite]
            kept |= {int(start + finite[np.argmin(part)]), int(start + finite[np.argmax(part)])}
    return np.array(sorted(kept), dtype=np.intp)


_MAX_BINS, _MIN_BINS = 24, 8
_FENCES = 3.0
"""Interquartile ranges beyond the quartiles that make a value an outlier (Tukey 1977, Exploratory Data Analysis)."""
_OUTLIER_SPREAD = 4.0
"""Ratio of the ranges with and without outliers above which these are counted in the outermost bins."""
_H_HEIGHT, _H_LEFT, _H_RIGHT, _H_TOP, _H_BOTTOM = 150.0, 30.0, 10.0, 10.0, 20.0
"""Height and margins of histograms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram:
    """Counts of one metric over the samples of a run, by verdict."""

    metric: Metric
    edges: Array
    """(B + 1,) edges of the bins; the first and the last bin include the outliers beyond them."""
    counts: Mapping[str, tuple[int, ...]]
    """(B,) samples in each bin, by verdict."""
    median: float
    outliers: int
    """Samples beyond the edges."""
    estimate: Estimate
    """Mean, interval and coverage."""


def count_values(metric: Metric, values: Sequence[tuple[str, float | None]], estimate: Estimate) -> Histogram | None:
    """Count a metric's values in bins of equal width.

    The bins span the values without outliers, if these would compress the others into a few bins, as ratios of broken
    videos do.

    Args:
        metric: the metric.
        values: verdict and value of each sample; None is not counted.
        estimate: mean with interval and coverage.

    Returns:
        The counts; None if fewer than two values differ.
    """
    finite = np.array([value for _, value in values if value is not None and np.isfinite(value)])
    if finite.size < 2 or np.ptp(finite) <= 1e-9 * np.abs(finite).max():
        return None
    first, median, third = (float(v) for v in np.quantile(finite, (0.25, 0.5, 0.75)))
    low, high = float(finite.min()), float(finite.max())
    reach = _FENCES * (third - first)
    inside = finite[(finite >= first - reach) & (finite <= third + reach)]
    if 0.0 < _OUTLIER_SPREAD * (inside.max() - inside.min()) < high - low:
        low, high = float(inside.min()), float(inside.max())
    bins = int(np.clip(np.ceil(2.0 * finite.size ** (1.0 / 3.0)), _MIN_BINS, _MAX_BINS))
    edges = np.linspace(low, high, bins + 1)
    counts = {}
    for verdict in dict.fromkeys(verdict for verdict, _ in values):
        own = [v for name, v in values if name == verdict and v is not None and np.isfinite(v)]
        if own:
            counts[verdict] = tuple(int(n) for n in np.histogram(np.clip(own, low, high), edges)[0])
    outliers = int(((finite < low) | (finite > high)).sum())
    return Histogram(metric=metric, edges=edges, counts=counts, median=median, outliers=outliers, estimate=estimate)


def draw_histogram(h: Histogram, names: Mapping[str, str]) -> Markup:
    """Draw counts as a `<figure>`: bars stacked by verdict, the mean as a line with its interval shaded.

    Args:
        h: the counts.
        names: labels of the verdicts.
    """
    low, high = float(h.edges[0]), float(h.edges[-1])
    peak = int(np.sum(list(h.counts.values()), axis=0).max())
    floor = _H_HEIGHT - _H_BOTTOM

    def x(value: float) -> float:
        return _H_LEFT + (min(max(value, low), high) - low) / (high - low) * (WIDTH - _H_LEFT - _H_RIGHT)

    def y(count: float) -> float:
        return floor - count / peak * (floor - _H_TOP)

    def bars() -> Iterator[str]:
        below = np.zeros(len(h.edges) - 1, dtype=int)
        for verdict, counts in h.counts.items():
            for k, count in enumerate(counts):
                if count:
                    left, right = x(float(h.edges[k])), x(float(h.edges[k + 1]))
                    base, top = y(float(below[k])), y(float(below[k] + count))
                    span = f"{pattern.format(h.edges[k])} to {pattern.format(h.edges[k + 1])}"
                    yield (
                        f'<rect class="bin v-{verdict}" x="{left + 0.5:.1f}" y="{top:.1f}" '
                        f'width="{right - left - 1.0:.1f}" height="{base - top:.1f}">'
                        f"<title>{escape(f'{span}: {count} {names.get(verdict, verdict)}')}</title></rect>"
                    )
            below += np.array(counts)

    pattern = h.metric.pattern if "%" in h.metric.pattern else "{:.4g}"
    steps = [count for count in round_ticks(0.0, peak) if count == int(count)]
    parts = [draw_grid_line(_H_LEFT, _H_RIGHT, y(count), f"{count:.0f}") for count in steps]
    parts += [draw_tick(x(value), _H_HEIGHT, pattern.format(value)) for value in round_ticks(low, high)]
    parts += bars()
    mean = h.estimate
    if mean.mean is not None:
        tooltip = f"mean {h.metric.pattern.format(mean.mean)}"
        if mean.low is not None and mean.high is not None:
            tooltip += f", 95% interval {format_interval(mean, h.metric.pattern)}"
            left, right = x(mean.low), x(mean.high)
            parts.append(
                f'<rect class="interval" x="{left:.1f}" y="{_H_TOP - 6:.0f}" width="{max(right - left, 1.0):.1f}" '
                f'height="{floor - _H_TOP + 6:.0f}"><title>{tooltip}</title></rect>'
            )
        line = f"M{x(mean.mean):.1f} {_H_TOP - 6:.0f}V{floor:.0f}"
        parts.append(f'<path class="mean" d="{line}"><title>{tooltip}</title></path>')
    text = f"median {h.metric.pattern.format(h.median)}; {mean.n} of {count_noun(mean.total, 'sample')}"
    if h.outliers:
        text += f", {count_noun(h.outliers, 'outlier')} counted in the outermost bins"
    label = h.metric.label
    return wrap_svg(parts, _H_HEIGHT, f"Distribution of {label}", f"<b>{escape(label)}</b> {text}")
