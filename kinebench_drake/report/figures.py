"""Matplotlib figures of reports as files and as parts of pages."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup, escape

from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.figure import FAINT, new_figure, plain, save, shorten
from kinebench_drake.report.table import read_caption
from kinebench_drake.results.aggregate import Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#2f7fc1", "#d06a2a", "#2a9d7f", "#9b62c4", "#b3902f", "#cf5a8e", "#7a8794", "#4f9bd9", "#a65a5a", "#5f8f3e")
"""Colours that can be distinguished on a light and on a dark background."""
_MARKERS = "os^Dv<>PX*"
SUCCESS = "#2563ab"
NEUTRAL = "#9aa5b1"
_THEME = {"#000000": "var(--ink)", "#ffffff": "var(--card)", "#e6e8ea": "var(--line)", "#b8bec4": "var(--faint)"}
"""Replacements of drawn colours on a page."""


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
    width = 0.45 + 0.075 * max(map(len, labels), default=0)  # inches per label with its mark
    columns = max(1, min(5, int(figure.get_figwidth() / width)))
    figure.legend(loc="outside upper center", ncols=columns, fontsize=8, frameon=False)


def draw_interval(ax: Any, value: Estimate, y: float, colour: str, marker: str) -> None:
    """Draw the mean of an estimate at height `y`, and its interval as a horizontal line."""
    if value.mean is None:
        return
    if value.low is not None and value.high is not None:
        ax.plot([value.low, value.high], [y, y], color=colour, linewidth=1.2, solid_capstyle="round")
    ax.plot([value.mean], [y], color=colour, marker=marker, markersize=4)


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
        for row, value in own:
            draw_interval(ax, value, rows.index(row) + offset, colour, marker)
        ax.plot([], [], color=colour, marker=marker, markersize=4, linewidth=1.2, label=plain(shorten(model)))
    if low < 0.0:
        ax.axvline(0.0, color=FAINT, linewidth=1.2, zorder=1)
    label_shares(ax, rows, label, low)
    add_legend(figure, list(estimates))
    return figure


def stack_bars(
    ax: Any, places: Sequence[int], lengths: Mapping[str, Sequence[float]], colours: Mapping[str, str], **options: Any
) -> None:
    """Draw stacked horizontal bars at `places` in the order of `colours`; `lengths` are by name of the colour."""
    left = [0.0] * len(places)
    for name, colour in colours.items():
        if any(lengths[name]):
            ax.barh(places, lengths[name], left=left, color=colour, **{"label": name, **options})
            left = [a + b for a, b in zip(left, lengths[name], strict=True)]


def label_shares(ax: Any, rows: Sequence[str], label: str, low: float = 0.0) -> None:
    """Name the rows of a chart, from bottom to top, and label its horizontal axis, from `low` to 1, in percent."""
    from matplotlib.ticker import PercentFormatter

    ax.set_yticks(range(len(rows)), [plain(row) for row in rows], fontsize=8)
    ax.set_ylim(-0.6, len(rows) - 0.4)
    ax.set_xlabel(label, fontsize=9)
    ax.set_xlim(low - 0.02, 1.02)
    ax.xaxis.set_major_formatter(PercentFormatter(xmax=1.0, decimals=0))
    ax.tick_params(axis="x", labelsize=8)


def write_figure(figure: ReportFigure, folder: Path) -> Markup:
    """Write a figure as png and svg, always the same bytes; returns it as markup for a page."""
    from matplotlib import rc_context

    path = folder / f"{figure.name}.svg"
    save(figure.figure, path.with_suffix(".png"))
    with rc_context({"svg.hashsalt": figure.name}), atomic_path(path) as part:
        figure.figure.savefig(part, format="svg", metadata={"Date": None})
    return Markup(inline_svg(path.read_text(encoding="utf-8"), figure.name, figure.title))


def inline_svg(svg: str, name: str, title: str) -> str:
    """Convert a drawing to a part of an html page: unique ids, the page's colours, no external addresses."""
    body = svg[svg.index("<svg") :]
    name = re.sub(r"[^\w.-]", "_", name)
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"<style[^>]*>.*?</style>", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->", "", body, flags=re.DOTALL)
    body = re.sub(r'(<g) id="[^"]*"', r"\1", body)
    body = re.sub(r'\bid="([^"]*)"', rf'id="{name}-\1"', body)
    body = re.sub(r'xlink:href="#([^"]*)"', rf'href="#{name}-\1"', body)
    body = re.sub(r"url\(#([^)]*)\)", rf"url(#{name}-\1)", body)
    for drawn, themed in _THEME.items():
        body = body.replace(drawn, themed)
    box = re.search(r'viewBox="0 0 ([\d.]+) [\d.]+"', body)
    width = float(box[1]) * 1.5 if box else 0.0  # size of figures on a page [px of CSS / point]
    # 0.7: share of that size below which a figure scrolls instead of getting smaller
    size = f'{box[0]} width="{width:.0f}" style="min-width: {0.7 * width:.0f}px"' if box else ""
    head = f'<svg {size} role="img" aria-label="{escape(title)}">'
    return re.sub(r"<svg[^>]*>", lambda _: head, body, count=1)
