"""Matplotlib figures of reports, as files and as parts of pages."""

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.io.figure import FAINT, GRID, new_figure, plain, save, shorten
from kinebench_drake.report.table import read_caption
from kinebench_drake.results.aggregate import Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#2f7fc1", "#d06a2a", "#2a9d7f", "#9b62c4", "#b3902f", "#cf5a8e", "#7a8794", "#4f9bd9", "#a65a5a", "#5f8f3e")
"""Colours that can be distinguished on a light and on a dark background."""
_MARKERS = "os^Dv<>PX*"
INK = "#000000"
BAD = "#c2361c"
DOUBT = "#d99200"
NEUTRAL = "#9aa5b1"
_GOOD = "#1b7f4b"
_SUCCESS = "#2563ab"
_WARN = "#9a6700"
VERDICT_COLOURS = {
    **{"success": _SUCCESS, "executable": _GOOD, "feasible": _SUCCESS, "infeasible": BAD, "error": BAD},
    **{"grounding": "#a3842b", "generation": BAD, "execution": "#8a4fb5", "task": "#c04a80", "unmeasurable": _WARN},
}
"""Colours of the verdicts; that of the others is NEUTRAL."""
_THEME = {
    **{INK: "ink", "#ffffff": "card", GRID: "line", FAINT: "faint", _GOOD: "good", BAD: "bad", _WARN: "warn"},
    **{_SUCCESS: "accent", DOUBT: "amber", "#8a4fb5": "c3", "#a3842b": "c4", "#c04a80": "c5"},
}
"""Variables of a page's style sheet in place of drawn colours: they follow the colour scheme of the reader."""
_MARK_IN = 0.45
_LETTER_IN = 0.075
"""Widths of a mark in a legend, and of a letter of its label [inches]."""
_PX_PER_POINT = 1.5
"""Size of figures on a page [px of CSS / point]."""
_LEAST_SIZE = 0.7
"""Share of that size below which a figure scrolls instead of getting smaller: its text would be hard to read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigure:
    """A figure with its caption."""

    name: str
    """Stem of the file names."""
    title: str
    caption: str
    """Contents, and how to read them."""
    figure: "Figure"


def make_figure(key: str, figure: "Figure", **values: object) -> ReportFigure:
    """Give a figure its name and texts in captions.toml, with `values` in their placeholders."""
    return ReportFigure(**read_caption("figures", key, **values), figure=figure)


def style(index: int) -> tuple[str, str]:
    """Return colour and marker of a model by its number."""
    return COLOURS[index % len(COLOURS)], _MARKERS[index % len(_MARKERS)]


def assign_numbers(models: Sequence[str], here: Sequence[str]) -> dict[str, int]:
    """Number the models of a panel: the same in all panels as long as there are colours for all models."""
    order = models if len(models) <= len(COLOURS) else here
    return {model: order.index(model) for model in here}


def add_legend(figure: "Figure", labels: Sequence[str]) -> None:
    """Put a legend above a figure, in as many columns as fit."""
    width = _MARK_IN + _LETTER_IN * max(map(len, labels), default=0)
    columns = max(1, min(5, int(figure.get_figwidth() / width)))
    figure.legend(loc="outside upper center", ncols=columns, fontsize=8, frameon=False)


def mean_bars(estimates: Sequence[Estimate]) -> tuple[list[float], list[list[float]]]:
    """Return the means of estimates that have one, and how far their intervals reach below and above them."""
    means = [e.mean for e in estimates if e.mean is not None]
    ends = [(e.low, e.high) for e in estimates if e.mean is not None]
    below = [0.0 if low is None else mean - low for mean, (low, _) in zip(means, ends, strict=True)]
    above = [0.0 if high is None else high - mean for mean, (_, high) in zip(means, ends, strict=True)]
    return means, [below, above]


def draw_intervals(
    rows: Sequence[str],
    estimates: Mapping[str, Sequence[tuple[str, Estimate]]],
    numbers: Mapping[str, int],
    label: str,
    low: float = 0.0,
) -> "Figure":
    """Draw shares as points with intervals: a line per row, the models beside each other.

    Args:
        numbers: number of each model, see `assign_numbers`.
        low: its lower end; 0 is marked if it lies within.
    """
    figure, axes = new_figure(7.2, 1.3 + len(rows) * max(0.3, 0.1 + 0.1 * len(estimates)))
    ax = axes[0, 0]
    for k, (model, own) in enumerate(estimates.items()):
        colour, marker = style(numbers[model])
        offset = 0.62 * (0.5 - (k + 0.5) / len(estimates))
        places = [rows.index(row) + offset for row, value in own if value.mean is not None]
        means, reach = mean_bars([value for _, value in own])
        name = plain(shorten(model))
        ax.errorbar(means, places, xerr=reach, fmt=marker, color=colour, markersize=4, linewidth=1.2, label=name)
    if low < 0.0:
        ax.axvline(0.0, color=FAINT, linewidth=1.2, zorder=1)
    label_shares(ax, rows, label, low)
    add_legend(figure, list(estimates))
    return figure


def label_shares(ax: Any, rows: Sequence[str], label: str, low: float = 0.0) -> None:
    """Name the rows of a chart, from bottom to top, and label its horizontal axis, from `low` to 1, in percent."""
    from matplotlib.ticker import PercentFormatter

    ax.set_yticks(range(len(rows)), [plain(row) for row in rows])
    ax.set(xlabel=label, xlim=(low - 0.02, 1.02), ylim=(-0.6, len(rows) - 0.4))
    ax.xaxis.set_major_formatter(PercentFormatter(xmax=1.0, decimals=0))


def write_figure(figure: ReportFigure, folder: Path) -> Markup:
    """Write a figure as png and svg, always the same bytes; returns it as markup for a page."""
    save(figure.figure, folder / f"{figure.name}.png")
    drawing = _draw_svg(figure.figure, figure.name)
    write_atomically(folder / f"{figure.name}.svg", drawing.encode())
    return _inline(drawing, figure.title)


def inline_figure(figure: "Figure", name: str, title: str) -> Markup:
    """Return a figure as markup for a page, always the same.

    Args:
        name: unique on the page.
        title: its description for readers who do not see it.
    """
    return _inline(_draw_svg(figure, name), title)


def _draw_svg(figure: "Figure", name: str) -> str:
    """Return the drawing as svg with texts as texts; its ids are hashes of the name and of what they stand for."""
    from matplotlib import rc_context

    drawing = io.StringIO()
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(drawing, format="svg", metadata={"Date": None})
    return drawing.getvalue()


def _inline(svg: str, title: str) -> Markup:
    """Convert a drawing to a part of an html page: its fonts and colours, no external addresses, short numbers."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<(metadata|style)\b.*?</\1>|<!--.*?-->", "", body, flags=re.DOTALL)
    body = re.sub(r'(<g) id="[^"]*"', r"\1", body)
    body = body.replace("xlink:href", "href")
    body = re.sub(r"; font-family: [^;\"]*", "", body)
    body = re.sub(r' (?:d|transform|[xy])="[^"]*"', lambda match: re.sub(r"(\.\d)\d+", r"\1", match[0]), body)
    body = re.sub(r"\s+", " ", body)
    for drawn, themed in _THEME.items():
        body = body.replace(drawn, f"var(--{themed})")
    box = re.search(r'viewBox="0 0 ([\d.]+) [\d.]+"', body)
    width = float(box[1]) * _PX_PER_POINT if box else 0.0
    bounds = f"min-width: {_LEAST_SIZE * width:.0f}px; max-width: min(100%, {width:.0f}px)"
    size = f'{box[0]} width="{width:.0f}" style="{bounds}"' if box else ""
    head = f'<svg {size} role="img" aria-label="{escape(title)}">'
    return Markup(re.sub(r"<svg[^>]*>", lambda _: head, body, count=1))
