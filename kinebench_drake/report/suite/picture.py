"""Figures as files, and as part of a page whose colours they take over."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kinebench_drake.io.atomic import atomic_path
from kinebench_drake.io.figure import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#2f7fc1", "#d06a2a", "#2a9d7f", "#9b62c4", "#b3902f", "#cf5a8e", "#7a8794", "#4f9bd9", "#a65a5a", "#5f8f3e")
"""Colours that can be told apart on light and on dark ground."""
MARKERS = "os^Dv<>PX*"
GOOD, NEUTRAL = "#2a9d5f", "#9aa5b1"
_THEME = {"#000000": "var(--ink)", "#ffffff": "var(--card)", "#e6e8ea": "var(--line)", "#b8bec4": "var(--mute)"}
"""What stands for drawn colours on a page."""
_PX_A_POINT = 1.5
"""Size of figures on a page [px of CSS / point]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportFigure:
    """A figure with its words."""

    name: str
    """Its name in file names."""
    title: str
    caption: str
    """What it shows and how it is to be read."""
    figure: "Figure"


def style(index: int) -> tuple[str, str]:
    """Colour and marker of the model of a number."""
    return COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]


def numbers(models: Sequence[str], here: Sequence[str]) -> dict[str, int]:
    """Number of each model of a panel: the same in all panels as long as there are colours for all models."""
    order = models if len(models) <= len(COLOURS) else here
    return {model: order.index(model) for model in here}


def legend(figure: "Figure", labels: Sequence[str]) -> None:
    """Put a legend above a figure, in as many columns as there is room for."""
    wide = 0.45 + 0.075 * max(map(len, labels), default=0)  # inches that a label takes with its mark
    columns = max(1, min(5, int(figure.get_figwidth() / wide)))
    figure.legend(loc="outside upper center", ncols=columns, fontsize=8, frameon=False)


def write_picture(picture: ReportFigure, folder: Path) -> str:
    """Write a figure as png and svg, always the same bytes; returns it as markup for a page.

    Raises:
        SetupError: writing failed.
    """
    from matplotlib import rc_context

    save(picture.figure, folder / f"{picture.name}.png")
    path = folder / f"{picture.name}.svg"
    with rc_context({"svg.hashsalt": picture.name}), atomic_path(path) as part:
        picture.figure.savefig(part, format="svg", metadata={"Date": None})
    return inline(path.read_text(encoding="utf-8"), picture.name, picture.title)


def inline(svg: str, name: str, title: str) -> str:
    """A drawing as part of an html page: its ids its own, its ground and lines in the page's colours, no addresses."""
    from markupsafe import escape

    body = svg[svg.index("<svg") :]
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
    size = f'{box[0]} width="{float(box[1]) * _PX_A_POINT:.0f}"' if box else ""
    head = f'<svg {size} role="img" aria-label="{escape(title)}">'
    return re.sub(r"<svg[^>]*>", lambda _: head, body, count=1)
