"""Curves over time as inline SVG: a few hundred bytes a line, coloured by the page's style sheet."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from kinebench_drake.geometry import Array

_WIDTH, _HEIGHT = 430.0, 128.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 44.0, 8.0, 8.0, 20.0
_MAX_POINTS = 240


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """One line of a plot."""

    label: str
    values: Array
    """(T,) values; NaN interrupts the line."""
    css: str
    """Class that colours the line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Band:
    """A range of frames to shade."""

    label: str
    start: int
    """First frame."""
    end: int
    """Last frame, inclusive."""
    css: str
    """Class that colours the range."""


def draw_plot(
    title: str,
    t_s: Array,
    curves: Sequence[Curve],
    bands: Sequence[Band] = (),
    *,
    limits: tuple[float, float] | None = None,
    lines: Sequence[float] = (),
) -> Markup:
    """Curves over time as one `<figure>`.

    Args:
        title: caption with the unit.
        t_s: (T,) time [s].
        curves: what to draw.
        bands: frame ranges to shade behind the curves.
        limits: fixed range of the vertical axis; None takes that of the values.
        lines: values to mark, such as limits.
    """
    low, high = limits or _range([c.values for c in curves], lines)
    t_first, t_last = float(t_s[0]), float(t_s[-1])
    span = (t_last - t_first) or 1.0
    half_frame = span / max(len(t_s) - 1, 1) / 2.0

    def x(t: float) -> float:
        return _LEFT + (min(max(t, t_first), t_last) - t_first) / span * (_WIDTH - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return _TOP + (high - min(max(value, low), high)) / (high - low) * (_HEIGHT - _TOP - _BOTTOM)

    parts = [f'<svg viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img" aria-label="{escape(title)}">']
    for band in bands:
        start, end = (min(max(frame, 0), len(t_s) - 1) for frame in (band.start, band.end))
        left, right = x(t_s[start] - half_frame), x(t_s[end] + half_frame)
        parts.append(
            f'<rect class="band {band.css}" x="{left:.1f}" y="{_TOP:.0f}" width="{max(right - left, 1.5):.1f}" '
            f'height="{_HEIGHT - _TOP - _BOTTOM:.0f}"><title>{escape(band.label)}</title></rect>'
        )
    for value in ticks(low, high):
        parts.append(f'<path class="grid" d="M{_LEFT:.0f} {y(value):.1f}H{_WIDTH - _RIGHT:.0f}"/>')
        parts.append(f'<text class="tick" x="{_LEFT - 5:.0f}" y="{y(value) + 3.5:.1f}">{value:.4g}</text>')
    for time in ticks(t_first, t_last):
        parts.append(f'<text class="tick time" x="{x(time):.1f}" y="{_HEIGHT - 5:.0f}">{time:.4g}</text>')
    for line in lines:
        parts.append(f'<path class="limit" d="M{_LEFT:.0f} {y(line):.1f}H{_WIDTH - _RIGHT:.0f}"/>')
    for curve in curves:
        for piece in pieces(t_s, curve.values):
            points = " ".join(f"{x(t):.1f},{y(v):.1f}" for t, v in piece)
            if len(piece) == 1:
                centre_x, centre_y = points.split(",")
                parts.append(f'<circle class="dot {curve.css}" cx="{centre_x}" cy="{centre_y}" r="1.8"/>')
            else:
                named = f"<title>{escape(curve.label)}</title>" if len(curves) > 1 else ""
                parts.append(f'<polyline class="curve {curve.css}" points="{points}">{named}</polyline>')
    parts.append("</svg>")
    key = "".join(f'<span class="key {c.css}">{escape(c.label)}</span>' for c in curves if len(curves) > 1)
    return Markup(f"<figure><figcaption>{escape(title)}{key}</figcaption>{''.join(parts)}</figure>")


def _range(values: Sequence[Array], lines: Sequence[float]) -> tuple[float, float]:
    """A range that holds every finite value and the marked ones, with a little air, never empty."""
    known = [v[np.isfinite(v)] for v in values] + [np.asarray(lines, dtype=np.float64)]
    every = np.concatenate(known)
    if not every.size:
        return 0.0, 1.0
    low, high = float(every.min()), float(every.max())
    air = 0.08 * (high - low) or max(abs(high) * 0.1, 1e-3)
    return low - air, high + air


def ticks(low: float, high: float) -> list[float]:
    """Three to six round values within a range."""
    if high <= low:
        return [low]
    step = 10.0 ** np.floor(np.log10((high - low) / 2.0))
    step *= next(m for m in (5.0, 2.0, 1.0) if (high - low) / (step * m) >= 2.0 or m == 1.0)
    first = int(np.ceil(low / step - 1e-9))
    return [float(f"{k * step:.6g}") for k in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def pieces(t_s: Array, values: Array) -> list[list[tuple[float, float]]]:
    """Runs of finite points, thinned where there are more than the eye can see."""
    kept = _thinned(values)
    known = kept[np.isfinite(values[kept])]
    breaks = np.flatnonzero([not np.isfinite(values[a:b]).all() for a, b in pairwise(known)])
    runs = np.split(known, breaks + 1)
    return [[(float(t_s[k]), float(values[k])) for k in run] for run in runs if len(run)]


def _thinned(values: Array) -> NDArray[np.intp]:
    """Indices of at most _MAX_POINTS values: the least and the greatest of each stretch, so that no peak is lost."""
    n = len(values)
    if n <= _MAX_POINTS:
        return np.arange(n)
    edges = np.linspace(0, n, _MAX_POINTS // 2 + 1).astype(int)
    kept: set[int] = set()
    for start, end in pairwise(edges):
        known = np.flatnonzero(np.isfinite(values[start:end]))
        if len(known):
            part = values[start:end][known]
            kept |= {int(start + known[np.argmin(part)]), int(start + known[np.argmax(part)])}
    return np.array(sorted(kept), dtype=np.intp)
