"""Plots of plots.html.j2: curves over time and histograms of metrics."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from kinebench_drake.errors import count_noun
from kinebench_drake.geometry import Array
from kinebench_drake.report.metric import Metric
from kinebench_drake.report.table import format_interval, template_environment
from kinebench_drake.results.aggregate import Estimate

WIDTH = 430.0
"""Width of all plots."""
_HEIGHT = 128.0
_LEFT = 44.0
_RIGHT = WIDTH - 8.0
_TOP = 8.0
_BOTTOM = 108.0
"""Height of plots over time, and ends of their axes."""
_MAX_POINTS = 240


@cache
def _load_macros() -> Any:
    templates = template_environment()
    templates.filters["px"] = lambda value, digits=1: f"{value:.{digits}f}"
    templates.filters["points"] = lambda points: " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return templates.get_template("plots.html.j2", globals={"width": WIDTH}).module


def render_plot(macro: str, **values: object) -> Markup:
    """Render a macro of plots.html.j2."""
    return Markup(getattr(_load_macros(), macro)(**values))


@dataclass(frozen=True, slots=True)
class Axis:
    """Linear axis from values to places in a drawing; values beyond its ends are drawn at them."""

    first: float
    last: float
    start: float
    """Place of `first`."""
    end: float
    """Place of `last`."""

    def __call__(self, value: float) -> float:
        """Return the place of a value."""
        inside = min(max(value, min(self.first, self.last)), max(self.first, self.last))
        return self.start + (inside - self.first) / ((self.last - self.first) or 1.0) * (self.end - self.start)

    def ticks(self, pattern: str = "{:.4g}") -> list[tuple[float, str]]:
        """Return places and texts of three to six round values."""
        values = round_ticks(min(self.first, self.last), max(self.first, self.last))
        return [(self(value), pattern.format(value)) for value in values]


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
    """Draw curves over time as a `<figure>`.

    Args:
        t_s: (T,) time [s].
        bands: frames to shade behind the curves, by class of the colour.
        limits: range of the vertical axis; None fits the values.
    """
    low, high = limits or _value_range([c.values for c in curves], lines)
    x = Axis(float(t_s[0]), float(t_s[-1]), _LEFT, _RIGHT)
    y = Axis(high, low, _TOP, _BOTTOM)
    half_frame = ((x.last - x.first) or 1.0) / max(len(t_s) - 1, 1) / 2.0

    def shade(css: str, band: FrameSpan) -> tuple[str, float, float, str]:
        start, end = (min(max(frame, 0), len(t_s) - 1) for frame in (band.start, band.end))
        left = x(t_s[start] - half_frame)
        right = x(t_s[end] + half_frame)
        return css, left, max(right - left, 1.5), band.text

    return render_plot(
        "plot",
        title=title,
        **{"height": _HEIGHT, "left": _LEFT, "right": _RIGHT, "top": _TOP, "bottom": _BOTTOM},
        bands=[shade(css, band) for css, own in (bands or {}).items() for band in own],
        lines=y.ticks(),
        ticks=x.ticks(),
        limits=[y(line) for line in lines],
        curves=curves,
        pieces=[
            (curve, [(x(t), y(value)) for t, value in piece])
            for curve in curves
            for piece in finite_pieces(t_s, curve.values)
        ],
    )


def _value_range(values: Sequence[Array], lines: Sequence[float]) -> tuple[float, float]:
    """Return a range that holds all finite values and the marked ones, with a margin, never empty."""
    finite = np.concatenate([*(v[np.isfinite(v)] for v in values), np.asarray(lines, dtype=np.float64)])
    if not finite.size:
        return 0.0, 1.0
    low = float(finite.min())
    high = float(finite.max())
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


_MAX_BINS = 24
_MIN_BINS = 8
_H_HEIGHT = 150.0
_H_LEFT = 30.0
_H_RIGHT = WIDTH - 10.0
_H_TOP = 10.0
_H_BOTTOM = 130.0
"""Height of histograms, and ends of their axes."""


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
        values: verdict and value of each sample; None is not counted.

    Returns:
        The counts; None if fewer than two values differ.
    """
    finite = np.array([value for _, value in values if value is not None and np.isfinite(value)])
    if finite.size < 2 or np.ptp(finite) <= 1e-9 * np.abs(finite).max():
        return None
    first, median, third = (float(v) for v in np.quantile(finite, (0.25, 0.5, 0.75)))
    low = float(finite.min())
    high = float(finite.max())
    # 3.0: interquartile ranges beyond the quartiles that make a value an outlier (Tukey 1977, Exploratory Data
    # Analysis)
    reach = 3.0 * (third - first)
    inside = finite[(finite >= first - reach) & (finite <= third + reach)]
    # 4.0: ratio of the ranges with and without outliers above which these are counted in the outermost bins
    if 0.0 < 4.0 * (inside.max() - inside.min()) < high - low:
        low = float(inside.min())
        high = float(inside.max())
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
    """Draw counts as a `<figure>`: bars stacked by verdict, the mean as a line with its interval shaded."""
    peak = int(np.sum(list(h.counts.values()), axis=0).max())
    x = Axis(float(h.edges[0]), float(h.edges[-1]), _H_LEFT, _H_RIGHT)
    y = Axis(0.0, peak, _H_BOTTOM, _H_TOP)
    pattern = h.metric.pattern if "%" in h.metric.pattern else "{:.4g}"

    def bins() -> Iterator[tuple[str, float, float, float, float, str]]:
        below = np.zeros(len(h.edges) - 1, dtype=int)
        for verdict, counts in h.counts.items():
            for k, count in enumerate(counts):
                if count:
                    left = x(float(h.edges[k]))
                    right = x(float(h.edges[k + 1]))
                    base = y(float(below[k]))
                    top = y(float(below[k] + count))
                    span = f"{pattern.format(h.edges[k])} to {pattern.format(h.edges[k + 1])}"
                    text = f"{span}: {count} {names.get(verdict, verdict)}"
                    yield verdict, left + 0.5, top, right - left - 1.0, base - top, text
            below += np.array(counts)

    e = h.estimate
    interval = None
    tooltip = ""
    if e.mean is not None:
        tooltip = f"mean {h.metric.pattern.format(e.mean)}"
        if e.low is not None and e.high is not None:
            tooltip += f", 95% interval {format_interval(e, h.metric.pattern)}"
            interval = x(e.low), max(x(e.high) - x(e.low), 1.0)
    note = f"median {h.metric.pattern.format(h.median)}; {e.n} of {count_noun(e.total, 'sample')}"
    if h.outliers:
        note += f", {count_noun(h.outliers, 'outlier')} counted in the outermost bins"
    return render_plot(
        "histogram",
        label=h.metric.label,
        note=note,
        **{"height": _H_HEIGHT, "left": _H_LEFT, "right": _H_RIGHT, "top": _H_TOP, "bottom": _H_BOTTOM},
        lines=[(y(count), f"{count:.0f}") for count in round_ticks(0.0, peak) if count == int(count)],
        ticks=x.ticks(pattern),
        bins=bins(),
        mean=None if e.mean is None else x(e.mean),
        interval=interval,
        tooltip=tooltip,
    )
