"""How a metric is spread over the samples of a run, by verdict."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from kinebench_drake.geometry import Array
from kinebench_drake.report.metric import Metric
from kinebench_drake.report.plot import ticks
from kinebench_drake.results.aggregate import Estimate

_MOST_BINS, _FEWEST_BINS = 24, 8
_FENCES = 3.0
"""Interquartile ranges beyond the quartiles from which values are far out (Tukey 1977, Exploratory Data Analysis)."""
_FAR = 4.0
"""How many times as wide as without the far ones the values must spread for these to be put at the edge."""
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 430.0, 150.0, 30.0, 10.0, 10.0, 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram:
    """Counts of one metric."""

    metric: Metric
    edges: Array
    """(B + 1,) edges of the bins; the first and the last bin hold what lies beyond them, too."""
    counts: Mapping[str, tuple[int, ...]]
    """(B,) samples in each bin, by verdict."""
    median: float
    below: int
    """Samples below the first edge."""
    above: int
    """Samples above the last edge."""
    estimate: Estimate
    """Mean, interval and coverage."""


def count_values(metric: Metric, values: Sequence[tuple[str, float | None]], estimate: Estimate) -> Histogram | None:
    """Count a metric's values in bins of equal width.

    The bins span the values; where a few lie so far out that the rest would fall into one bin, as ratios of broken
    videos do, they span the rest, and the far ones are counted in the outermost bins.

    Args:
        metric: what is counted.
        values: verdict and value of each sample; None does not count.
        estimate: the values' mean with its interval and coverage.

    Returns:
        The counts; None where fewer than two values differ.
    """
    known = np.array([value for _, value in values if value is not None and np.isfinite(value)])
    if known.size < 2 or np.ptp(known) <= 1e-9 * np.abs(known).max():
        return None
    first, median, third = (float(v) for v in np.quantile(known, (0.25, 0.5, 0.75)))
    low, high = float(known.min()), float(known.max())
    reach = _FENCES * (third - first)
    inside = known[(known >= first - reach) & (known <= third + reach)]
    if 0.0 < _FAR * (inside.max() - inside.min()) < high - low:
        low, high = float(inside.min()), float(inside.max())
    bins = int(np.clip(np.ceil(2.0 * known.size ** (1.0 / 3.0)), _FEWEST_BINS, _MOST_BINS))
    edges = np.linspace(low, high, bins + 1)
    counts = {}
    for verdict in dict.fromkeys(verdict for verdict, _ in values):
        own = [v for told, v in values if told == verdict and v is not None and np.isfinite(v)]
        if own:
            found, _ = np.histogram(np.clip(own, low, high), edges)
            counts[verdict] = tuple(int(n) for n in found)
    return Histogram(
        metric=metric,
        edges=edges,
        counts=counts,
        median=median,
        below=int((known < low).sum()),
        above=int((known > high).sum()),
        estimate=estimate,
    )


def draw_histogram(h: Histogram, names: Mapping[str, str]) -> Markup:
    """Counts as a `<figure>`: bars stacked by verdict, the mean as a line with its interval shaded.

    Args:
        h: the counts.
        names: how verdicts are called.
    """
    low, high = float(h.edges[0]), float(h.edges[-1])
    most = int(np.sum(list(h.counts.values()), axis=0).max())
    floor = _HEIGHT - _BOTTOM

    def x(value: float) -> float:
        return _LEFT + (min(max(value, low), high) - low) / (high - low) * (_WIDTH - _LEFT - _RIGHT)

    def y(count: float) -> float:
        return floor - count / most * (floor - _TOP)

    title = escape(h.metric.label)
    parts = [f'<svg viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img" aria-label="Distribution of {title}">']
    for count in ticks(0.0, most):
        if count == int(count):
            parts.append(f'<path class="grid" d="M{_LEFT:.0f} {y(count):.1f}H{_WIDTH - _RIGHT:.0f}"/>')
            parts.append(f'<text class="tick" x="{_LEFT - 5:.0f}" y="{y(count) + 3.5:.1f}">{count:.0f}</text>')
    pattern = h.metric.pattern if "%" in h.metric.pattern else "{:.4g}"
    for value in ticks(low, high):
        parts.append(f'<text class="tick time" x="{x(value):.1f}" y="{_HEIGHT - 5:.0f}">{pattern.format(value)}</text>')
    parts += _bars(h, names, x, y, pattern)
    mean = h.estimate
    if mean.mean is not None:
        told = f"mean {h.metric.pattern.format(mean.mean)}"
        if mean.low is not None and mean.high is not None:
            told += f", 95% interval {h.metric.pattern.format(mean.low)} to {h.metric.pattern.format(mean.high)}"
            left, right = x(mean.low), x(mean.high)
            parts.append(
                f'<rect class="interval" x="{left:.1f}" y="{_TOP - 6:.0f}" width="{max(right - left, 1.0):.1f}" '
                f'height="{floor - _TOP + 6:.0f}"><title>{told}</title></rect>'
            )
        parts.append(
            f'<path class="mean" d="M{x(mean.mean):.1f} {_TOP - 6:.0f}V{floor:.0f}"><title>{told}</title></path>'
        )
    parts.append("</svg>")
    words = f"median {h.metric.pattern.format(h.median)}; {mean.n} of {mean.total} samples"
    if h.below or h.above:
        words += f", {h.below + h.above} far out, counted at the edge"
    caption = f"<figcaption><b>{title}</b> {words}</figcaption>"
    return Markup(f"<figure>{caption}{''.join(parts)}</figure>")


def _bars(
    h: Histogram, names: Mapping[str, str], x: Callable[[float], float], y: Callable[[float], float], pattern: str
) -> Iterator[str]:
    below = np.zeros(len(h.edges) - 1, dtype=int)
    for verdict, counts in h.counts.items():
        for k, count in enumerate(counts):
            if count:
                left, right = x(float(h.edges[k])), x(float(h.edges[k + 1]))
                base, top = y(float(below[k])), y(float(below[k] + count))
                told = f"{pattern.format(h.edges[k])} to {pattern.format(h.edges[k + 1])}: {count} "
                yield (
                    f'<rect class="bin v-{verdict}" x="{left + 0.5:.1f}" y="{top:.1f}" '
                    f'width="{right - left - 1.0:.1f}" height="{base - top:.1f}">'
                    f"<title>{escape(told + names.get(verdict, verdict))}</title></rect>"
                )
        below += np.array(counts)
