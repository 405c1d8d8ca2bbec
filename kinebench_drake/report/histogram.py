"""Distribution of a metric over the samples of a run, by verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from kinebench_drake.errors import count_noun
from kinebench_drake.geometry import Array
from kinebench_drake.io.figure import FAINT, new_figure
from kinebench_drake.report.figures import INK, NEUTRAL, VERDICT_COLOURS, inline_figure
from kinebench_drake.report.metric import Metric
from kinebench_drake.results.aggregate import Estimate, group_by

_MAX_BINS = 24
_MIN_BINS = 8
_OUTLIER_REACH = 3.0
"""Interquartile ranges beyond the quartiles that make a value an outlier (Tukey 1977, Exploratory Data Analysis)."""
_COMPRESSION = 4.0
"""Ratio of the ranges with and without outliers above which these are counted in the outermost bins: they would
compress the other values into a few bins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Histogram:
    """Counts of one metric over the samples of a run, by verdict."""

    metric: Metric
    edges: Array
    """(B + 1,) edges of the bins; the first and the last bin include the outliers beyond them."""
    counts: Mapping[str, Array]
    """(B,) samples in each bin, by verdict."""
    median: float
    outliers: int
    """Samples beyond the edges."""
    estimate: Estimate
    """Mean, interval and coverage."""

    @property
    def note(self) -> str:
        """Median, coverage and outliers."""
        note = f"median {self.metric.pattern.format(self.median)}; {self.estimate.n} of "
        note += count_noun(self.estimate.total, "sample")
        return note + f", {count_noun(self.outliers, 'outlier')} counted in the outermost bins" * (self.outliers > 0)

    @property
    def drawing(self) -> Markup:
        """Bars stacked by verdict; the mean as a line, with its interval shaded."""
        figure, axes = new_figure(3.4, 1.45)
        ax = axes[0, 0]
        below = np.zeros(len(self.edges) - 1)
        for verdict, counts in self.counts.items():
            colour = VERDICT_COLOURS.get(verdict, NEUTRAL)
            some = counts > 0
            width = 0.92 * np.diff(self.edges)[some]
            ax.bar(self.edges[:-1][some], counts[some], width, below[some], align="edge", color=colour)
            below += counts
        if self.estimate.mean is not None:
            ax.axvline(self.estimate.mean, color=INK, linewidth=1.2)
        if self.estimate.low is not None and self.estimate.high is not None:
            ax.axvspan(self.estimate.low, self.estimate.high, color=INK, alpha=0.12, linewidth=0.0, zorder=0.5)
        ax.set_xlim(self.edges[0], self.edges[-1])
        ax.locator_params(axis="y", nbins=4, integer=True)
        ax.locator_params(axis="x", nbins=5)
        if "%" in self.metric.pattern:
            ax.xaxis.set_major_formatter("{x:.0%}")
        ax.grid(visible=False, axis="x")
        ax.tick_params(length=0)
        ax.spines[["left", "bottom"]].set_color(FAINT)
        return inline_figure(figure, self.metric.name, f"Distribution of {self.metric.label}")


def count_values(metric: Metric, values: Sequence[tuple[str, float | None]], estimate: Estimate) -> Histogram | None:
    """Count a metric's values in bins of equal width.

    Args:
        values: verdict and value of each sample; None is not counted.

    Returns:
        The counts; None if fewer than two values differ.
    """
    measured = [(verdict, value) for verdict, value in values if value is not None and np.isfinite(value)]
    finite = np.array([value for _, value in measured])
    if finite.size < 2 or np.ptp(finite) <= 1e-9 * np.abs(finite).max():
        return None
    first, median, third = (float(v) for v in np.quantile(finite, (0.25, 0.5, 0.75)))
    reach = _OUTLIER_REACH * (third - first)
    inside = finite[(finite >= first - reach) & (finite <= third + reach)]
    compressed = 0.0 < _COMPRESSION * np.ptp(inside) < np.ptp(finite)
    shown = inside if compressed else finite
    bins = int(np.clip(np.ceil(2.0 * finite.size ** (1.0 / 3.0)), _MIN_BINS, _MAX_BINS))
    edges = np.linspace(shown.min(), shown.max(), bins + 1)
    groups = group_by(measured, lambda pair: pair[0])
    clipped = {verdict: np.clip([v for _, v in own], edges[0], edges[-1]) for verdict, own in groups.items()}
    return Histogram(
        metric=metric,
        edges=edges,
        counts={verdict: np.histogram(own, edges)[0] for verdict, own in clipped.items()},
        median=median,
        outliers=int(((finite < edges[0]) | (finite > edges[-1])).sum()),
        estimate=estimate,
    )
