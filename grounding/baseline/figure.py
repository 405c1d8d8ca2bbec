"""The comparison as a figure: what each method errs by on each task."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinebench_drake.grounding.baseline.comparison import Group, Method, Quantity
from kinebench_drake.storage import whole

_STYLE = {
    Method.BASELINE: ("inverse-dynamics baseline", "#c44e52", "o", -0.16),
    Method.GROUNDING: ("grounding", "#2f6db3", "s", 0.16),
}


def draw(found: Sequence[Group], path: Path) -> None:
    """Write a png: medians with their intervals, whiskers to the 95th percentile, tasks side by side.

    Raises:
        SetupError: writing failed.
    """
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(2.5 + 0.62 * len(found), 9.5), layout="constrained")
    panels = canvas.subplots(len(Quantity), 1, sharex=True)
    x = np.arange(len(found))
    for panel, quantity in zip(panels, Quantity, strict=True):
        for method, (label, colour, marker, shift) in _STYLE.items():
            medians = [g.medians[method, quantity] for g in found]
            value = np.array([f.value for f in medians])
            top = np.array([g.p95s[method, quantity].value for g in found])
            panel.vlines(x + shift, value, top, color=colour, lw=1.2, alpha=0.6)
            panel.plot(x + shift, top, "_", color=colour, ms=7, alpha=0.6)
            low = np.array([f.low for f in medians])
            high = np.array([f.high for f in medians])
            panel.vlines(x + shift, low, high, color=colour, lw=5, alpha=0.35)
            panel.plot(x + shift, value, marker, color=colour, ms=6, label=label)
        panel.set_yscale("log")
        panel.yaxis.set_major_formatter("{x:g}")
        panel.set_ylabel(f"error of {quantity.value}")
        panel.grid(axis="y", which="both", color="0.9", lw=0.6)
        panel.set_axisbelow(True)
        for i, g in enumerate(found):
            if not g.trained:
                panel.axvspan(i - 0.5, i + 0.5, color="#f6ead2", lw=0, zorder=-2)
            if g.pooled:
                panel.axvspan(i - 0.5, i + 0.5, color="0.5", alpha=0.12, lw=0, zorder=-1)
    panels[0].set_xlim(-0.5, len(found) - 0.5)
    panels[0].legend(loc="upper left", ncols=2, frameon=False)
    panels[0].set_title(
        "Markers: median over frames, thick bars: its 95 % interval over videos, thin bars: to the 95th percentile.\n"
        "Amber: tasks that the baseline was not trained on; grey: tasks together.",
        fontsize=9,
        loc="left",
    )
    panels[-1].set_xticks(x, [g.name for g in found], rotation=40, ha="right")
    for tick, g in zip(panels[-1].get_xticklabels(), found, strict=True):
        tick.set_fontweight("bold" if g.pooled else "normal")
    with whole(path) as part:
        canvas.savefig(part, dpi=120, format="png")
