"""Matplotlib figures of one style, written to files without a display."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinebench_drake.io.atomic import atomic_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POSITION = "#1f6fb2"
ROTATION = "#c4622d"
FAINT = "#b8bec4"
"""Colours of position, of rotation, and of background elements."""
GRID = "#e6e8ea"
"""Colour of grid lines."""
LABEL_PT = 9
TICK_PT = 8
"""Sizes of the text beside an axis and at its ticks [points]."""


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, *, arranged: bool = True, **options: Any
) -> "tuple[Figure, Any]":
    """Return a figure of a size [inches] and its axes (rows, columns), drawn without a display.

    Args:
        arranged: leave as much room around the axes as their texts need.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=130, layout="constrained" if arranged else None, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    for ax in axes.flat:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(True, color=GRID, linewidth=0.7)
        ax.set_axisbelow(True)
        ax.tick_params(labelsize=TICK_PT)
        ax.xaxis.label.set_size(LABEL_PT)
        ax.yaxis.label.set_size(LABEL_PT)
    return figure, axes


def shorten(name: str, letters: int = 48) -> str:
    """Return a name that a figure has room for, its middle left out: names often differ at their ends."""
    if len(name) <= letters:
        return name
    tail = letters // 2
    return f"{name[: letters - tail - 1]}…{name[-tail:]}"


def plain(text: str) -> str:
    """Escape dollar signs, between which matplotlib would typeset mathematics."""
    return text.replace("$", r"\$")


def save(figure: "Figure", path: Path) -> None:
    """Write a figure atomically in the format of the path's suffix (png, svg, pdf)."""
    with atomic_path(path) as part:
        figure.savefig(part, format=path.suffix[1:].lower() or "png")
